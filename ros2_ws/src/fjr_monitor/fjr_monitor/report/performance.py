# SPDX-License-Identifier: Apache-2.0
"""Performance of a run that comes in parts: tracking error and effort, V against its bound, the power balance.

The power balance is that of eq. (36): dH/dt = dq_m' B_m u - dq_l' D_l dq_l - dq_m' D_m dq_m. An effort that is held
over a sample does the work effort times motor displacement exactly; only the dissipation needs quadrature (trapezoidal
rule).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fjr_core.numerics.checks import Array
from fjr_core.numerics.one_line import at_least
from fjr_monitor.recording.run import Recording, RunData

STEADY_AFTER = 2.0  # s; metrics "after 2 s" exclude the transient
SETTLED = 0.02  # of the initial error
AT_LIMIT = 1.0 - 1e-6  # share of an effort limit from which a command counts as saturated
DECAYED = 1e-4  # of V(0): the decay rate is measured down to this value


@dataclass(frozen=True)
class JointMetrics:
    """Metrics of one joint. Errors in rad, efforts in N m, times in s; NaN or None: unknown or not applicable.

    position_unit, effort_unit: units of errors and efforts of this joint; m and N for a prismatic joint.
    """

    joint: str
    position_unit: str
    effort_unit: str
    initial_error_rad: float
    peak_error_rad: float
    rms_error_rad: float
    peak_error_after_2s_rad: float
    rms_error_after_2s_rad: float
    settling_time_2_percent_s: float | None  # to within 2 % of the largest initial error of all joints
    peak_effort_nm: float
    rms_effort_nm: float
    effort_limit_nm: float
    saturated_fraction: float  # of the commands; NaN without a limit


@dataclass(frozen=True)
class Tracking:
    """Tracking metrics; errors and efforts are the largest of all joints, each with its joint.

    Units of prismatic joints are m and N (JointMetrics).
    """

    peak_effort_nm: float
    peak_effort_joint: str | None  # null: no effort is known; likewise the next two
    largest_share_joint: str | None
    max_error_after_2s_joint: str | None
    peak_effort_by_joint_nm: dict[str, float]
    effort_limit_by_joint_nm: dict[str, float]  # null: no limit
    largest_share_of_effort_limit: float | None  # of all joints with a limit; null: no limit
    initial_error_rad: float
    max_error_after_2s_rad: float  # null: the run is shorter; likewise the next
    rms_error_after_2s_rad: float
    settling_time_2_percent_s: float | None  # |error| stays within 2 % of the initial one
    saturated_fraction: float | None  # commands with any joint at its limit; null: no limit
    reference_mismatch_rad: float  # recorded minus planned reference: a cross-check, near 0


class Sizes:
    """Number, largest and root mean square (n,) of the values of each joint that are known; NaN without any."""

    def __init__(self, n: int) -> None:
        self.count, self.largest, self._squares = np.zeros(n, dtype=int), np.full(n, np.nan), np.zeros(n)

    def add(self, sizes: Array) -> None:
        """Add absolute values (k, n), NaN where not known."""
        self.count += (~np.isnan(sizes)).sum(axis=0)
        self.largest = np.fmax(self.largest, np.fmax.reduce(sizes, axis=0, initial=np.nan))
        self._squares += np.nansum(sizes**2, axis=0)

    @property
    def rms(self) -> Array:
        """Return the root mean squares."""
        return np.asarray(np.sqrt(self._squares / np.where(self.count, self.count, np.nan)))


class Settling:
    """When values stay within a band: the first time after the last one outside of it."""

    def __init__(self, band: float, columns: int) -> None:
        self._band, self._known = band, np.zeros(columns, dtype=bool)
        self._since = np.zeros(columns)  # s; NaN: outside at the latest time

    def add(self, t: Array, values: Array) -> None:
        """Add values (k, columns) at times t (k,)."""
        self._known |= np.isfinite(values).any(axis=0)
        for j, outside in enumerate((values > self._band).T):
            rows = np.flatnonzero(outside)
            if rows.size:
                self._since[j] = t[rows[-1] + 1] if rows[-1] + 1 < len(t) else np.nan
            elif np.isnan(self._since[j]):
                self._since[j] = t[0]

    def time(self, column: int) -> float | None:
        """Return the time [s]; None if never or unknown."""
        settled = np.isfinite(self._band) and self._known[column] and not np.isnan(self._since[column])
        return float(self._since[column]) if settled else None


class Tracked:
    """Tracking error and effort of a run that comes in parts."""

    def __init__(self, run: Recording) -> None:
        n = len(run.joints)
        self._run, self._limit = run, run.effort_limit
        self._errors, self._late, self._efforts = Sizes(n), Sizes(n), Sizes(n)
        self._initial: Array | None = None
        self._settling = Settling(np.nan, n + 1)
        self._at_limit = np.zeros(n, dtype=int)
        self._commands = self._saturated = 0

    def add(self, part: RunData) -> None:
        """Add the new states of a part."""
        t, size, u = part.t[part.begin :], np.abs(part.error[part.begin :]), np.abs(part.u[part.begin :])
        if self._initial is None:
            self._initial = size[0]
            self._settling = Settling(SETTLED * float(size[0].max()), size.shape[1] + 1)
        self._errors.add(size)
        self._late.add(size[t >= STEADY_AFTER])
        self._settling.add(t, np.column_stack([size, size.max(axis=1)]))
        self._efforts.add(u)
        at_limit, whole = np.isfinite(u) & (u >= AT_LIMIT * self._limit), np.isfinite(u).all(axis=1)
        self._at_limit += at_limit.sum(axis=0)
        self._commands += int(whole.sum())
        self._saturated += int((at_limit[whole]).any(axis=1).sum())

    def joints(self) -> list[JointMetrics]:
        """Return the metrics of every joint."""
        assert self._initial is not None  # a run has a state
        errors, late, efforts = self._errors, self._late, self._efforts
        at_limit = self._at_limit / np.where(efforts.count, efforts.count, np.nan)
        return [
            JointMetrics(
                joint=joint,
                position_unit=units.position,
                effort_unit=units.effort,
                initial_error_rad=float(self._initial[j]),
                peak_error_rad=float(errors.largest[j]),
                rms_error_rad=float(errors.rms[j]),
                peak_error_after_2s_rad=float(late.largest[j]),
                rms_error_after_2s_rad=float(late.rms[j]),
                settling_time_2_percent_s=self._settling.time(j),
                peak_effort_nm=float(efforts.largest[j]),
                rms_effort_nm=float(efforts.rms[j]),
                effort_limit_nm=float(limit),
                saturated_fraction=float(at_limit[j]) if np.isfinite(limit) else np.nan,
            )
            for j, (joint, units, limit) in enumerate(zip(self._run.joints, self._run.units, self._limit, strict=True))
        ]

    def tracking(self) -> Tracking:
        """Return the metrics of all joints."""
        assert self._initial is not None
        joints, peaks = self._run.joints, self._efforts.largest
        (peak, peak_at), (share, share_at) = (self._largest(each) for each in (peaks, peaks / self._limit))
        worst, worst_at = self._largest(self._late.largest)
        limited = self._commands and np.isfinite(self._limit).any()
        return Tracking(
            peak_effort_nm=peak,
            peak_effort_joint=peak_at,
            largest_share_joint=share_at if share > 0 else None,
            max_error_after_2s_joint=worst_at,
            peak_effort_by_joint_nm=dict(zip(joints, peaks.tolist(), strict=True)),
            effort_limit_by_joint_nm=dict(zip(joints, self._limit.tolist(), strict=True)),
            largest_share_of_effort_limit=share if share > 0 else None,
            initial_error_rad=float(self._initial.max()),
            max_error_after_2s_rad=worst,
            rms_error_after_2s_rad=float(np.sqrt(np.mean(self._late.rms**2))),
            settling_time_2_percent_s=self._settling.time(len(joints)),
            saturated_fraction=self._saturated / self._commands if limited else None,
            reference_mismatch_rad=self._run.reference_mismatch,
        )

    def _largest(self, values: Array) -> tuple[float, str | None]:
        """Return the largest of values (n,) and its joint; NaN and None if all are unknown."""
        if np.isnan(values).all():
            return math.nan, None
        j = int(np.nanargmax(values))
        return float(values[j]), self._run.joints[j]


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

    @property
    def basis(self) -> str:
        """Return how the guaranteed rate is known."""
        return "proven" if self.guarantee_is_proven else "sampled"

    @property
    def least(self) -> str:
        """Return the guaranteed rate as text, rounded down."""
        return at_least(self.guaranteed_decay_rate_per_s, 3)


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
