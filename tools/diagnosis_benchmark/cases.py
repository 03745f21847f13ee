# SPDX-License-Identifier: Apache-2.0
"""Labelled runs for the diagnosis: healthy, each imperfection at two levels, model mismatch, low sample rates.

Labels do not depend on the diagnosis: `label` compares a run with the same run without the cause. Thresholds
(fjr_monitor.diagnosis.thresholds) are tuned on the set of TUNING_SEED and validated on that of VALIDATION_SEED. A seed
draws the initial position and all random sequences.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np

from fjr_core import check
from fjr_core.config import ros_yaml
from fjr_core.config.nodes import PLANT
from fjr_core.config.scenario import Scenario, parse_scenario
from fjr_core.monitoring.certificate import Certificate
from fjr_core.numerics.checks import Array
from fjr_monitor.diagnosis.record import Record
from fjr_monitor.diagnosis.thresholds import TOLERANCE
from fjr_msgs_py.scenarios import library

from .lock_step import NONE, Fault, LockStepLoop

DURATION = 3.0  # s
TUNING_SEED, VALIDATION_SEED = 1, 2
WINDOW = 0.1  # s; means of V over such windows are compared
RAISED = 2.0  # times V of the healthy run
OFTEN, SELDOM = 0.10, 0.03  # share of the windows: violation from OFTEN, no violation up to SELDOM
HOLDING, DEGRADED, VIOLATED = "holding", "degraded", "violated"
UNDECIDED = "near the tolerance"
SETTLED = 1.0  # s; end of the transient
NEAR = 1.3  # errors within this factor of the tolerance may have either grade
EXPECTED = ("noise",)  # raises the floor, which the diagnosis allows for


@dataclass(frozen=True)
class Case:
    """A run: a scenario with changed plant parameters; kind: the cause, if it raises V enough, or the injected fault.

    robot: plant parameters that the model of the controller lacks. start: initial state of the plant. joint (index, -1:
    none), side, size: of the fault; fault: what of it is no plant parameter.
    """

    name: str
    scenario: str
    kind: str
    changes: Mapping[str, Any] = field(default_factory=dict)
    robot: Mapping[str, Any] = field(default_factory=dict)
    start: Mapping[str, Any] = field(default_factory=dict)
    joint: int = -1
    side: str = ""
    size: float = 0.0
    fault: Fault = NONE

    def loaded(self) -> Scenario:
        """Return the scenario."""
        changes = {"lockstep": True, **DIRECT.get(self.scenario, {}), **self.start, **self.changes}
        text, scenario = library.as_run(library.find(self.scenario), changes)
        if not self.robot:
            return scenario
        document = ros_yaml.parse(text)
        own = document.setdefault(f"/**/{PLANT}", {}).setdefault("ros__parameters", {})
        own.setdefault("robot", {}).update(self.robot)
        return parse_scenario(self.name, ros_yaml.dump(document))

    def run(self, duration: float = DURATION) -> LockStepLoop:
        """Simulate the case in lock-step."""
        return LockStepLoop(self.loaded(), self.fault).run(duration)

    @property
    def n(self) -> int:
        """Number of joints."""
        return JOINTS[self.scenario]

    @property
    def channel(self) -> int:
        """Place of the joint's side in (2n,)."""
        return self.joint + self.n * (self.side == "motor")

    @property
    def torque(self) -> float:
        """Size scaled to the joint [N m]."""
        return self.size * TORQUE[self.scenario][self.joint]

    @property
    def K(self) -> float:
        """Stiffness of the joint [N m/rad]."""
        return float(nominal(self.scenario).robot.K[self.joint, self.joint])

    def at(self, value: float) -> Array:
        """Return a value at the joint and 0 at the others (n,)."""
        return value * np.eye(self.n)[self.joint]

    def imperfect(self, **values: Any) -> Case:
        """Return the case with these imperfections, too."""
        named = {f"imperfections.{name}": value for name, value in values.items()}
        return replace(self, changes={**self.changes, **named})

    def faulty(self, **changes: Any) -> Case:
        """Return the case with a fault that is no plant parameter."""
        return replace(self, fault=Fault(**changes))

    def differing(self, name: str, change: Callable[[float], float]) -> Case:
        """Return the case with another value of the joint in a list of the robot."""
        entries = [float(value) for value in nominal(self.scenario).plant_values[f"robot.{name}"]]  # type: ignore[union-attr]
        entries[self.joint] = change(entries[self.joint])
        return replace(self, robot={name: entries})


@cache
def nominal(scenario: str) -> Scenario:
    """Return a scenario whose runs start without a transition."""
    return Case("", scenario, "").loaded()


