# SPDX-License-Identifier: Apache-2.0
"""Performance of a run: tracking error and effort, V against its bound, the power balance, timing.

The power balance is that of eq. (36): dH/dt = dq_m' B_m u - dq_l' D_l dq_l - dq_m' D_m dq_m. An effort that is held
over a sample does the work effort times motor displacement exactly; only the dissipation needs quadrature (trapezoidal
rule).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fjr_core.numerics.checks import Array
from fjr_core.numerics.one_line import at_least
from fjr_monitor.recording.columns import Columns
from fjr_monitor.recording.files import Times
from fjr_monitor.recording.run import Recording, RunData
from fjr_monitor.recording.signals import END

STEADY_AFTER = 2.0  # s; metrics "after 2 s" exclude the transient
SETTLED = 0.02  # of the initial error
AT_LIMIT = 1.0 - 1e-6  # share of an effort limit from which a command counts as saturated
FLOWS = ("supplied", "dissipated", "stored", "residual")  # of energy
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
    rms_error_after_2s_rad: float  # root mean square over the joints
    settling_time_2_percent_s: float | None  # |error| stays within 2 % of the initial one
    saturated_fraction: float | None  # commands with any joint at its limit; null: no limit
    reference_mismatch_rad: float  # recorded minus planned reference: a cross-check, near 0


def tracked(run: Recording) -> tuple[list[JointMetrics], Tracking]:
    """Return the metrics of every joint and of all joints."""
    columns = run.columns
    t, first = columns.column("t"), np.abs(columns.at(np.zeros(1, dtype=int))["error"][0])
    band = SETTLED * float(first.max())
    joints, largest, late = [], np.zeros(len(t)), int(np.searchsorted(t, STEADY_AFTER))
    commanded, saturated = np.ones(len(t), dtype=bool), np.zeros(len(t), dtype=bool)
    for j, (joint, units, limit) in enumerate(zip(run.joints, run.units, run.effort_limit, strict=True)):
        size, u = columns.column("error", j), columns.column("u", j)
        np.abs(size, out=size)
        np.abs(u, out=u)
        at_limit = np.isfinite(u) & (u >= AT_LIMIT * limit)
        (peak, rms), (late_peak, late_rms) = _peak_and_rms(size), _peak_and_rms(size[late:])
        peak_effort, rms_effort = _peak_and_rms(u)
        found = JointMetrics(
            joint=joint,
            position_unit=units.position,
            effort_unit=units.effort,
            initial_error_rad=float(first[j]),
            peak_error_rad=peak,
            rms_error_rad=rms,
            peak_error_after_2s_rad=late_peak,
            rms_error_after_2s_rad=late_rms,
            settling_time_2_percent_s=settling_time(t, size, band),
            peak_effort_nm=peak_effort,
            rms_effort_nm=rms_effort,
            effort_limit_nm=float(limit),
            saturated_fraction=_share(at_limit, ~np.isnan(u)) if np.isfinite(limit) else np.nan,
        )
        joints.append(found)
        np.maximum(largest, size, out=largest)
        commanded, saturated = commanded & np.isfinite(u), saturated | at_limit
    peaks, limits, late_peaks = (
        np.array([getattr(each, name) for each in joints])
        for name in ("peak_effort_nm", "effort_limit_nm", "peak_error_after_2s_rad")
    )
    share, share_at = _largest(peaks / limits, run.joints)
    limited = commanded.any() and np.isfinite(limits).any()
    return joints, Tracking(
        peak_effort_nm=_largest(peaks, run.joints)[0],
        peak_effort_joint=_largest(peaks, run.joints)[1],
        largest_share_joint=share_at if share > 0 else None,
        max_error_after_2s_joint=_largest(late_peaks, run.joints)[1],
        peak_effort_by_joint_nm=dict(zip(run.joints, peaks.tolist(), strict=True)),
        effort_limit_by_joint_nm=dict(zip(run.joints, limits.tolist(), strict=True)),
        largest_share_of_effort_limit=share if share > 0 else None,
        initial_error_rad=float(first.max()),
        max_error_after_2s_rad=_largest(late_peaks, run.joints)[0],
        rms_error_after_2s_rad=float(np.sqrt(np.mean([each.rms_error_after_2s_rad**2 for each in joints]))),
        settling_time_2_percent_s=settling_time(t, largest, band),
        saturated_fraction=_share(saturated, commanded) if limited else None,
        reference_mismatch_rad=run.reference_mismatch,
    )


def settling_time(t: Array, values: Array, band: float) -> float | None:
    """Return the first time [s] after the last one at which values (k,) exceed the band; None if never or unknown."""
    outside = np.flatnonzero(values > band)
    after = int(outside[-1]) + 1 if outside.size else 0
    return float(t[after]) if np.isfinite(band) and np.isfinite(values).any() and after < len(t) else None


def _peak_and_rms(values: Array) -> tuple[float, float]:
    """Return the largest and the root mean square of the values that are known; NaN without any."""
    unknown = np.isnan(values)
    known = values[~unknown] if unknown.any() else values  # a long run has many: no copy
    return (float(known.max()), math.sqrt(known @ known / len(known))) if len(known) else (math.nan, math.nan)


def _share(some: NDArray[np.bool_], among: NDArray[np.bool_]) -> float:
    return float((some & among).sum() / among.sum()) if among.any() else math.nan


def _largest(values: Array, joints: Sequence[str]) -> tuple[float, str | None]:
    """Return the largest of values (n,) and its joint; NaN and None if all are unknown."""
    if np.isnan(values).all():
        return math.nan, None
    j = int(np.nanargmax(values))
    return float(values[j]), joints[j]


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


def storage(t: Array, V: Array, beta: float, proven: bool) -> Storage | None:
    """Return the metrics of V (k,) [J] at times t (k,) [s]; None if it is not known.

    beta [1/s]: V(t) <= V(0) exp(-2 beta t) in continuous time; proven: whether it is.
    """
    if not np.isfinite(V[0]):
        return None
    bound, relative = V[0] * np.exp(-2.0 * beta * t), V / (V[0] or 1.0)
    first, within = int(np.argmax(relative <= DECAYED)), bound >= V
    leaves, decayed = len(t) - int(np.argmax(within[::-1])) if within.any() else 0, 0 < relative[first] <= DECAYED
    ratio = np.divide(V, bound, out=bound, where=bound > 0)
    steady = relative[t >= STEADY_AFTER]
    return Storage(
        initial=float(V[0]),
        guaranteed_decay_rate_per_s=2.0 * beta,
        guarantee_is_proven=proven,
        measured_decay_rate_per_s=float(-np.log(relative[first]) / t[first]) if decayed else None,
        leaves_bound_at_s=float(t[leaves]) if leaves < len(t) else None,
        relative_where_it_leaves=float(relative[leaves]) if leaves < len(t) else None,
        largest_ratio_to_bound_before=float(ratio[:leaves].max(initial=1.0)),
        max_relative_after_2s=float(steady.max()) if steady.size else None,
    )


@dataclass(frozen=True)
class Energy:
    """The power balance [J] over the steps whose powers are all known: stored = supplied - dissipated + residual."""

    supplied_j: float
    dissipated_j: float
    stored_j: float
    residual_j: float
    rms_residual_of_supplied: float  # RMS of the residual power, relative to that of the supplied power


def steps(part: RunData, B_m: Array, beta: float, before: Array) -> dict[str, Array]:
    """Return the mean powers (k,) [W] in the step that ends at each new state of a part, NaN: unknown.

    watts (k, 4): FLOWS, with the measured motor torque where available; joules (k, 4) [J]: their integrals from before
    (4,) on, over steps with all. measured, predicted, least: -dV/dt, that of the model, 2 beta V. B_m: input matrix.
    """
    n, dt, V = part.u.shape[1], np.diff(part.t), part.V
    displacement, dissipated = np.diff(part.position[:, n:], axis=0), part.certificate.dissipated
    with np.errstate(divide="ignore", invalid="ignore"):
        supplied, stored = (_torque(part, B_m) * displacement).sum(axis=1) / dt, np.diff(part.certificate.H) / dt
        dissipated = (dissipated[:-1] + dissipated[1:]) / 2
        watts = np.column_stack([supplied, dissipated, stored, stored - supplied + dissipated])
        found = {
            "watts": watts,
            "joules": np.where(np.isfinite(watts[:, 3:]), watts, 0.0) * dt[:, None],
            "measured": -np.diff(V) / dt,
            "predicted": -part.certificate.held_rate(part.held),
            "least": beta * (V[:-1] + V[1:]),
        }
    found = {name: np.insert(values, 0, np.nan, axis=0)[part.begin :] for name, values in found.items()}
    return found | {"joules": before + np.nancumsum(found["joules"], axis=0)}


def _torque(part: RunData, B_m: Array) -> Array:
    """Return the mean motor torque over each step (k - 1, n) [N m]; a new effort acts from its arrival on."""
    after = np.vstack([0 * part.u[:1], part.held[:-1] @ B_m.T]) if part.u_applied is None else part.torque
    if part.lockstep:
        return after[1:]
    late = np.clip(np.nan_to_num(part.latency) / part.sample_period, 0.0, 1.0)[:-1, None]
    return np.asarray(late * after[:-1] + (1.0 - late) * after[1:])


def energy(columns: Columns) -> Energy:
    """Return the energies of a run, NaN: no supplied power is known; columns: those of `steps` for all states."""
    squares, joules, steps = np.zeros(len(FLOWS)), np.zeros(len(FLOWS)), 0
    for part in columns.parts():
        known = part["watts"][np.isfinite(part["watts"][:, -1])]
        squares, joules, steps = squares + (known**2).sum(axis=0), part["joules"][-1], steps + len(known)
    supplied, *_, residual = np.sqrt(squares)
    share = residual / supplied if supplied else math.nan
    return Energy(*np.append(joules if steps else math.nan * joules, share).tolist())


@dataclass(frozen=True)
class Timing:
    """Statistics of the middleware's send times: period of the states, latency from state to command."""

    period_p50_us: float
    period_p99_us: float
    period_max_us: float
    latency_p50_us: float
    latency_p99_us: float
    latency_max_us: float


