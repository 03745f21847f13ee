# SPDX-License-Identifier: Apache-2.0
"""Runs with one known fault each, in three sizes, on the paper's joint, the two-link and the seven-joint arm.

Thresholds (fjr_monitor.diagnosis.fault_isolation) are tuned on the sets of TUNING_SEEDS and validated on that of
VALIDATION_SEED. A seed draws joint, side, size within 20 %, and initial position.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np

from fjr_core.config.scenario import Scenario
from fjr_core.numerics.checks import Array
from fjr_monitor.diagnosis.record import Record

from .faulty_loop import Fault, FaultyLoop
from .loop import record
from .runs import JOINTS, Case, _start

TUNING_SEEDS, VALIDATION_SEED = (11, 12, 13, 14, 15), 16
DURATION, STARTING = 3.0, 0.3  # s
ROBOTS = ("paper_k31", "two_link", "arm7")
HEALTHY = "healthy"
TORQUE = {  # N m, scaled to each joint
    "paper_k31": (0.8,),
    "two_link": (2.0, 0.8),
    "arm7": (10.0, 35.0, 10.0, 15.0, 4.0, 3.0, 2.0),
}
PAYLOAD = {"paper_k31": (0.015, 0.04, 0.1), "two_link": (0.03, 0.08, 0.2), "arm7": (0.1, 0.3, 1.0)}  # kg
NOISE = {  # standard deviations of all sensors, except in "perfect" runs
    "link_position_noise": 1e-6,
    "motor_position_noise": 1e-6,
    "link_velocity_noise": 5e-4,
    "motor_velocity_noise": 5e-4,
}
SPREAD = 0.2  # relative spread of the sizes


@dataclass(frozen=True)
class FaultCase:
    """A run: kind of fault, joint (index, -1: none), side, size, and their implementation in the simulation."""

    name: str
    kind: str
    joint: int
    side: str
    size: float
    case: Case
    fault: Fault = field(default_factory=Fault)

    @property
    def duration(self) -> float:
        """Duration [s]; wiring faults stop the robot at the start."""
        return STARTING if self.kind in WIRING else DURATION

    @property
    def joints(self) -> str:
        """Names of the joints as in a finding."""
        names, n = _names(self.case.scenario), JOINTS[self.case.scenario]
        pair = {self.joint, (self.joint + 1) % n} if self.kind.endswith("exchanged") else {self.joint}
        return " and ".join(names[j] for j in sorted(pair)) if self.joint >= 0 else ""

    def run(self) -> tuple[Scenario, FaultyLoop, Record]:
        """Run in lock-step; the record has no measured torque."""
        scenario = self.case.loaded()
        loop = FaultyLoop(scenario, self.fault)
        return scenario, loop, record(loop.run(self.duration), scenario)


@cache
def _names(scenario: str) -> tuple[str, ...]:
    """Return the names of the joints."""
    return tuple(Case("", scenario, "").loaded().joints)


@dataclass(frozen=True)
class _Draw:
    """Drawn values of a case: robot, its parameters, joint, side, number of joints and size."""

    scenario: str
    values: Mapping[str, Any]
    j: int
    side: str
    n: int
    f: float

    @property
    def torque(self) -> float:
        return self.f * TORQUE[self.scenario][self.j]

    @property
    def channel(self) -> int:
        return self.j + self.n * (self.side == "motor")

    def robot(self, name: str, change: Callable[[float], float]) -> dict[str, Any]:
        """Return the robot's list with one entry changed."""
        entries = [float(value) for value in self.values[f"robot.{name}"]]
        entries[self.j] = change(entries[self.j])
        return {"robot": {name: entries}}

    def imperfection(self, name: str, value: float) -> dict[str, Any]:
        entries = [0.0] * self.n
        entries[self.j] = value
        smooth = {"imperfections.friction_smoothing_velocity": [0.05] * self.n} if self.scenario == "arm7" else {}
        return {"changes": {f"imperfections.{name}": entries, **smooth}}


