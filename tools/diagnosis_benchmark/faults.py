# SPDX-License-Identifier: Apache-2.0
"""Runs with one known fault each, in three sizes, on the paper's joint, the two-link and the seven-joint arm.

Thresholds (fjr_monitor.diagnosis.fault_isolation) are tuned on the sets of TUNING_SEEDS and validated on that of
VALIDATION_SEED. A seed draws joint, side, size within 20 %, and initial position.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from fjr_core.config.scenario import Scenario

from .cases import DURATION, JOINTS, Case, start_of
from .lock_step import Change, Fault

TUNING_SEEDS, VALIDATION_SEED = (11, 12, 13, 14, 15), 16
STARTING = 0.3  # s; duration of a run with a wiring fault, which stops at the start
ROBOTS = ("paper_k31", "two_link", "arm7")
HEALTHY = "healthy"
TORQUE = {  # N m, scaled to each joint
    "paper_k31": (0.8,),
    "two_link": (2.0, 0.8),
    "arm7": (10.0, 35.0, 10.0, 15.0, 4.0, 3.0, 2.0),
}
PLACE = ([0.2, 0.0, 0.0], [0.05, 0.0, 0.1])  # m, of a payload on a planar robot, and on arm7
PAYLOAD = {"paper_k31": (0.015, 0.04, 0.1), "two_link": (0.03, 0.08, 0.2), "arm7": (0.1, 0.3, 1.0)}  # kg
NOISE = {  # standard deviations of all sensors, except in "perfect" runs
    "link_position_noise": 1e-6,
    "motor_position_noise": 1e-6,
    "link_velocity_noise": 5e-4,
    "motor_velocity_noise": 5e-4,
}
SPREAD = 0.2  # relative spread of the sizes


@cache
def nominal(scenario: str) -> Scenario:
    """Return a scenario whose runs start without a transition."""
    return Case("", scenario, "").loaded()


def joints_of(case: Case) -> str:
    """Return the names of the faulty joints as in a finding."""
    names, j = nominal(case.scenario).joints, case.joint
    pair = {j, (j + 1) % len(names)} if case.kind.endswith("exchanged") else {j}
    return " and ".join(names[k] for k in sorted(pair)) if j >= 0 else ""


def duration_of(case: Case) -> float:
    """Return the duration [s]; wiring faults stop the robot at the start."""
    return STARTING if case.kind in WIRING else DURATION


@dataclass(frozen=True)
class Draw:
    """Drawn values of a fault: scenario, joint, side and size."""

    scenario: str
    j: int
    side: str
    f: float = 1.0

    @property
    def n(self) -> int:
        """Return the number of joints."""
        return JOINTS[self.scenario]

    @property
    def torque(self) -> float:
        """Return the size scaled to the joint [N m]."""
        return self.f * TORQUE[self.scenario][self.j]

    @property
    def K(self) -> float:
        """Return the stiffness of the joint [N m/rad]."""
        return float(nominal(self.scenario).robot.K[self.j, self.j])

    @property
    def channel(self) -> int:
        """Return the place of the joint's side in (2n,)."""
        return self.j + self.n * (self.side == "motor")

    @property
    def other(self) -> int:
        """Return the channel of the neighbouring joint on the same side."""
        return (self.j + 1) % self.n + self.n * (self.side == "motor")

    def robot(self, name: str, change: Callable[[float], float]) -> dict[str, Any]:
        """Return the robot's list with one entry changed."""
        entries = [float(value) for value in nominal(self.scenario).plant_values[f"robot.{name}"]]  # type: ignore[union-attr]
        entries[self.j] = change(entries[self.j])
        return {"robot": {name: entries}}


Maker = Callable[[Draw], dict[str, Any]]


def _constant(d: Draw) -> dict[str, Any]:
    push = d.torque * np.eye(d.n)[d.j]
    return {"fault": Fault(push=push) if d.side == "link" else Fault(effort=lambda u: u + push)}


def _payload(d: Draw) -> dict[str, Any]:
    return {"changes": {"imperfections.payload_mass": d.f, "imperfections.payload_position": PLACE[d.n > 2]}}


def _coulomb(d: Draw) -> dict[str, Any]:
    changes = {f"imperfections.{d.side}_coulomb_friction": (d.torque * np.eye(d.n)[d.j]).tolist()}
    smooth = {"imperfections.friction_smoothing_velocity": [0.05] * d.n} if d.scenario == "arm7" else {}
    return {"changes": changes | smooth}


def _offset(d: Draw) -> dict[str, Any]:
    shift = d.torque / d.K * np.eye(2 * d.n)[d.channel]
    return {"fault": Fault(position=lambda q: q + shift)}


