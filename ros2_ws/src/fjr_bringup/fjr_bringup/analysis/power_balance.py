# SPDX-License-Identifier: Apache-2.0
"""The power balance of eq. (36) over each sample: what was supplied and dissipated, and what the energy became.

dH/dt = dq_m' B_m u - dq_l' D_l dq_l - dq_m' D_m dq_m. An effort that is held over a sample supplies exactly
effort times the motors' way, so that only the dissipation is a quadrature (the trapezoidal rule).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fjr_bringup.analysis.run_data import TrackingData
from fjr_bringup.recording.reader import Array


@dataclass(frozen=True)
class Power:
    """Means over the k - 1 steps between k states [W], each from t [s] on; NaN: not known."""

    t: Array
    supplied: Array
    dissipated: Array
    stored: Array  # dH/dt
    dt: Array  # s, length of each step

    @property
    def residual(self) -> Array:
        """What the model's balance leaves over [W]: 0 for the robot that the scenario describes."""
        return self.stored - self.supplied + self.dissipated


def power(data: TrackingData, B_m: Array) -> Power:
    """The balance between the recorded states; the effort is the motors' own torque where that was measured."""
    n, dt = len(data.joints), np.diff(data.t)
    way = np.diff(data.position[:, n:], axis=0)
    held = _torque(data, B_m)
    with np.errstate(divide="ignore", invalid="ignore"):
        return Power(
            t=data.t[:-1],
            supplied=(held * way).sum(axis=1) / dt,
            dissipated=(data.dissipated[:-1] + data.dissipated[1:]) / 2,
            stored=np.diff(data.H) / dt,
            dt=dt,
        )


def _torque(data: TrackingData, B_m: Array) -> Array:
    """Mean torque at the motors over each step (k - 1, n) [N m]: a new effort acts from when it came."""
    after = data.torque if np.isfinite(data.torque).any() else np.vstack([0 * data.u[:1], data.u[:-1] @ B_m.T])
    if data.lockstep:
        return after[1:]
    late = np.clip(np.nan_to_num(data.latency) / data.sample_period, 0.0, 1.0)[:-1, None]
    return np.asarray(late * after[:-1] + (1.0 - late) * after[1:])
