# SPDX-License-Identifier: Apache-2.0
"""Lyapunov function V against its bound, and the power balance of eq. (36), over a run.

dH/dt = dq_m' B_m u - dq_l' D_l dq_l - dq_m' D_m dq_m. An effort that is held over a sample does the
work effort times motor displacement exactly; only the dissipation needs quadrature (trapezoidal rule).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fjr_core.numerics.checks import Array
from fjr_monitor.analysis.run_data import RunData
from fjr_monitor.analysis.tracking import STEADY_AFTER

DECAYED = 1e-4  # of V(0): the decay rate is measured down to this value


@dataclass(frozen=True)
class Storage:
    """Lyapunov function V and its bound V(0) exp(-2 beta t), which is proven for continuous time.

    The loop is sampled: a late command raises V above the bound for a moment, and the hold keeps V on a floor
    while the bound converges to zero.
    """

    initial: float
    guaranteed_decay_rate_per_s: float  # 2 beta
    guarantee_is_proven: bool  # for every configuration, or all in the box of the visited ones; else a sampled minimum
    measured_decay_rate_per_s: float | None  # mean rate while V falls from V(0) to 1e-4 V(0)
    leaves_bound_at_s: float | None  # V stays above the bound from here on; null: never
    relative_where_it_leaves: float | None  # V / V(0) there
    largest_ratio_to_bound_before: float  # at most 1: V never exceeded the bound before
    max_relative_after_2s: float | None  # the floor, V / V(0)


class Decay:
    """V of a run that comes in parts, against its bound."""

    def __init__(self, beta: float, proven: bool) -> None:
        """beta [1/s]: V(t) <= V(0) exp(-2 beta t) in continuous time; proven: whether it is."""
        self.beta, self._proven = beta, proven
        self.initial = float("nan")
        self._started = False
        self._rate: float | None = None
        self._leaves: tuple[float, float] | None = None  # time and V / V(0) of the first state since V left the bound
        self._ratio, self._pending = 1.0, 1.0  # largest ratio to the bound: before V left it, and since
        self._floor: float | None = None

    def add(self, part: RunData) -> None:
        """Add the new states of a part."""
        t, V = part.t[part.begin :], part.V[part.begin :]
        if not self._started:
            self._started, self.initial = True, float(V[0])
        relative, ratio = V / (self.initial or 1.0), V / (self.initial * np.exp(-2.0 * self.beta * t))
        low = np.flatnonzero(relative <= DECAYED)
        if self._rate is None and low.size:
            self._rate = float(-np.log(relative[low[0]]) / t[low[0]])
        within = np.flatnonzero(ratio <= 1.0)  # V(0) itself is on the bound, unless it is 0
        leaves = int(within[-1]) + 1 if within.size else 0
        if within.size:
            self._ratio = float(ratio[:leaves].max(initial=max(self._ratio, self._pending)))
            self._leaves, self._pending = None, 1.0
        self._pending = float(ratio[leaves:].max(initial=self._pending))
        if self._leaves is None and leaves < len(t):
            self._leaves = float(t[leaves]), float(relative[leaves])
        steady = relative[t >= STEADY_AFTER]
        if steady.size:
            self._floor = float(steady.max(initial=self._floor or -np.inf))

    def storage(self) -> Storage:
        """Return the metrics."""
        at, relative = self._leaves or (None, None)
        return Storage(
            initial=self.initial,
            guaranteed_decay_rate_per_s=2.0 * self.beta,
            guarantee_is_proven=self._proven,
            measured_decay_rate_per_s=self._rate,
            leaves_bound_at_s=at,
            relative_where_it_leaves=relative,
            largest_ratio_to_bound_before=self._ratio,
            max_relative_after_2s=self._floor,
        )


@dataclass(frozen=True)
class Energy:
    """The power balance, integrated over the run [J]: stored = supplied - dissipated + residual."""

    supplied_j: float
    dissipated_j: float
    stored_j: float
    residual_j: float
    rms_residual_of_supplied: float  # RMS of the residual power, relative to that of the supplied power


@dataclass(frozen=True)
class Power:
    """Mean powers (k,) over k steps between states [W]; t (k,) [s]: start of each step; NaN: unknown."""

    t: Array
    supplied: Array
    dissipated: Array
    stored: Array  # dH/dt
    dt: Array  # s, length of each step

    @property
    def residual(self) -> Array:
        """Residual of the power balance [W]; 0 if the plant is the model."""
        return self.stored - self.supplied + self.dissipated


def power(part: RunData, B_m: Array) -> Power:
    """Return the power balance of the steps that end in a part, with the measured motor torque where available.

    B_m (n, n): input matrix of the motors.
    """
    n, dt, H = part.u.shape[1], np.diff(part.t), part.certificate.H
    displacement, dissipated = np.diff(part.position[:, n:], axis=0), part.certificate.dissipated
    steps = slice(max(0, part.begin - 1), None)
    with np.errstate(divide="ignore", invalid="ignore"):
        return Power(
            t=part.t[:-1][steps],
            supplied=((_torque(part, B_m) * displacement).sum(axis=1) / dt)[steps],
            dissipated=((dissipated[:-1] + dissipated[1:]) / 2)[steps],
            stored=(np.diff(H) / dt)[steps],
            dt=dt[steps],
        )


def _torque(part: RunData, B_m: Array) -> Array:
    """Return the mean motor torque over each step (k - 1, n) [N m]; a new effort acts from its arrival on."""
    after = np.vstack([0 * part.u[:1], part.u[:-1] @ B_m.T]) if part.u_applied is None else part.torque
    if part.lockstep:
        return after[1:]
    late = np.clip(np.nan_to_num(part.latency) / part.sample_period, 0.0, 1.0)[:-1, None]
    return np.asarray(late * after[:-1] + (1.0 - late) * after[1:])


class Balance:
    """Energies of a run that comes in parts."""

    def __init__(self) -> None:
        self.joules = np.zeros(4)  # supplied, dissipated, stored, residual
        self._squares = np.zeros(2)  # of residual and supplied power

    def add(self, flow: Power) -> None:
        """Add the powers of more steps."""
        residual = flow.residual
        powers = (flow.supplied, flow.dissipated, flow.stored, residual)
        self.joules += [float(np.nansum(each * flow.dt)) for each in powers]
        known = np.isfinite(residual)
        self._squares += (residual[known] ** 2).sum(), (flow.supplied[known] ** 2).sum()

    def energy(self) -> Energy:
        """Return the energies."""
        left, supplied = np.sqrt(self._squares)
        relative = float(left / supplied) if supplied else float("nan")
        return Energy(*map(float, self.joules), rms_residual_of_supplied=relative)  # type: ignore[misc]