Maker = Callable[[_Draw], dict[str, Any]]


def _constant(d: _Draw) -> dict[str, Any]:
    push = d.torque * np.eye(d.n)[d.j]
    if d.side == "link":
        return {"fault": Fault(push=push)}
    return {"fault": Fault(effort=lambda u: u + push)}


def _payload(d: _Draw) -> dict[str, Any]:
    place = [0.05, 0.0, 0.1] if d.scenario == "arm7" else [0.2, 0.0, 0.0]
    return {"changes": {"imperfections.payload_mass": d.f, "imperfections.payload_position": place}}


def _stiffness(d: _Draw) -> float:
    return float(d.values["robot.joint_stiffness"][d.j])


def _offset(d: _Draw) -> dict[str, Any]:
    shift = d.torque / _stiffness(d) * np.eye(2 * d.n)[d.channel]
    return {"fault": Fault(position=lambda q: q + shift)}


def _backlash(d: _Draw) -> dict[str, Any]:
    K, half = _stiffness(d), d.torque / _stiffness(d)
    return {"fault": Fault(spring=lambda zeta: -K * np.clip(zeta, -half, half) * np.eye(d.n)[d.j])}


def _scaled(size: int, at: int, factor: float) -> Callable[[Array], Array]:
    factors = np.where(np.arange(size) == at, factor, 1.0)
    return lambda values: values * factors


def _swapped(size: int, one: int, other: int) -> Callable[[Array], Array]:
    order = np.arange(size)
    order[[one, other]] = order[[other, one]]
    return lambda values: values[order]


def _other(d: _Draw) -> int:
    """Return the channel of the neighbouring joint on the same side."""
    return (d.j + 1) % d.n + d.n * (d.side == "motor")


def _copied(d: _Draw) -> dict[str, Any]:
    def copied(dq: Array) -> Array:
        changed = dq.copy()
        changed[d.channel] = dq[_other(d)]
        return changed

    return {"fault": Fault(velocity=copied)}


def _encoder(change: Callable[[Array], Array]) -> dict[str, Any]:
    return {"fault": Fault(position=change, velocity=change)}


def _delay(d: _Draw) -> dict[str, Any]:
    return {"fault": Fault(delay=round(d.f), delayed=np.arange(2 * d.n) == d.channel)}


LINK, MOTOR, BOTH, SPRING = ("link",), ("motor",), ("link", "motor"), ("joint",)
FAULTS: dict[str, tuple[tuple[float, float, float], tuple[str, ...], Maker]] = {  # sizes, sides, how
    "constant torque": ((0.04, 0.1, 0.25), BOTH, _constant),
    "gravity load": ((0, 1, 2), LINK, _payload),
    "Coulomb friction": ((0.03, 0.08, 0.2), BOTH, lambda d: d.imperfection(f"{d.side}_coulomb_friction", d.torque)),
    "viscous friction": ((0.03, 0.08, 0.2), BOTH, lambda d: d.robot(f"{d.side}_damping", lambda D: D + d.torque)),
    "inertia": ((0.1, 0.3, 0.7), BOTH, lambda d: d.robot(f"{d.side}_inertia", lambda M: M * (1 + d.f))),
    "stiffness": ((0.05, 0.12, 0.25), SPRING, lambda d: d.robot("joint_stiffness", lambda K: K * (1 - d.f))),
    "torque constant": ((0.03, 0.08, 0.2), MOTOR, lambda d: d.robot("input_gain", lambda B: B * (1 - d.f))),
    "position offset": ((0.04, 0.1, 0.25), BOTH, _offset),
    "backlash": ((0.1, 0.25, 0.5), SPRING, _backlash),
    "velocity scale": (
        (0.04, 0.1, 0.2),
        BOTH,
        lambda d: {"fault": Fault(velocity=_scaled(2 * d.n, d.channel, 1 + d.f))},
    ),
    "velocity delay": ((1, 2, 4), BOTH, _delay),
}
WIRING: dict[str, tuple[tuple[str, ...], Maker]] = {
    "velocity sign": (BOTH, lambda d: {"fault": Fault(velocity=_scaled(2 * d.n, d.channel, -1.0))}),
    "velocity of another joint": (BOTH, _copied),
    "effort sign": (MOTOR, lambda d: {"fault": Fault(effort=_scaled(d.n, d.j, -1.0))}),
    "efforts exchanged": (MOTOR, lambda d: {"fault": Fault(effort=_swapped(d.n, d.j, _other(d) % d.n))}),
    "encoder sign": (BOTH, lambda d: _encoder(_scaled(2 * d.n, d.channel, -1.0))),
    "encoders exchanged": (BOTH, lambda d: _encoder(_swapped(2 * d.n, d.channel, _other(d)))),
}
PAIRS = ("velocity of another joint", "efforts exchanged", "encoders exchanged")


