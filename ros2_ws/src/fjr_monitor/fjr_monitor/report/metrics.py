# SPDX-License-Identifier: Apache-2.0
"""Compute the metrics of a run from its bag and scenario: report.json. Unknown metrics are null.

docs/tables/json.md defines each metric.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Literal

import numpy as np

from fjr_core.config.law import robust as build_robust
from fjr_core.law.rate import NO_RATE
from fjr_core.model.joints import joined
from fjr_monitor.diagnosis.diagnosis import FirstPass, SecondPass
from fjr_monitor.diagnosis.record import PART, parts_of
from fjr_monitor.diagnosis.thresholds import JointTolerances
from fjr_monitor.diagnosis.verdict import EXTERNAL, SAMPLING, Diagnosis, unknown
from fjr_monitor.recording.columns import Columns
from fjr_monitor.recording.run import ControllerStop, Recording
from fjr_monitor.report import performance
from fjr_monitor.report.contact import Contact, contact
from fjr_monitor.report.performance import quantiles
from fjr_msgs_py.console.output import finite, milli, number, percent
from fjr_msgs_py.console.provenance import Provenance

AFTER_CONTACT = 0.5  # s
KEEPS_UP = 0.9  # fraction of states answered in time below which a run shows the computer, not the law
IN_TIME = 0.99  # the same, if one of TIMED is the first cause
TIMED = ("delay", "loss", SAMPLING)
VERSIONS = ("fjr", "fjr_core", "fjr_bringup", "ros-jazzy-rclpy", "rclpy", "numpy", "casadi", "mcap", "rosbags")

Status = Literal["stopped", "late", "holding", "degraded", "violated", "unknown"]


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
    tracking: performance.Tracking
    joints: list[performance.JointMetrics]
    storage: performance.Storage | None  # null: V is unknown without motor positions
    energy: performance.Energy | None
    timing: performance.Timing
    counts: performance.Counts
    diagnostics: dict[str, dict[str, str]]  # last diagnostics of each node
    versions: dict[str, str]
    not_recorded: dict[str, str] = field(default_factory=dict)  # topic -> why it was not recorded
    failure: str = ""  # why the run ended early
    planned_s: float | None = None  # planned duration; null: unknown
    guesses: tuple[str, ...] = ()  # values of the robot that are guesses, a sentence for each kind
    contact: Contact | None = None  # null: the verdict has no external torque
    provenance: Provenance | None = None  # of the command that recorded the run; null: unknown

    @property
    def status(self) -> Status:
        """Return the run in one word: "stopped", "late" if late answers leave no verdict, otherwise the verdict.

        They do so in real time for a violation and without V, if less than KEEPS_UP of the states were answered in time
        or, with one of TIMED as the first cause, less than IN_TIME were, or arrived.
        """
        if self.stop:
            return "stopped"
        in_time = self.counts.answered_in_time_fraction
        if self.verdict.kind not in ("violated", "unknown") or self.lockstep or in_time is None:
            return self.verdict.kind
        timed = any(cause in TIMED for cause in self.verdict.causes[:1])
        late = min(in_time, self.counts.published_fraction) < IN_TIME if timed else in_time < KEEPS_UP
        return "late" if late else self.verdict.kind

    @property
    def advice(self) -> str:
        """Return what to do about late answers, as a sentence; empty if they explain neither status nor stop.

        It explains a stop in real time if less than KEEPS_UP of the answers were in time.
        """
        answered, in_time = self.counts.answered or 0, self.counts.answered_in_time or 0
        stopped_late = self.status == "stopped" and not self.lockstep and in_time < KEEPS_UP * answered
        if self.status != "late" and not stopped_late:
            return ""
        share, arrived = self.counts.answered_in_time_fraction or 0.0, self.counts.published_fraction
        what = "missing" if (self.counts.unanswered or 0) > (self.counts.late or 0) else "late"
        seen = f"answers are {what} ({percent(share, 0)} of the states were answered in time)"
        if arrived < share:
            seen = f"states are missing ({percent(arrived, 0)} of them arrived)"
        return f"{seen}, so this run does not judge the law; try --lockstep"

    @property
    def position_unit(self) -> str:
        """Return the position unit of the joints: rad, m, or both."""
        return joined(each.position_unit for each in self.joints)

    @property
    def error_unit(self) -> str:
        """Return the unit of tracking errors as they are shown: mrad, mm, or both."""
        return joined(f"m{each.position_unit}" for each in self.joints)

    @property
    def effort_unit(self) -> str:
        """Return the effort unit of the joints: N m, N, or both."""
        return joined(each.effort_unit for each in self.joints)

    def peak_effort(self) -> str:
        """Return the peak effort, e.g. 43.1 N m (joint2)."""
        joint = self.tracking.peak_effort_joint
        return number(self.tracking.peak_effort_nm, self._joint(joint).effort_unit, 4) + self._at(joint)

    def effort_share(self) -> str:
        """Return the largest share of an effort limit, e.g. 68 % of its limit (joint4); empty without limits."""
        share = self.tracking.largest_share_of_effort_limit
        at = self._at(self.tracking.largest_share_joint)
        return "" if share is None else f"{percent(share, 0)} of its limit{at}"

    def peak_effort_and_share(self) -> str:
        """Return both, e.g. 43.1 N m (joint2), 68 % of its limit (joint4)."""
        return ", ".join(filter(None, (self.peak_effort(), self.effort_share())))

    def initial_error(self) -> str:
        """Return the largest initial error, e.g. 500 mrad (joint2)."""
        worst = max(self.joints, key=lambda each: each.initial_error_rad)
        return milli(worst.initial_error_rad, worst.position_unit) + self._at(worst.joint)

    def rms_error(self) -> str:
        """Return the RMS error after 2 s, over the joints of each kind, e.g. 0.14 mrad and 0.02 mm."""
        squares: dict[str, list[float]] = {}
        for each in self.joints:
            squares.setdefault(each.position_unit, []).append(each.rms_error_after_2s_rad**2)
        return " and ".join(milli(float(np.sqrt(np.mean(of))), unit) for unit, of in squares.items())

    def steady_error(self) -> str:
        """Return the largest error after 2 s, e.g. 0.14 mrad (joint2)."""
        error, joint = self.tracking.max_error_after_2s_rad, self.tracking.max_error_after_2s_joint
        return milli(error, self._joint(joint).position_unit) + self._at(joint)

    def _joint(self, name: str | None) -> performance.JointMetrics:
        """Return the metrics of a joint, of the first one for None."""
        return next((each for each in self.joints if each.joint == name), self.joints[0])

    def _at(self, joint: str | None) -> str:
        return f" ({joint})" if joint and len(self.joints) > 1 else ""

    def as_json(self) -> dict[str, Any]:
        """Return the metrics as JSON values; non-finite numbers become None."""
        return dict(finite({"status": self.status, "advice": self.advice, **asdict(self)}))


class Metrics:
    """What is known of a run once its parts were read twice: first what the second reading depends on.

    columns: V, H, and powers and energies of `steps`, beside the columns of the run. beta [1/s], proven: rate of V.
    """

    def __init__(self, run: Recording, size: int = PART) -> None:
        self.run, self.columns = run, Columns()
        self._diagnosis: SecondPass | None = None
        rate = NO_RATE
        if (law := run.scenario.certified_law) is not None:
            scales = JointTolerances.of(run.scenario.controller_values, run.scenario.robot)
            first = FirstPass(run, law, scales, size)
            rate = first.visited.rate(law)
            self._diagnosis = SecondPass(first, rate.beta)
        self.beta, self.proven = rate.beta, rate.proven and run.scenario.plant_is_the_model
        joules = np.zeros(len(performance.FLOWS))
        for part in parts_of(run, size):
            found = performance.steps(part, run.scenario.robot.B_m, rate.beta, joules)
            joules = found["joules"][-1]
            self.columns.add(V=part.V[part.begin :], H=part.certificate.H[part.begin :], **found)
            if self._diagnosis is not None:
                self._diagnosis.add(part, part.certificate)
        self.energy_known = bool(np.isfinite(self.columns.column("H")[0]))
        self.efforts_known = any(np.isfinite(run.columns.column("u", j)).any() for j in range(len(run.joints)))

    def verdict(self) -> Diagnosis:
        """Return whether V decayed as guaranteed, and the causes if it did not."""
        values = self.run.scenario.controller_values
        if self._diagnosis is None:
            return unknown(f"the law {values['law.type']} has no certificate")
        if not np.isfinite(self.columns.column("V")).any():
            return unknown("V is not known: the bag lacks links or motors")
        if not self.efforts_known:
            return unknown("no effort of the controller was recorded")
        if not build_robust(values, self.run.scenario.robot.n).off:
            return unknown("V does not include the disturbance estimate (robust.* is enabled)")
        return self._diagnosis.result(self.run.velocities_measured)

    def report(self, name: str, duration: float, **more: Any) -> Report:
        """Return the report of `duration` seconds of stamped time; more: fields that the bag does not hold."""
        run, verdict, law = self.run, self.verdict(), self.run.scenario.certified_law
        touching = next((each.joint.split(", ") for each in verdict.findings if each.kind == EXTERNAL), None)
        stop, touched = run.stop, contact(run, law, touching) if touching and law else None
        if stop and touched and touched.begins_s <= stop.at_s <= touched.ends_s + AFTER_CONTACT:
            stop = replace(stop, reason=f"{stop.reason}; {touched.sentence}")
        joints, tracking = performance.tracked(run)
        versions: dict[str, str] = {}
        for each in VERSIONS:
            with suppress(PackageNotFoundError):
                versions[each] = version(each)
        return Report(
            scenario=name,
            duration_s=duration,
            sample_period_s=run.sample_period,
            lockstep=run.lockstep,
            bag=str(run.bag.path),
            bag_complete=run.bag.complete,
            stop=stop,
            verdict=verdict,
            contact=touched,
            missing=(*run.bag.notes, *run.notes),
            tracking=tracking,
            joints=joints,
            storage=performance.storage(run.columns.column("t"), self.columns.column("V"), self.beta, self.proven),
            energy=performance.energy(self.columns) if self.energy_known else None,
            timing=performance.Timing(*quantiles(run.signals.periods), *quantiles(run.signals.latencies)),
            counts=performance.counts(run, duration),
            diagnostics=run.signals.counters,
            versions=versions,
            guesses=run.scenario.robot_warnings,
            **more,
        )
