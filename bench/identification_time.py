# SPDX-License-Identifier: Apache-2.0
"""Time and memory of `fjr identify` for a minute of seven joints at 1 kHz, on the motion that `fjr excite` designs.

Records are runs in lock-step with encoder noise; stiffness and rotor inertia in the robot file are wrong. The intervals
of the stiffness from the designed motion are compared with those from the scenario's own.
"""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from bench.arm import arm7
from bench.figures import Figure
from bench.nodes import Used, used
from fjr_core.numerics.checks import Array
from fjr_identification.estimation.parameters import SMOOTHING

DURATION, SHORT = 60.0, 10.0  # s
NOISE = 1e-5  # rad
WRONG = {"joint_stiffness": 1.3, "motor_inertia": 0.8}  # times the truth
LONGEST = 60.0  # s, on two cores
TRUE = {"joint_stiffness": "K", "motor_inertia": "M_m", "link_damping": "D_l", "motor_damping": "D_m"}
"""Attributes of the robot by parameter; the others are 0."""


def of_a_minute(duration: float = DURATION) -> list[Figure]:
    """Measure the command on a record of `duration` [s], and count the intervals that contain the truth."""
    with tempfile.TemporaryDirectory() as name:
        run = _recorded(Path(name), _excited(Path(name), duration), duration)
        found, estimates = _identified(Path(name), run)
    inside = _inside(estimates)
    label = f"{duration:g} s of seven joints"
    bound = LONGEST if duration == DURATION else None
    parts = {"processor [s]": found.processor, "memory [MB]": found.memory}
    return [
        Figure(f"fjr identify, {label}", found.seconds, "s", bound=bound, parts=parts),
        Figure(f"95 % intervals with the truth, {label}", 100 * sum(inside) / len(inside), "%"),
    ]


def of_designed_motion(duration: float = SHORT) -> list[Figure]:
    """Compare the intervals of the stiffness from the scenario's motion with those from the designed one."""
    with tempfile.TemporaryDirectory() as name:
        motions = "arm7", _excited(Path(name), duration)
        runs = [_recorded(Path(name), motion, duration) for motion in motions]
        before, after = (
            np.array([e["high"] - e["low"] for e in _identified(Path(name), run)[1] if e["name"] == "joint_stiffness"])
            for run in runs
        )
    parts = {"least": float(min(before / after)), "most": float(max(before / after))}
    name = f"intervals of the stiffness over those of the designed motion, {duration:g} s, median"
    return [Figure(name, float(np.median(before / after)), "", parts=parts)]


def _excited(folder: Path, duration: float) -> str:
    """Return the scenario with the motion that `fjr excite` designs for `arm7`."""
    excited = str(folder / "excited.yaml")
    used("fjr", "excite", "arm7", "--duration", f"{min(duration, 20.0):g}", "--output", excited)
    return excited


def _recorded(folder: Path, scenario: str, duration: float) -> str:
    """Return the folder of a run with encoder noise."""
    noise = [f"imperfections.{side}_position_noise:={[NOISE] * 7}" for side in ("link", "motor")]
    changes = [argument for each in noise for argument in ("--set", each)]
    run = ["--lockstep", "--no-report", "--duration", f"{duration:g}", "--output", str(folder / "runs")]
    used("fjr", "run", scenario, *run, *changes)
    return str(folder / "runs" / Path(scenario).stem)


def _identified(folder: Path, run: str) -> tuple[Used, list[dict[str, Any]]]:
    """Identify a run from a robot file with wrong values; return what the command used, and its estimates."""
    robot = {name: (factor * _true(name)).tolist() for name, factor in WRONG.items()}
    document = {"file": "package://fjr_bringup/robots/arm7.yaml", **robot}
    file, output = folder / "guessed.yaml", folder / "identified" / Path(run).name
    file.write_text(yaml.safe_dump({"/**": {"ros__parameters": {"robot": document}}}), encoding="utf-8")
    found = used("fjr", "identify", run, "--robot", str(file), "--output", str(output))
    return found, json.loads((output / "identification.json").read_text(encoding="utf-8"))["estimates"]


def _true(name: str) -> Array:
    """Return the true values (n,) of a parameter."""
    robot = arm7().robot
    return np.diag(getattr(robot, TRUE[name])) if name in TRUE else np.zeros(robot.n)


def _inside(estimates: list[dict[str, Any]]) -> list[bool]:
    """Return for each estimate whether its interval contains the truth; the arm has no friction that turns over."""
    joints = arm7().joints
    return [
        bool(each["low"] <= _true(each["name"])[joints.index(each["joint"])] <= each["high"])
        for each in estimates
        if each["name"] != SMOOTHING
    ]
