# SPDX-License-Identifier: Apache-2.0
"""Runs with faults and physics that the labelled sets lack: sensors, springs, friction, delays.

A run is drawn by its number alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from bench.figures import markdown
from fjr_core.numerics.checks import Array
from fjr_monitor.diagnosis.diagnosis import diagnose
from fjr_monitor.diagnosis.thresholds import JointTolerances
from fjr_monitor.diagnosis.torque_faults import UNKNOWN

from .cases import JOINTS, SETTLED, Case, nominal, start_of

SEED, COUNT, DURATION = 28, 200, 4.0
ROBOTS = ("paper_k31", "two_link", "arm7")
MARGINS = {"paper_k31": 5.45e-3, "two_link": 10.1e-3, "arm7": 2.38e-3}  # s
Maker = Callable[[Case, np.random.Generator], Case]


def _encoder(c: Case, error: Callable[[Array, float], Array], rate: Callable[[Array], Array]) -> Case:
    """Return a fault that adds error(q, t) to one position, and rate(q) dq to its velocity."""
    one = np.eye(2 * c.n)[c.channel]
    last: dict[str, Any] = {"t": -1e-3, "q": np.zeros(2 * c.n)}

    def position(q: Array) -> Array:
        last.update(t=last["t"] + 1e-3, q=q)
        return np.asarray(q + one * error(q, last["t"]))

    return c.faulty(position=position, velocity=lambda dq: dq + one * rate(last["q"]) * dq)


def _gain(c: Case, rng: np.random.Generator) -> Case:
    g = rng.choice([-1, 1]) * rng.uniform(0.005, 0.03)
    return _encoder(c, lambda q, t: g * q, lambda q: g + 0 * q)


def _eccentric(c: Case, rng: np.random.Generator) -> Case:
    a, at = rng.uniform(2e-3, 8e-3), rng.uniform(0, 2 * np.pi)
    return _encoder(c, lambda q, t: a * np.sin(q + at), lambda q: a * np.cos(q + at))


def _slip(c: Case, rng: np.random.Generator) -> Case:
    jump, begin = 0.5 * c.torque / c.K, rng.uniform(0.3, 0.7) * DURATION
    return _encoder(c, lambda q, t: jump * (t >= begin) + 0 * q, lambda q: 0 * q)


def _drift(c: Case, rng: np.random.Generator) -> Case:
    speed = 0.3 * c.torque / c.K
    return _encoder(c, lambda q, t: speed * t + 0 * q, lambda q: 0 * q)


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


def _late(c: Case, rng: np.random.Generator) -> Case:
    return c.imperfect(command_delay=float(rng.uniform(0.3, 0.9) * MARGINS[c.scenario]))


def _varying(c: Case, rng: np.random.Generator) -> Case:
    return c.imperfect(command_jitter=float(rng.uniform(0.3, 0.6) * MARGINS[c.scenario]))


def _soft_later(c: Case, rng: np.random.Generator) -> Case:
    share = c.at(rng.uniform(0.1, 0.25))
    calls = [0.0, rng.uniform(0.3, 0.7) * DURATION]

    def effort(u: Array) -> Array:
        calls[0] += 1e-3
        return np.asarray(u * (1 - share * (calls[0] >= calls[1])))

    return c.faulty(effort=effort)


KINDS: dict[str, tuple[tuple[str, ...], tuple[str, ...], Maker]] = {
    "encoder gain": (("link", "motor"), ("encoder gain",), _gain),
    "eccentricity of an encoder": (("link", "motor"), ("eccentricity",), _eccentric),
    "encoder that slips": (("link", "motor"), ("encoder slip",), _slip),
    "encoder that drifts": (("link", "motor"), ("encoder drift",), _drift),
    "motor that weakens": (("motor",), ("torque constant",), _soft_later),
    "Stribeck friction": (("link", "motor"), ("Coulomb friction",), _stribeck),
    "cubic spring": (("joint",), ("cubic stiffness",), _cubic),
    "rippled spring": (("joint",), (), _kinematic),
    "delay": (("",), (), _late),
    "delay that varies": (("",), (), _varying),
}
"""Sides, findings that are right (none: that of no single kind), and how the fault is made."""


def case(number: int) -> Case:
    """Return a run with a fault on random joints, with encoders of 16 to 20 bits and noisy velocities."""
    rng = np.random.default_rng((SEED, number))
    kind, scenario = list(KINDS)[number % len(KINDS)], str(rng.choice(ROBOTS))
    n, (sides, _, maker) = JOINTS[scenario], KINDS[kind]
    joint, side = int(rng.integers(n)), str(rng.choice(sides))
    drawn = Case(f"{number} {scenario} {kind}", scenario, kind, joint=joint, side=side, size=0.2)
    drawn = maker(drawn.imperfect(seed=number), rng)
    bits, noise = [float(rng.integers(16, 21))] * n, [float(10 ** rng.uniform(-4, -3))] * n
    drawn = drawn.imperfect(link_encoder_bits=bits, motor_encoder_bits=bits)
    drawn = drawn.imperfect(link_velocity_noise=noise, motor_velocity_noise=noise)
    return replace(drawn, start=start_of(scenario, rng))


def result(number: int) -> dict[str, Any]:
    """Return what the diagnosis says of a run, and its largest settled error relative to the tolerance."""
    drawn = case(number)
    loop = drawn.run(DURATION)
    record, robot = loop.record(), loop.scenario.robot
    axes = JointTolerances.of(loop.scenario.controller_values, robot)
    said = diagnose(record, loop.scenario.tracking_law, axes=axes)
    error = np.abs(record.position[:, : robot.n] - record.jets[:, 0])[record.t > 2 * SETTLED]
    first = said.findings[0] if said.findings else None
    return {
        "name": drawn.name,
        "kind": drawn.kind,
        "joint": nominal(drawn.scenario).joints[drawn.joint],
        "verdict": said.kind,
        "causes": list(said.causes),
        "found": first.kind if first else "",
        "at": first.joint if first else "",
        "error": float((error / axes.tolerance).max(initial=0.0)),
    }


def table(results: list[dict[str, Any]]) -> list[str]:
    """Return the Markdown lines with a row for each kind of fault, and one for all."""
    found: list[tuple[str, ...]] = []
    for kind in (*KINDS, "all"):
        own = [each for each in results if kind in ("all", each["kind"])]
        named = [each for each in own if each["at"] and each["found"] != UNKNOWN and " or " not in each["found"]]
        right = [each["found"] in KINDS[each["kind"]][1] and each["at"] == each["joint"] for each in named]
        located = [each for each in own if KINDS[each["kind"]][0] != ("",)]
        joints = sum(each["at"] == each["joint"] for each in located)
        wrongly = sum(each["verdict"] == "holding" and each["error"] > 1 for each in own)
        held = sum(each["verdict"] == "holding" for each in own)
        counts = f"{sum(right)} of {len(named)}", f"{joints} of {len(located)}"
        found.append((kind, str(len(own)), *counts, str(held), str(wrongly)))
    right_kind, beyond = "one kind and joint named: right", "of these beyond the tolerance"
    return markdown(("fault", "runs", right_kind, "joint right", "holding", beyond), found)