def _backlash(d: Draw) -> dict[str, Any]:
    K, half = d.K, d.torque / d.K
    return {"fault": Fault(spring=lambda zeta: -K * np.clip(zeta, -half, half) * np.eye(d.n)[d.j])}


def _delay(d: Draw) -> dict[str, Any]:
    return {"fault": Fault(delay=round(d.f), delayed=np.arange(2 * d.n) == d.channel)}


def _scaled(size: int, at: int, factor: float) -> Change:
    factors = np.where(np.arange(size) == at, factor, 1.0)
    return lambda values: values * factors


def _taken(size: int, places: Mapping[int, int]) -> Change:
    """Return a change that takes the entries at some places from other places."""
    order = np.array([places.get(k, k) for k in range(size)])
    return lambda values: values[order]


def _encoder(change: Change) -> dict[str, Any]:
    return {"fault": Fault(position=change, velocity=change)}


LINK, MOTOR, BOTH, SPRING = ("link",), ("motor",), ("link", "motor"), ("joint",)
FAULTS: dict[str, tuple[tuple[float, float, float], tuple[str, ...], Maker]] = {  # sizes, sides, how
    "constant torque": ((0.04, 0.1, 0.25), BOTH, _constant),
    "gravity load": ((0, 1, 2), LINK, _payload),
    "Coulomb friction": ((0.03, 0.08, 0.2), BOTH, _coulomb),
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
    "velocity of another joint": (BOTH, lambda d: {"fault": Fault(velocity=_taken(2 * d.n, {d.channel: d.other}))}),
    "effort sign": (MOTOR, lambda d: {"fault": Fault(effort=_scaled(d.n, d.j, -1.0))}),
    "efforts exchanged": (MOTOR, lambda d: {"fault": Fault(effort=_taken(d.n, _both(d.j, d.other - d.n)))}),
    "encoder sign": (BOTH, lambda d: _encoder(_scaled(2 * d.n, d.channel, -1.0))),
    "encoders exchanged": (BOTH, lambda d: _encoder(_taken(2 * d.n, _both(d.channel, d.other)))),
}
PAIRS = ("velocity of another joint", "efforts exchanged", "encoders exchanged")


def _both(one: int, other: int) -> dict[int, int]:
    return {one: other, other: one}


def noise_of(n: int) -> dict[str, Any]:
    """Return the noise of all sensors."""
    return {f"imperfections.{name}": [value] * n for name, value in NOISE.items()}


def healthy(seed: int = VALIDATION_SEED) -> list[Case]:
    """Return runs without a fault: perfect sensors, noise, encoder steps."""
    rng = np.random.default_rng(seed)
    found = []
    for scenario in (*ROBOTS, "paper_k3p1"):
        n = JOINTS[scenario]
        bits = {f"imperfections.{side}_encoder_bits": [20.0] * n for side in BOTH}
        for what, changes in (("perfect", {}), ("noise", noise_of(n)), ("encoder steps", bits)):
            start, seeded = start_of(scenario, rng), {"imperfections.seed": int(rng.integers(1000))}
            found.append(Case(f"{scenario} {what}", scenario, HEALTHY, {**changes, **seeded}, start=start))
    return found


def cases(seed: int = VALIDATION_SEED) -> list[Case]:
    """Return every fault in three sizes on each applicable robot, wiring faults and healthy runs."""
    rng = np.random.default_rng(seed)
    found = [_case(rng, kind, i, robot) for kind in (*FAULTS, *WIRING) for i in range(3) for robot in ROBOTS]
    return [*(each for each in found if each is not None), *healthy(seed)]


def _case(rng: np.random.Generator, kind: str, i: int, scenario: str) -> Case | None:
    n = JOINTS[scenario]
    if kind in PAIRS and n == 1:
        return None
    sizes, sides, maker = FAULTS[kind] if kind in FAULTS else ((1.0,) * 3, *WIRING[kind])
    side, j = str(rng.choice(sides)), int(rng.integers(n))
    f = sizes[i] * (1 + SPREAD * rng.uniform(-1, 1))
    if kind == "gravity load":
        f, j = PAYLOAD[scenario][i] * (1 + SPREAD * rng.uniform(-1, 1)), n - 1
    if kind == "inertia" and side == "link":
        side, j = ("motor", j) if scenario == "arm7" else ("link", n - 1)  # the links of the URDF are fixed
    made = maker(Draw(scenario, j, side, f))
    changes = {"imperfections.seed": int(rng.integers(1000)), **noise_of(n), **made.pop("changes", {})}
    name = f"{scenario} {kind} {side} {j + 1} {f:.3g}"
    return Case(name, scenario, kind, changes, start=start_of(scenario, rng), joint=j, side=side, size=f, **made)