def healthy(seed: int = VALIDATION_SEED) -> list[FaultCase]:
    """Return runs without a fault: perfect sensors, noise, encoder steps, other rates."""
    rng = np.random.default_rng(seed)
    found = []
    for scenario in (*ROBOTS, "paper_k3p1"):
        n = JOINTS[scenario]
        bits = {"imperfections.link_encoder_bits": [20.0] * n, "imperfections.motor_encoder_bits": [20.0] * n}
        for what, changes in (("perfect", {}), ("noise", _noise(n)), ("encoder steps", bits)):
            start, seeded = _start(scenario, rng), {"imperfections.seed": int(rng.integers(1000))}
            case = Case(f"{scenario} {what}", scenario, HEALTHY, {**changes, **seeded}, start=start)
            found.append(FaultCase(case.name, HEALTHY, -1, "", 0.0, case))
    return found


def _noise(n: int) -> dict[str, list[float]]:
    return {f"imperfections.{name}": [value] * n for name, value in NOISE.items()}


def cases(seed: int = VALIDATION_SEED, robots: tuple[str, ...] = ROBOTS) -> list[FaultCase]:
    """Return every fault in three sizes on each applicable robot, wiring faults and healthy runs."""
    rng = np.random.default_rng(seed)
    loaded = {name: Case("", name, "").loaded() for name in ROBOTS}
    kinds = (*FAULTS, *WIRING)
    found = [_case(rng, loaded, kind, i, robot) for kind in kinds for i in range(3) for robot in ROBOTS]
    return [*(each for each in found if each is not None and each.case.scenario in robots), *healthy(seed)]


def _case(
    rng: np.random.Generator, loaded: Mapping[str, Scenario], kind: str, i: int, scenario: str
) -> FaultCase | None:
    n, values = JOINTS[scenario], loaded[scenario].plant_values
    if kind in PAIRS and n == 1:
        return None
    sizes, sides, maker = FAULTS[kind] if kind in FAULTS else ((1.0,) * 3, *WIRING[kind])
    side, j = str(rng.choice(sides)), int(rng.integers(n))
    f = sizes[i] * (1 + SPREAD * rng.uniform(-1, 1))
    if kind == "gravity load":
        f, j = PAYLOAD[scenario][i] * (1 + SPREAD * rng.uniform(-1, 1)), n - 1
    if kind == "inertia" and side == "link":
        side, j = ("motor", j) if scenario == "arm7" else ("link", n - 1)  # the links of the URDF are fixed
    made = maker(_Draw(scenario, values, j, side, n, f))
    name = f"{scenario} {kind} {side} {j + 1} {f:.3g}"
    seeded = {"imperfections.seed": int(rng.integers(1000)), **_noise(n), **made.get("changes", {})}
    case = Case(name, scenario, kind, seeded, made.get("robot", {}), _start(scenario, rng))
    return FaultCase(name, kind, j, side, f, case, made.get("fault", Fault()))