@dataclass(frozen=True)
class Counts:
    """Sample counts: nominal = published + missing; published = answered + unanswered."""

    nominal: int  # duration times rate; one more if the first state was late, so that one more fits
    published: int  # states recorded
    missing: int  # nominal - published (negative: more states than nominal)
    gaps: int  # steps between stamps longer than 1.5 sample periods
    longest_gap_s: float
    answered: int | None  # states with a recorded command; this and the next three null: no command was recorded
    answered_in_time: int | None  # command sent before the next state
    late: int | None  # command sent after the next state
    unanswered: int | None
    published_fraction: float  # of nominal
    answered_in_time_fraction: float | None  # of published
    lost_by_recorder: dict[str, int | None]  # topic -> gaps in the sequence numbers; null: several publishers


def quantiles(times: Times) -> list[float]:
    """Return median, 99 % and largest of times (k,) [ns], which are sorted in part, in us; NaN without any."""
    found = np.quantile(times, (0.5, 0.99, 1.0), overwrite_input=True) if len(times) else np.full(3, np.nan)
    return (1e-3 * found).tolist()


def counts(run: Recording, duration: float) -> Counts:
    """Return the sample counts of a run of `duration` [s].

    A command is in time if it is sent before the next state; that of the last state, before the next one is due.
    """
    signals, period, states = run.signals, run.sample_period, len(run.signals.stamp)
    due = END if run.lockstep else signals.sent[-1] + round(period * 1e9)
    known, steps = signals.answered >= 0, np.diff(signals.stamp) * 1e-9
    answered, in_time = int(known.sum()), int((known & (signals.answered < np.append(signals.sent[1:], due))).sum())
    nominal = round(duration / period)
    nominal += states == nominal + 1  # times count from the first state: if that was late, the last is not
    return Counts(
        nominal=nominal,
        published=states,
        missing=nominal - states,
        gaps=int((steps > 1.5 * period).sum()),
        longest_gap_s=float(steps.max(initial=0.0)),
        answered=answered if answered else None,
        answered_in_time=in_time if answered else None,
        late=answered - in_time if answered else None,
        unanswered=states - answered if answered else None,
        published_fraction=states / nominal,
        answered_in_time_fraction=in_time / states if answered else None,
        lost_by_recorder={topic: each.lost for topic, each in sorted(run.bag.topics.items())},
    )
