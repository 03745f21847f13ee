# SPDX-License-Identifier: Apache-2.0
"""Compute the metrics of a run from its bag and scenario: report.json. Unknown metrics are null.

docs/tables/json.md defines each metric.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from fjr_core.config.controller import axes
from fjr_core.config.law import robust as build_robust
from fjr_core.config.scenario import Scenario
from fjr_core.files import importing as other_package
from fjr_core.files.text_file import write_text
from fjr_core.law.rate import NO_RATE, Rate
from fjr_core.motions.domain import Domain
from fjr_core.numerics.checks import Array
from fjr_monitor.analysis.controller_stop import ControllerStop
from fjr_monitor.analysis.run_data import Recording, RunData
from fjr_monitor.analysis.status import Status, advice_on, status_of
from fjr_monitor.analysis.storage import Balance, Decay, Energy, Power, Storage, power
from fjr_monitor.analysis.timing import Clock, Counts, Timing
from fjr_monitor.analysis.tracking import JointMetrics, Tracked, Tracking
from fjr_monitor.diagnosis.diagnosis import Diagnosis, Outline, PartwiseDiagnosis, unknown
from fjr_msgs_py.console.output import finite
from fjr_msgs_py.console.provenance import Provenance

FARTHEST = 1e4  # rad or m; a run that goes beyond has lost its robot, and bounds may overflow
VISITED = 200  # configurations of a run at which the rate is evaluated
VERSIONS = ("fjr", "fjr_core", "fjr_bringup", "ros-jazzy-rclpy", "rclpy", "numpy", "casadi", "mcap", "rosbags")


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


class Metrics:
    """What is known of a run once all its parts were read twice: first what the second reading depends on."""

    def __init__(self, run: Recording) -> None:
        self.run, self._B_m = run, run.scenario.robot.B_m
        self._visited, law = Visited(run.scenario, run.states), run.scenario.certified_law
        self._diagnosis: PartwiseDiagnosis | None = None
        if law is not None:
            scales = axes(run.scenario.controller_values, run.scenario.robot)
            outline = Outline(run.states, run.step, not run.lockstep)
            self._diagnosis = PartwiseDiagnosis(law, outline, scales)
        self.efforts_known = self.energy_known = self._storage_known = False
        self._learn()
        rate = self._visited.rate()
        self.decay = Decay(rate.beta, rate.proven and run.scenario.plant_is_the_model)
        self.tracked, self.balance = Tracked(run), Balance()
        self.clock = Clock(run.sample_period, run.lockstep)
        self.seconds = 0.0  # of the last state

    def read(self, also: Callable[[RunData, Power], None] = lambda part, flow: None) -> None:
        """Read all parts for the second time; also: what else is to see each part and its power balance."""
        for part in self.run.parts():
            flow = power(part, self._B_m)
            self.energy_known = bool(np.isfinite(part.certificate.H[0])) if not part.begin else self.energy_known
            self._storage_known |= bool(np.isfinite(part.V).any())
            self.clock.add(part.t, part.sent, part.answered, part.begin)
            self.tracked.add(part)
            self.decay.add(part)
            self.balance.add(flow)
            if self._diagnosis is not None:
                self._diagnosis.judge(part, self.decay.beta, part.certificate)
            also(part, flow)
            self.seconds = float(part.t[-1])

    def verdict(self) -> Diagnosis:
        """Return whether V decayed as guaranteed, and the causes if it did not."""
        values = self.run.scenario.controller_values
        if self._diagnosis is None:
            return unknown(f"the law {values['law.type']} has no certificate")
        if not self._storage_known:
            return unknown("V is not known: the bag lacks links or motors")
        if not self.efforts_known:
            return unknown("no effort of the controller was recorded")
        if not build_robust(values, self.run.scenario.robot.n).off:
            return unknown("V does not include the disturbance estimate (robust.* is enabled)")
        return self._diagnosis.result(self.run.velocities_measured)

    def _learn(self) -> None:
        """Read all parts for the first time."""
        for part in self.run.parts():
            self._visited.add(part)
            self.efforts_known |= bool(np.isfinite(part.u).any())
            if self._diagnosis is not None:
                self._diagnosis.learn(part)


class Visited:
    """The configurations that a run visited: their box, the largest step between two, and some of them."""

    def __init__(self, scenario: Scenario, states: int) -> None:
        self._scenario, self._stride = scenario, max(1, states // VISITED)
        n = scenario.robot.n
        self._least, self._largest, self._step = np.full(n, np.inf), np.full(n, -np.inf), np.zeros(n)
        self._some: list[Array] = []
        self._count, self._finite = 0, True

    def add(self, part: RunData) -> None:
        """Add the new states of a part."""
        q_l, new = part.q_l, part.q_l[part.begin :]
        self._some.append(new[-self._count % self._stride :: self._stride].copy())
        self._count += len(new)
        self._finite = self._finite and bool(np.isfinite(new).all())
        self._least, self._largest = (
            np.minimum(self._least, new.min(axis=0)),
            np.maximum(self._largest, new.max(axis=0)),
        )
        self._step = np.maximum(self._step, np.max(np.abs(np.diff(q_l, axis=0)), axis=0, initial=0.0))

    def rate(self) -> Rate:
        """Return the convergence rate of v-dPBC: proven, else sampled at visited configurations.

        For an arm of a URDF the proof holds on the smallest box that contains all visited positions and the largest
        step between two of them.
        """
        law = self._scenario.certified_law
        if law is None:
            return NO_RATE
        rate = law.rate()
        if rate.proven or not self._finite:
            return rate
        farthest = max(np.abs(self._least).max(), np.abs(self._largest).max())
        bounds = other_package.module_if_there("fjr_proofs.verification.inertia_bounds")
        if bounds is None or not bounds.is_provable(self._scenario.robot) or farthest > FARTHEST:
            return law.rate(np.concatenate(self._some))
        domain = Domain(self._least - self._step, self._largest + self._step)
        return law.proven_rate(domain, most_boxes=bounds.few_boxes(self._scenario.robot))


def make_report(name: str, metrics: Metrics, duration: float) -> Report:
    """Return the report of a run of `duration` seconds of stamped time that was read."""
    run = metrics.run
    return Report(
        scenario=name,
        duration_s=duration,
        sample_period_s=run.sample_period,
        lockstep=run.lockstep,
        bag=str(run.bag.path),
        bag_complete=run.bag.complete,
        stop=run.stop,
        verdict=metrics.verdict(),
        missing=(*run.bag.notes, *run.notes),
        tracking=metrics.tracked.tracking(),
        joints=metrics.tracked.joints(),
        storage=metrics.decay.storage() if np.isfinite(metrics.decay.initial) else None,
        energy=metrics.balance.energy() if metrics.energy_known else None,
        timing=metrics.clock.timing(),
        counts=metrics.clock.counts(duration, {name: each.lost for name, each in sorted(run.bag.topics.items())}),
        diagnostics=run.counters,
        versions=_versions(),
        guesses=run.scenario.robot_warnings,
    )


def _versions() -> dict[str, str]:
    found = {}
    for name in VERSIONS:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found