DIRECT: dict[str, dict[str, Any]] = {"two_link": {"start.join_time": 0.0, "limits.start_error": [np.inf] * 2}}
"""Parameters with which a robot starts without a transition, from any initial state."""
STARTS = {"paper_k31": 0.5, "paper_k3p1": 0.5, "two_link": 0.0}  # rad, of all joints
JOINTS = {"paper_k31": 1, "paper_k3p1": 1, "two_link": 2, "arm7": 7}
TORQUE = {  # N m, scaled to each joint
    "paper_k31": (0.8,),
    "two_link": (2.0, 0.8),
    "arm7": (10.0, 35.0, 10.0, 15.0, 4.0, 3.0, 2.0),
}
PER_JOINT: dict[str, tuple[str, tuple[float, float]]] = {  # imperfection: cause, weak and strong level
    "link_coulomb_friction": ("model mismatch", (0.01, 0.08)),
    "motor_coulomb_friction": ("model mismatch", (0.01, 0.08)),
    "link_static_friction": ("model mismatch", (0.03, 0.15)),
    "motor_static_friction": ("model mismatch", (0.03, 0.15)),
    "cubic_stiffness": ("model mismatch", (60.0, 1500.0)),
    "torque_ripple": ("model mismatch", (0.01, 0.06)),
    "actuator_lag": ("delay", (6e-4, 2.5e-3)),
    "link_position_noise": ("noise", (1e-6, 1e-5)),
    "motor_position_noise": ("noise", (1e-6, 1e-5)),
    "link_velocity_noise": ("noise", (5e-4, 5e-3)),
    "motor_velocity_noise": ("noise", (5e-4, 5e-3)),
    "link_encoder_bits": ("noise", (22.0, 17.0)),
    "motor_encoder_bits": ("noise", (22.0, 17.0)),
}
OF_MESSAGES: dict[str, tuple[str, tuple[float, float]]] = {
    "state_delay": ("delay", (1e-3, 3e-3)),
    "command_delay": ("delay", (7.5e-4, 2.5e-3)),
    "state_jitter": ("delay", (2e-3, 4e-3)),
    "command_jitter": ("delay", (1.5e-3, 4e-3)),
    "state_loss": ("loss", (0.02, 0.45)),
    "command_loss": ("loss", (0.02, 0.45)),
    "state_repetition": ("loss", (0.1, 0.5)),
    "command_repetition": ("loss", (0.1, 0.5)),
    "period_jitter": ("sampling", (2e-4, 6e-4)),
}
EFFORT_LIMITS = {"paper_k31": (0.95, 0.75), "two_link": (2.5, 1.5)}  # N m
PAYLOADS = {"paper_k31": (0.02, 0.1), "two_link": (0.02, 0.1)}  # kg, at 0.2 m of the last link
OTHER_ROBOTS: tuple[tuple[str, str, Mapping[str, Any]], ...] = (
    ("stiffer by a tenth", "paper_k31", {"joint_stiffness": [34.1]}),
    ("softer by a third", "paper_k31", {"joint_stiffness": [20.7]}),
    ("softer by a fifth", "paper_k3p1", {"joint_stiffness": [2.48]}),
    ("one joint softer", "two_link", {"joint_stiffness": [40.0, 22.0]}),
    ("all joints softer", "arm7", {"joint_stiffness": [9e3, 9e3, 7e3, 7e3, 4.5e3, 2.7e3, 2.7e3]}),
    ("heavier link", "paper_k31", {"link_inertia": [0.036]}),
    ("twice the link's inertia", "paper_k31", {"link_inertia": [0.062]}),
    ("twice the motor's inertia", "paper_k31", {"motor_inertia": [0.008]}),
    ("heavier upper link", "two_link", {"link_mass": [1.5, 0.8]}),
    ("heavier motors", "two_link", {"motor_inertia": [0.024, 0.012]}),
    ("heavier motors", "arm7", {"motor_inertia": [0.7, 0.7, 0.5, 0.5, 0.23, 0.23, 0.23]}),
)
RATES = (("paper_k31", 50.0), ("paper_k31", 30.0), ("paper_k3p1", 40.0), ("two_link", 30.0), ("arm7", 60.0))  # Hz
SLOWER = (("paper_k31", 250.0), ("two_link", 200.0), ("arm7", 400.0))  # Hz, stable


