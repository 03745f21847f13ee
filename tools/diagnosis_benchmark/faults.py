# SPDX-License-Identifier: Apache-2.0
"""Runs with one known fault each, in three sizes, on the paper's joint, the two-link and the seven-joint arm.

Thresholds (fjr_monitor.diagnosis.fault_isolation) are tuned on the sets of TUNING_SEEDS and validated on that of
VALIDATION_SEED. A seed draws joint, side, size within 20 %, and initial position. No threshold knows the faults and
physics of FOREIGN, whose runs are drawn by their number alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from fjr_core.numerics.checks import Array

from .cases import DURATION, JOINTS, TORQUE, Case, nominal, start_of
from .lock_step import Change

TUNING_SEEDS, VALIDATION_SEED = (11, 12, 13, 14, 15), 16
STARTING = 0.3  # s; duration of a run with a wiring fault, which stops at the start
ROBOTS = ("paper_k31", "two_link", "arm7")
HEALTHY = "healthy"
PLACE = ([0.2, 0.0, 0.0], [0.05, 0.0, 0.1])  # m, of a payload on a planar robot, and on arm7
PAYLOAD = {"paper_k31": (0.015, 0.04, 0.1), "two_link": (0.03, 0.08, 0.2), "arm7": (0.1, 0.3, 1.0)}  # kg
NOISE = {  # standard deviations of all sensors, except in "perfect" runs
    "link_position_noise": 1e-6,
    "motor_position_noise": 1e-6,
    "link_velocity_noise": 5e-4,
    "motor_velocity_noise": 5e-4,
}
SPREAD = 0.2  # relative spread of the sizes
RUBBING = 0.02, 0.1  # friction of an arm that rubs, relative to the torque of each joint
UNRUBBED = ("Coulomb friction", "viscous friction", "velocity scale", "velocity delay")
FOREIGN_SEED, FOREIGN_COUNT, FOREIGN_DURATION = 28, 200, 4.0  # s
MARGINS = {"paper_k31": 5.45e-3, "two_link": 10.1e-3, "arm7": 2.38e-3}  # s, of delay
Maker = Callable[[Case], Case]
"""What gives a case its fault, by its joint, side and size."""
ForeignMaker = Callable[[Case, np.random.Generator], Case]


def joints_of(case: Case) -> str:
    """Return the names of the faulty joints as in a finding."""
    names, j = nominal(case.scenario).joints, case.joint
    pair = {j, (j + 1) % len(names)} if case.kind.endswith("exchanged") else {j}
    return " and ".join(names[k] for k in sorted(pair)) if j >= 0 else ""


def duration_of(case: Case) -> float:
    """Return the duration [s]; wiring faults stop the robot at the start."""
    return STARTING if case.kind in WIRING else FOREIGN_DURATION if case.kind in FOREIGN else DURATION


def _constant(c: Case) -> Case:
    push = c.at(c.torque)
    return c.faulty(push=push) if c.side == "link" else c.faulty(effort=lambda u: u + push)


def _coulomb(c: Case) -> Case:
    smooth = {"friction_smoothing_velocity": [0.05] * c.n} if c.scenario == "arm7" else {}
    return c.imperfect(**{f"{c.side}_coulomb_friction": c.at(c.torque).tolist()}, **smooth)


def _offset(c: Case) -> Case:
    shift = c.torque / c.K * np.eye(2 * c.n)[c.channel]
    return c.faulty(position=lambda q: q + shift)


def _backlash(c: Case) -> Case:
    K, half = c.K, c.torque / c.K
    return c.faulty(spring=lambda zeta: c.at(1.0) * -K * np.clip(zeta, -half, half))


def _scaled(size: int, at: int, factor: float) -> Change:
    factors = np.where(np.arange(size) == at, factor, 1.0)
    return lambda values: values * factors


def _taken(size: int, places: Mapping[int, int]) -> Change:
    """Return a change that takes the entries at some places from other places."""
    order = np.array([places.get(k, k) for k in range(size)])
    return lambda values: values[order]


def _velocity(c: Case, factor: float) -> Case:
    return c.faulty(velocity=_scaled(2 * c.n, c.channel, factor))


def _encoder(c: Case, change: Change) -> Case:
    return c.faulty(position=change, velocity=change)


def _neighbour(c: Case) -> int:
    """Return the channel of the neighbouring joint on the same side."""
    return (c.joint + 1) % c.n + c.channel - c.joint


def _exchanged(size: int, one: int, other: int) -> Change:
    return _taken(size, {one: other, other: one})


LINK, MOTOR, BOTH, SPRING = ("link",), ("motor",), ("link", "motor"), ("joint",)
FAULTS: dict[str, tuple[tuple[float, float, float], tuple[str, ...], Maker]] = {  # sizes, sides, how
    "constant torque": ((0.04, 0.1, 0.25), BOTH, _constant),
    "gravity load": ((0, 1, 2), LINK, lambda c: c.imperfect(payload_mass=c.size, payload_position=PLACE[c.n > 2])),
    "Coulomb friction": ((0.03, 0.08, 0.2), BOTH, _coulomb),
    "viscous friction": ((0.03, 0.08, 0.2), BOTH, lambda c: c.differing(f"{c.side}_damping", lambda D: D + c.torque)),
    "inertia": ((0.1, 0.3, 0.7), BOTH, lambda c: c.differing(f"{c.side}_inertia", lambda M: M * (1 + c.size))),
    "stiffness": ((0.05, 0.12, 0.25), SPRING, lambda c: c.differing("joint_stiffness", lambda K: K * (1 - c.size))),
    "torque constant": ((0.03, 0.08, 0.2), MOTOR, lambda c: c.differing("input_gain", lambda B: B * (1 - c.size))),
    "position offset": ((0.04, 0.1, 0.25), BOTH, _offset),
    "backlash": ((0.1, 0.25, 0.5), SPRING, _backlash),
    "velocity scale": ((0.04, 0.1, 0.2), BOTH, lambda c: _velocity(c, 1 + c.size)),
    "velocity delay": (
        (1, 2, 4),
        BOTH,
        lambda c: c.faulty(delay=round(c.size), delayed=np.arange(2 * c.n) == c.channel),
    ),
}
WIRING: dict[str, tuple[tuple[str, ...], Maker]] = {
    "velocity sign": (BOTH, lambda c: _velocity(c, -1.0)),
    "velocity of another joint": (BOTH, lambda c: c.faulty(velocity=_taken(2 * c.n, {c.channel: _neighbour(c)}))),
    "effort sign": (MOTOR, lambda c: c.faulty(effort=_scaled(c.n, c.joint, -1.0))),
    "efforts exchanged": (MOTOR, lambda c: c.faulty(effort=_exchanged(c.n, c.joint, _neighbour(c) - c.n))),
    "encoder sign": (BOTH, lambda c: _encoder(c, _scaled(2 * c.n, c.channel, -1.0))),
    "encoders exchanged": (BOTH, lambda c: _encoder(c, _exchanged(2 * c.n, c.channel, _neighbour(c)))),
}
PAIRS = ("velocity of another joint", "efforts exchanged", "encoders exchanged")


def noise_of(n: int) -> dict[str, Any]:
    """Return the noise of all sensors."""
    return {name: [value] * n for name, value in NOISE.items()}


def healthy(seed: int = VALIDATION_SEED) -> list[Case]:
    """Return runs without a fault: perfect sensors, noise, encoder steps."""
    rng = np.random.default_rng(seed)
    found = []
    for scenario in (*ROBOTS, "paper_k3p1"):
        n = JOINTS[scenario]
        bits = {f"{side}_encoder_bits": [20.0] * n for side in BOTH}
        for what, values in (("perfect", {}), ("noise", noise_of(n)), ("encoder steps", bits)):
            case = Case(f"{scenario} {what}", scenario, HEALTHY, start=start_of(scenario, rng))
            found.append(case.imperfect(**values, seed=int(rng.integers(1000))))
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
    case = Case(f"{scenario} {kind} {side} {j + 1} {f:.3g}", scenario, kind, joint=j, side=side, size=f)
    case = maker(case.imperfect(seed=int(rng.integers(1000)), **noise_of(n)))
    return replace(case, start=start_of(scenario, rng))


def rubbing(seed: int = VALIDATION_SEED) -> list[Case]:
    """Return the faults of torques and positions, other than friction, in arms all of whose motors rub.

    Coulomb friction of a random level for each motor, 1.3 times as large at rest.
    """
    rng, found = np.random.default_rng(seed), []
    for case in (each for each in cases(seed) if each.kind in FAULTS and each.kind not in UNRUBBED):
        level = np.array(TORQUE[case.scenario]) * rng.uniform(*RUBBING, case.n)
        friction = {"coulomb": level.tolist(), "static": (1.3 * level).tolist()}
        named = {f"motor_{name}_friction": sizes for name, sizes in friction.items()}
        found.append(case.imperfect(**named, friction_smoothing_velocity=[0.05] * case.n))
    return found


# Faults and physics that the sets lack.


def _distorted(c: Case, error: Callable[[Array, float], Any], rate: Callable[[Array], Any] = lambda _: 0.0) -> Case:
    """Return a fault that adds error(q, t) to one position, and rate(q) dq to its velocity."""
    one = np.eye(2 * c.n)[c.channel]
    last: dict[str, Any] = {"t": -1e-3, "q": np.zeros(2 * c.n)}

    def position(q: Array) -> Array:
        last.update(t=last["t"] + 1e-3, q=q)
        return np.asarray(q + one * error(q, last["t"]))

    return c.faulty(position=position, velocity=lambda dq: dq + one * rate(last["q"]) * dq)


def _gain(c: Case, rng: np.random.Generator) -> Case:
    g = rng.choice([-1, 1]) * rng.uniform(0.005, 0.03)
    return _distorted(c, lambda q, _: g * q, lambda _: g)


def _eccentric(c: Case, rng: np.random.Generator) -> Case:
    a, at = rng.uniform(2e-3, 8e-3), rng.uniform(0, 2 * np.pi)
    return _distorted(c, lambda q, _: a * np.sin(q + at), lambda q: a * np.cos(q + at))


def _slip(c: Case, rng: np.random.Generator) -> Case:
    jump, begin = 0.5 * c.torque / c.K, rng.uniform(0.3, 0.7) * FOREIGN_DURATION
    return _distorted(c, lambda _, t: jump * (t >= begin))


def _cubic(c: Case, rng: np.random.Generator) -> Case:
    growth, at = rng.uniform(0.1, 0.4), c.torque / c.K
    return c.faulty(spring=lambda zeta: c.K * growth * zeta * (zeta / at) ** 2 * c.at(1.0))


def _kinematic(c: Case, rng: np.random.Generator) -> Case:
    size = 0.2 * c.torque
    return c.faulty(spring=lambda zeta: size * np.sin(40 * zeta * c.K / c.torque) * c.at(1.0))


def _stribeck(c: Case, rng: np.random.Generator) -> Case:
    level = c.at(0.1 * c.torque)
    sizes = {"coulomb": level, "static": 1.5 * level}
    friction = {f"{c.side}_{name}_friction": size.tolist() for name, size in sizes.items()}
    return c.imperfect(**friction, friction_smoothing_velocity=[0.05] * c.n)


def _soft_later(c: Case, rng: np.random.Generator) -> Case:
    share = c.at(rng.uniform(0.1, 0.25))
    calls = [0.0, rng.uniform(0.3, 0.7) * FOREIGN_DURATION]

    def effort(u: Array) -> Array:
        calls[0] += 1e-3
        return np.asarray(u * (1 - share * (calls[0] >= calls[1])))

    return c.faulty(effort=effort)


FOREIGN: dict[str, tuple[tuple[str, ...], tuple[str, ...], ForeignMaker]] = {
    "encoder gain": (BOTH, ("encoder gain",), _gain),
    "eccentricity of an encoder": (BOTH, ("eccentricity",), _eccentric),
    "encoder that slips": (BOTH, ("encoder slip",), _slip),
    "encoder that drifts": (
        BOTH,
        ("encoder drift",),
        lambda c, _: _distorted(c, lambda _, t: 0.3 * c.torque / c.K * t),
    ),
    "motor that weakens": (MOTOR, ("torque constant",), _soft_later),
    "Stribeck friction": (BOTH, ("Coulomb friction",), _stribeck),
    "cubic spring": (SPRING, ("cubic stiffness",), _cubic),
    "rippled spring": (SPRING, (), _kinematic),
    "delay": (("",), (), lambda c, rng: c.imperfect(command_delay=rng.uniform(0.3, 0.9) * MARGINS[c.scenario])),
    "delay that varies": (
        ("",),
        (),
        lambda c, rng: c.imperfect(command_jitter=rng.uniform(0.3, 0.6) * MARGINS[c.scenario]),
    ),
}
"""Sides, findings that are right (none: that of no single kind), and how the fault is made."""


def foreign(number: int) -> Case:
    """Return a run with a fault on random joints, with encoders of 16 to 20 bits and noisy velocities."""
    rng = np.random.default_rng((FOREIGN_SEED, number))
    kind, scenario = list(FOREIGN)[number % len(FOREIGN)], str(rng.choice(ROBOTS))
    n, (sides, _, maker) = JOINTS[scenario], FOREIGN[kind]
    joint, side = int(rng.integers(n)), str(rng.choice(sides))
    drawn = Case(f"{number} {scenario} {kind}", scenario, kind, joint=joint, side=side, size=0.2)
    drawn = maker(drawn.imperfect(seed=number), rng)
    bits, noise = [float(rng.integers(16, 21))] * n, [float(10 ** rng.uniform(-4, -3))] * n
    drawn = drawn.imperfect(link_encoder_bits=bits, motor_encoder_bits=bits)
    drawn = drawn.imperfect(link_velocity_noise=noise, motor_velocity_noise=noise)
    return replace(drawn, start=start_of(scenario, rng))
