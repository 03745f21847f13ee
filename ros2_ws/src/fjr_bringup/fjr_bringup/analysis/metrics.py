# SPDX-License-Identifier: Apache-2.0
"""Compute the metrics of a run from its bag and scenario: report.json. Unknown metrics are null.

docs/reports.md defines each metric.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from fjr_bringup.analysis.controller_stop import ControllerStop
from fjr_bringup.analysis.diagnosis import Diagnosis, diagnosis
from fjr_bringup.analysis.joint_metrics import (
    AT_LIMIT,
    SETTLED,
    STEADY_AFTER,
    JointMetrics,
    initial_error,
    joint_metrics,
    rms,
    settling_time,
)
from fjr_bringup.analysis.power_balance import Power
from fjr_bringup.analysis.run_data import RunData
from fjr_bringup.analysis.status import Status, advice_on, status_of
from fjr_bringup.analysis.timing import Counts, Timing, counts, timing
from fjr_bringup.atomic_file import write_text
from fjr_bringup.provenance import Provenance
from fjr_bringup.recording.reader import Array, Bag
from fjr_bringup.result import finite
from fjr_core.config.scenario import Scenario

DECAYED = 1e-4  # of V(0): the decay rate is measured down to this value
VERSIONS = ("fjr", "fjr_core", "fjr_bringup", "ros-jazzy-rclpy", "rclpy", "numpy", "casadi", "mcap", "rosbags")


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
    max_error_after_2s_rad: float | None
    rms_error_after_2s_rad: float | None
    settling_time_2_percent_s: float | None  # |error| stays within 2 % of the initial one
    saturated_fraction: float | None  # commands with any joint at its limit; null: no limit
    reference_mismatch_rad: float  # recorded minus planned reference: a cross-check, near 0


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


@dataclass(frozen=True)
class Energy:
    """The power balance, integrated over the run [J]: stored = supplied - dissipated + residual."""

    supplied_j: float
    dissipated_j: float
    stored_j: float
    residual_j: float
    rms_residual_of_supplied: float  # RMS of the residual power, relative to that of the supplied power


@dataclass(frozen=True)
class Report:
    """All metrics of one run."""

    scenario: str
    duration_s: float
    sample_period_s: float
    lockstep: bool
    bag: str
    bag_complete: bool  # closed by the recorder; else run or recorder were killed
    stop: ControllerStop | None  # first stop of the controller; null: it never stopped
    verdict: Diagnosis
    missing: tuple[str, ...]  # missing signals and their substitutes
    tracking: Tracking
    joints: list[JointMetrics]
    storage: Storage | None  # null: V is unknown without motor positions
    energy: Energy | None
    timing: Timing
    counts: Counts
    diagnostics: dict[str, dict[str, str]]  # last diagnostics of each node
    versions: dict[str, str]
    not_recorded: dict[str, str] = field(default_factory=dict)  # topic -> why it was not recorded
    failure: str = ""  # why the run ended early
    planned_s: float | None = None  # planned duration; null: unknown
    guesses: tuple[str, ...] = ()  # values of the robot that are guesses, a sentence for each kind
    provenance: Provenance | None = None  # of the command that recorded the run; null: unknown

    @property
    def status(self) -> Status:
        """Return the run in one word: the verdict, unless the controller stopped or the computer was too late."""
        return status_of(self.stop, self.verdict, self.counts, self.lockstep)

    @property
    def advice(self) -> str:
        """Return what to do about the status, as a sentence; may be empty."""
        return advice_on(self.status, self.counts, self.lockstep)

    def of_joint(self, joint: str | None) -> JointMetrics:
        """Return the metrics of a joint, of the first one for None."""
        return next((each for each in self.joints if each.joint == joint), self.joints[0])

    def as_json(self) -> dict[str, Any]:
        """Return the metrics as JSON values; non-finite numbers become None."""
        return dict(finite({"status": self.status, "advice": self.advice, **asdict(self)}))

    def write(self, path: Path) -> None:
        """Write the report as JSON."""
        write_text(path, json.dumps(self.as_json(), indent=2, allow_nan=False) + "\n")


def make_report(name: str, bag: Bag, scenario: Scenario, data: RunData, flow: Power, duration: float) -> Report:
    """Return the report of a run of `duration` seconds of stamped time with the power balance `flow`."""
    return Report(
        scenario=name,
        duration_s=duration,
        sample_period_s=data.sample_period,
        lockstep=data.lockstep,
        bag=str(bag.path),
        bag_complete=bag.complete,
        stop=data.stop,
        verdict=diagnosis(data, scenario),
        missing=(*bag.notes, *data.notes),
        tracking=_tracking(data),
        joints=joint_metrics(data),
        storage=_storage(data) if np.isfinite(data.V[0]) else None,
        energy=_energy(flow) if np.isfinite(data.H[0]) else None,
        timing=timing(data),
        counts=counts(data, duration, bag.lost()),
        diagnostics=bag.counters(),
        versions=_versions(),
        guesses=scenario.guess_warnings,
    )


def _tracking(data: RunData) -> Tracking:
    size = np.abs(data.error).max(axis=1)
    steady = data.error[data.t >= STEADY_AFTER]
    peak, peak_joint = _largest(data.peak_effort, data.joints)
    share, share_joint = _largest(data.peak_effort / data.effort_limit, data.joints)
    worst, worst_joint = _largest(np.abs(steady).max(axis=0), data.joints) if steady.size else (None, None)
    joints = joint_metrics(data)
    return Tracking(
        peak_effort_nm=peak,
        peak_effort_joint=peak_joint,
        largest_share_joint=share_joint if share > 0 else None,
        max_error_after_2s_joint=worst_joint,
        peak_effort_by_joint_nm={each.joint: each.peak_effort_nm for each in joints},
        effort_limit_by_joint_nm={each.joint: each.effort_limit_nm for each in joints},
        largest_share_of_effort_limit=share if share > 0 else None,
        initial_error_rad=float(size[0]),
        max_error_after_2s_rad=worst,
        rms_error_after_2s_rad=rms(steady) if steady.size else None,
        settling_time_2_percent_s=settling_time(data.t, size, SETTLED * initial_error(data)),
        saturated_fraction=_saturated(data),
        reference_mismatch_rad=data.reference_mismatch,
    )


def _largest(values: Array, joints: Sequence[str]) -> tuple[float, str | None]:
    """Return the largest of values (n,) and its joint; NaN and None if all are unknown."""
    if np.isnan(values).all():
        return math.nan, None
    j = int(np.nanargmax(values))
    return float(values[j]), joints[j]


def _saturated(data: RunData) -> float | None:
    """Return the fraction of commands with any joint at its limit; None without limits."""
    sent = data.u[np.isfinite(data.u).all(axis=1)]
    if not (len(sent) and np.isfinite(data.effort_limit).any()):
        return None
    return float((np.abs(sent) >= AT_LIMIT * data.effort_limit).any(axis=1).mean())


def _energy(flow: Power) -> Energy:
    supplied, dissipated, stored, residual = (
        float(np.nansum(each * flow.dt)) for each in (flow.supplied, flow.dissipated, flow.stored, flow.residual)
    )
    known = np.isfinite(flow.residual)
    left = rms(flow.residual[known]) / (rms(flow.supplied[known]) or np.nan) if known.any() else np.nan
    return Energy(supplied, dissipated, stored, residual, left)


def _storage(data: RunData) -> Storage:
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


def _versions() -> dict[str, str]:
    found = {}
    for name in VERSIONS:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found