def cases(seed: int = VALIDATION_SEED) -> list[Case]:
    """Return all labelled runs of a seed."""
    rng, rates = np.random.default_rng(seed), (*RATES, *SLOWER)
    found = [Case(f"{name} healthy", name, HOLDING) for name in JOINTS]
    found += [Case(f"{name} at {rate:g} Hz", name, "sampling", {"publish_rate": rate}) for name, rate in rates]
    found += [Case(f"{name} {text}", name, "model mismatch", robot=robot) for text, name, robot in OTHER_ROBOTS]
    return [replace(case, start=start_of(case.scenario, rng)) for case in (*found, *_nonideal(1000 * seed))]


def start_of(name: str, rng: np.random.Generator) -> dict[str, list[float]]:
    """Return an initial state at rest within 0.1 rad of the scenario's; arm7 keeps its own because of its limits."""
    if name == "arm7":
        return {}
    q_l = STARTS[name] + rng.uniform(-0.1, 0.1, JOINTS[name])
    return {"initial_link_position": q_l.tolist(), "initial_motor_position": q_l.tolist()}


def _nonideal(seed: int) -> Iterator[Case]:
    """Yield each imperfection at two levels, alternating between one and two joints; then the larger ones."""
    found = []
    for i, (key, (kind, strengths)) in enumerate([*PER_JOINT.items(), *OF_MESSAGES.items()]):
        for j, strength in enumerate(strengths):
            name = ("paper_k31", "two_link")[(i + j) % 2]
            value: Any = [strength] * JOINTS[name] if key in PER_JOINT else strength
            found.append((name, kind, key, strength, {key: value}))
    for name in EFFORT_LIMITS:
        for limit in EFFORT_LIMITS[name]:
            found.append((name, "saturation", "effort_limit", limit, {"effort_limit": [limit] * JOINTS[name]}))
        for mass in PAYLOADS[name]:
            payload = {"payload_mass": mass, "payload_position": [0.2, 0.0, 0.0]}
            found.append((name, "model mismatch", "payload_mass", mass, payload))
    for number, (name, kind, key, strength, values) in enumerate(found, seed + 1):
        yield Case(f"{name} {key} {strength:g}", name, kind).imperfect(**values, seed=number)


@dataclass(frozen=True)
class Label:
    """Expected diagnosis: "holding" or the cause, and the grade (UNDECIDED: degraded or violated)."""

    cause: str
    grade: str


def label(case: Case, found: Record) -> Label:
    """Return the label of a run.

    Noise raises the floor only. The sampling is too slow if the linearised loop is unstable at equilibria along the
    reference. Any other kind is a violation if it at least doubles V, relative to the same run without it, in 10 % of
    the windows of 0.1 s, and no violation if it does so in at most 3 %. Raise ValueError for a share between.
    """
    if case.kind in (HOLDING, *EXPECTED):
        return Label(HOLDING, HOLDING)
    if "publish_rate" in case.changes:
        loaded = case.loaded()
        stable = check(loaded.law, loaded.sample_period, 0.0, loaded.configurations(32)).stable
        return Label(HOLDING, HOLDING) if stable else Label("sampling", VIOLATED)
    loop = replace(case, changes={}, robot={}).run()
    healthy, certificate = loop.record(), Certificate(loop.scenario.tracking_law)
    mine, usual = (_means(r.t, certificate.along(r.position, r.velocity, r.jets).V) for r in (found, healthy))
    count = min(len(mine), len(usual))
    share = float(np.mean(mine[:count] > RAISED * usual[:count]))
    if SELDOM < share < OFTEN:
        raise ValueError(
            f"{case.name}: V is doubled in {share:.0%} of the windows; expected at most 3 % or at least 10 %"
        )
    return Label(case.kind, _grade(case, found, healthy)) if share >= OFTEN else Label(HOLDING, HOLDING)


def _grade(case: Case, found: Record, healthy: Record) -> str:
    """Return the grade by the tracking error [rad] in excess of the healthy run; saturation is violated."""
    error = _largest_difference(found, healthy)
    if case.kind == "saturation" or not error <= NEAR * TOLERANCE:
        return VIOLATED
    return UNDECIDED if error > TOLERANCE / NEAR else DEGRADED


def _largest_difference(one: Record, other: Record) -> float:
    """Return the largest difference of the tracking errors of two runs [rad], after the transient."""
    t = one.t[one.t >= SETTLED]
    errors = ((run.t, run.position[:, : run.u.shape[1]] - run.jets[:, 0]) for run in (one, other))
    one_error, other_error = (np.array([np.interp(t, stamps, column) for column in e.T]) for stamps, e in errors)
    return float(np.abs(one_error - other_error).max(initial=0.0))


def _means(t: Array, V: Array) -> Array:
    """Return the means of V over windows."""
    windows = (t / WINDOW + 1e-9).astype(int)
    return np.bincount(windows, V) / np.maximum(np.bincount(windows), 1)
