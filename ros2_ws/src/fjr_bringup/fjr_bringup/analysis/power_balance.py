# SPDX-License-Identifier: Apache-2.0
"""Power balance of eq. (36) over each sample: supplied, dissipated and stored power.

dH/dt = dq_m' B_m u - dq_l' D_l dq_l - dq_m' D_m dq_m. An effort that is held over a sample does the
work effort times motor displacement exactly; only the dissipation needs quadrature (trapezoidal rule).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fjr_bringup.analysis.run_data import RunData
from fjr_bringup.recording.reader import Array


@dataclass(frozen=True)
class Power:
    """Mean powers (k - 1,) over the steps between k states [W]; t (k - 1,) [s]: start of each step; NaN: unknown."""

    t: Array
    supplied: Array
    dissipated: Array
    stored: Array  # dH/dt
    dt: Array  # s, length of each step

    @property
    def residual(self) -> Array:
        """Residual of the power balance [W]; 0 if the plant is the model."""
        return self.stored - self.supplied + self.dissipated


def power(data: RunData, B_m: Array) -> Power:
    """Return the power balance between the recorded states, with the measured motor torque where available.

    B_m (n, n): input matrix of the motors.
    """
    n, dt = len(data.joints), np.diff(data.t)
    displacement = np.diff(data.position[:, n:], axis=0)
    held = _torque(data, B_m)
    with np.errstate(divide="ignore", invalid="ignore"):
        return Power(
            t=data.t[:-1],
            supplied=(held * displacement).sum(axis=1) / dt,
            dissipated=(data.dissipated[:-1] + data.dissipated[1:]) / 2,
            stored=np.diff(data.H) / dt,
            dt=dt,
        )


def _torque(data: RunData, B_m: Array) -> Array:
    """Return the mean motor torque over each step (k - 1, n) [N m]; a new effort acts from its arrival on."""
    after = data.torque if np.isfinite(data.torque).any() else np.vstack([0 * data.u[:1], data.u[:-1] @ B_m.T])
    if data.lockstep:
        return after[1:]
    late = np.clip(np.nan_to_num(data.latency) / data.sample_period, 0.0, 1.0)[:-1, None]
    return np.asarray(late * after[:-1] + (1.0 - late) * after[1:])
