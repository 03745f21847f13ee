# SPDX-License-Identifier: Apache-2.0
"""Figures of a run, from its bag and scenario alone: report.json. Absent figures are null, never invented."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from fjr_bringup.bag import Array, Bag
from fjr_bringup.tracking_data import TrackingData
from fjr_core.scenario import Scenario

STEADY_AFTER = 2.0  # s; figures "after 2 s" tell the tracking error once the transient is over
SETTLED = 0.02  # of the initial error
DECAYED = 1e-4  # of V(0): down to there the decay rate is measured
VERSIONS = ("fjr_core", "fjr_bringup", "ros-jazzy-rclpy", "rclpy", "numpy", "casadi", "mcap", "rosbags")


@dataclass(frozen=True)
class Tracking:
    """How well the joints followed; errors and efforts are the largest of all joints."""

    peak_effort_nm: float
    peak_effort_by_joint_nm: dict[str, float]
    effort_limit_by_joint_nm: dict[str, float]  # null: none is given
    largest_share_of_effort_limit: float | None  # of all joints that have a limit; null: none has
    initial_error_rad: float
    max_error_after_2s_rad: float | None
    rms_error_after_2s_rad: float | None
    settling_time_2_percent_s: float | None  # from then on |error| stays within 2 % of the initial one
    reference_mismatch_rad: float  # recorded reference against the scenario's: a cross-check, near 0


@dataclass(frozen=True)
class Storage:
    """Storage function V against its bound V(0) exp(-2 beta t), which is proven for continuous time.

    The loop is sampled: a late command lifts V over the bound for a moment, and once V is tiny the hold keeps
    it on a floor while the bound goes on towards zero.
    """

    initial: float
    guaranteed_decay_rate_per_s: float  # 2 beta
    guarantee_is_proven: bool  # for every configuration; else 2 beta is the least at configurations of the run
    measured_decay_rate_per_s: float | None  # mean rate while V falls from V(0) to 1e-4 V(0)
    leaves_bound_at_s: float | None  # stays above it from then on; null: never
    relative_where_it_leaves: float | None  # V / V(0) there
    largest_ratio_to_bound_before: float  # 1 or less: V never passed the bound before it left for good
    max_relative_after_2s: float | None  # the floor, V / V(0)


@dataclass(frozen=True)
class Timing:
    """Send times as stamped by the middleware: period of the states; from a state to its command."""

    period_p50_us: float
    period_p99_us: float
    period_max_us: float
    latency_p50_us: float
    latency_p99_us: float
    latency_max_us: float


@dataclass(frozen=True)
class Counts:
    """Every sample is in here: nominal = published + missing; published = answered + unanswered."""

    nominal: int  # duration times rate
    published: int  # states recorded
    missing: int  # nominal samples that are not in the bag (negative: more came than nominal)
    gaps: int  # steps between stamps longer than 1.5 sample periods
    longest_gap_s: float
    answered: int  # states whose command was recorded
    answered_in_time: int  # before the next state was sent
    late: int  # after it
    unanswered: int
    published_fraction: float  # of nominal
    answered_in_time_fraction: float  # of nominal
    lost_by_recorder: dict[str, int | None]  # topic -> gaps in the publisher's numbering; null: several publish


@dataclass(frozen=True)
class Report:
    """All figures of one run."""

    scenario: str
    duration_s: float
    sample_period_s: float
    lockstep: bool
    tracking: Tracking
    storage: Storage
    timing: Timing
    counts: Counts
    diagnostics: dict[str, dict[str, str]]  # last counters of each node
    versions: dict[str, str]
    not_recorded: dict[str, str] = field(default_factory=dict)  # topic -> why the recorder left it out
    failure: str = ""  # why the run ended before its time

    def write(self, path: Path) -> None:
        """Write the report as JSON with finite numbers only."""
        path.write_text(json.dumps(_finite(asdict(self)), indent=2, allow_nan=False) + "\n", encoding="utf-8")


def make_report(name: str, bag: Bag, scenario: Scenario, data: TrackingData, duration: float) -> Report:
    """The report of a run of `duration` seconds of stamped time."""
    return Report(
        scenario=name,
        duration_s=duration,
        sample_period_s=data.sample_period,
        lockstep=bool(scenario.plant_values["lockstep"]),
        tracking=_tracking(data),
        storage=_storage(data),
        timing=_timing(data),
        counts=_counts(data, duration, bag.lost()),
        diagnostics=bag.counters(),
        versions=_versions(),
    )


def _tracking(data: TrackingData) -> Tracking:
    size = np.abs(data.error).max(axis=1)
    steady = data.error[data.t >= STEADY_AFTER]
    share = float((data.peak_effort / data.effort_limit).max())
    return Tracking(
        peak_effort_nm=float(data.peak_effort.max()),
        peak_effort_by_joint_nm=dict(zip(data.joints, data.peak_effort.tolist(), strict=True)),
        effort_limit_by_joint_nm=dict(zip(data.joints, data.effort_limit.tolist(), strict=True)),
        largest_share_of_effort_limit=share if share > 0 else None,
        initial_error_rad=float(size[0]),
        max_error_after_2s_rad=float(np.abs(steady).max()) if steady.size else None,
        rms_error_after_2s_rad=float(np.sqrt((steady**2).mean())) if steady.size else None,
        settling_time_2_percent_s=_settling_time(data.t, size),
        reference_mismatch_rad=data.reference_mismatch,
    )


def _settling_time(t: Array, size: Array) -> float | None:
    outside = np.flatnonzero(size > SETTLED * size[0])
    if outside.size == 0:
        return 0.0
    return float(t[outside[-1] + 1]) if outside[-1] + 1 < len(t) else None


def _storage(data: TrackingData) -> Storage:
    relative, ratio = data.relative_storage, data.V / data.bound
    within = np.flatnonzero(ratio <= 1.0)  # V(0) itself is on the bound, unless it is 0
    leaves = int(within[-1]) + 1 if within.size else 0
    low = np.flatnonzero(relative <= DECAYED)
    steady = relative[data.t >= STEADY_AFTER]
    stays = leaves == len(data.t)
    return Storage(
        initial=float(data.V[0]),
        guaranteed_decay_rate_per_s=2.0 * data.beta,
        guarantee_is_proven=data.beta_is_proven,
        measured_decay_rate_per_s=float(-np.log(relative[low[0]]) / data.t[low[0]]) if low.size else None,
        leaves_bound_at_s=None if stays else float(data.t[leaves]),
        relative_where_it_leaves=None if stays else float(relative[leaves]),
        largest_ratio_to_bound_before=float(ratio[:leaves].max(initial=1.0)),
        max_relative_after_2s=float(steady.max()) if steady.size else None,
    )


def _timing(data: TrackingData) -> Timing:
    latency = data.latency[~np.isnan(data.latency)]
    return Timing(*_percentiles(np.diff(data.sent)), *_percentiles(latency))


def _percentiles(seconds: Array) -> tuple[float, float, float]:
    """50 %, 99 % and largest, in microseconds."""
    values = seconds * 1e6 if seconds.size else np.array([np.nan])
    return float(np.percentile(values, 50)), float(np.percentile(values, 99)), float(values.max())


def _counts(data: TrackingData, duration: float, lost_messages: dict[str, int | None]) -> Counts:
    nominal, published = round(duration / data.sample_period), len(data.t)
    answered = ~np.isnan(data.answered)
    in_time = int((data.answered < data.deadline)[answered].sum())
    steps = np.diff(data.t, append=data.t[-1])
    return Counts(
        nominal=nominal,
        published=published,
        missing=nominal - published,
        gaps=int((steps > 1.5 * data.sample_period).sum()),
        longest_gap_s=float(steps.max()),
        answered=int(answered.sum()),
        answered_in_time=in_time,
        late=int(answered.sum()) - in_time,
        unanswered=published - int(answered.sum()),
        published_fraction=published / nominal,
        answered_in_time_fraction=in_time / nominal,
        lost_by_recorder=lost_messages,
    )


def _versions() -> dict[str, str]:
    found = {}
    for name in VERSIONS:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def _finite(value: Any) -> Any:
    """The same with null for numbers that are not finite."""
    if isinstance(value, Mapping):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
