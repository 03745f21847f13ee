# SPDX-License-Identifier: Apache-2.0
"""Time and memory of `fjr identify` for a minute of seven joints at 1 kHz, on the motion that `fjr excite` designs.

The record is a run in lock-step with encoder noise; stiffness and rotor inertia in the robot file are wrong.
"""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

import yaml

from bench.arm import SCENARIO
from bench.figures import Figure
from bench.nodes import used
from fjr_core.config.scenario import load_scenario
from fjr_identification.estimation.parameters import SMOOTHING

DURATION = 60.0  # s
NOISE = 1e-5  # rad
WRONG = {"joint_stiffness": 1.3, "motor_inertia": 0.8}  # times the truth
LONGEST = 60.0  # s, on two cores
TRUE = {"joint_stiffness": "K", "motor_inertia": "M_m", "link_damping": "D_l", "motor_damping": "D_m"}
"""Attributes of the robot by parameter; the others are 0."""


def of_a_minute(duration: float = DURATION) -> list[Figure]:
    """Measure the command on a record of `duration` [s], and count the intervals that contain the truth."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _record(folder, duration)
        output = folder / "identified"
        excited = str(folder / "runs" / "excited")
        found = used("fjr", "identify", excited, "--robot", _robot(folder), "--output", str(output))
        inside = _inside(json.loads((output / "identification.json").read_text(encoding="utf-8")))
    label = f"{duration:g} s of seven joints"
    bound = LONGEST if duration == DURATION else None
    parts = {"processor [s]": found.processor, "memory [MB]": found.memory}
    return [
        Figure(f"fjr identify, {label}", found.seconds, "s", bound=bound, parts=parts),
        Figure(f"95 % intervals with the truth, {label}", 100 * sum(inside) / len(inside), "%"),
    ]


def _record(folder: Path, duration: float) -> None:
    """Record the designed motion in folder/runs/excited."""
    excited = str(folder / "excited.yaml")
    noise = [f"imperfections.{side}_position_noise:={[NOISE] * 7}" for side in ("link", "motor")]
    changes = [argument for each in noise for argument in ("--set", each)]
    used("fjr", "excite", str(SCENARIO), "--duration", f"{min(duration, 20.0):g}", "--output", excited)
    run = ["--lockstep", "--no-report", "--duration", f"{duration:g}", "--output", str(folder / "runs")]
    used("fjr", "run", excited, *run, *changes)


def _robot(folder: Path) -> str:
    """Return a robot file with wrong stiffness and rotor inertia."""
    robot: dict[str, Any] = {"file": "package://fjr_bringup/robots/arm7.yaml"}
    for name, factor in WRONG.items():
        robot[name] = [factor * value for value in _true(name)]
    path = folder / "guessed.yaml"
    path.write_text(yaml.safe_dump({"/**": {"ros__parameters": {"robot": robot}}}), encoding="utf-8")
    return str(path)


def _true(name: str) -> list[float]:
    robot = load_scenario(SCENARIO).robot
    matrix = getattr(robot, TRUE[name]) if name in TRUE else None
    return [0.0] * robot.n if matrix is None else [float(matrix[j, j]) for j in range(robot.n)]


def _inside(found: dict[str, Any]) -> list[bool]:
    """Return for each estimate whether its interval contains the truth; the arm has no friction that turns over."""
    joints = load_scenario(SCENARIO).joints
    return [
        each["low"] <= _true(each["name"])[joints.index(each["joint"])] <= each["high"]
        for each in found["estimates"]
        if each["name"] != SMOOTHING
    ]
