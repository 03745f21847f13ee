# SPDX-License-Identifier: Apache-2.0
"""`fjr excite`: design the motion that best reveals the parameters of elastic joints, and write a scenario of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fjr_core.config.parameter import vector
from fjr_core.config.plant import sensor_errors
from fjr_core.config.scenario import Scenario
from fjr_core.files.text_file import write_text
from fjr_core.law.linearized import rest_position
from fjr_core.numerics.checks import Array
from fjr_design.scaffold.first_loop import first_values
from fjr_identification.excitation.elastic_motion import PARAMETERS, JointNoise, encoder_noise, motion_envelope
from fjr_identification.excitation.optimal_design import Excitation, design
from fjr_msgs_py.console.output import Result, aligned, phase, plural
from fjr_msgs_py.scenarios import library
from fjr_msgs_py.scenarios.library import ScenarioError

SHARE = 0.9  # of each limit that the motion may use
EFFORT_NOISE = 1e-3  # of the effort limit
HALF_WIDTH = 1.96  # standard deviations of a 95 % interval
SHOWN = {"joint_stiffness": "stiffness", "motor_inertia": "motor inertia"}


def excite(
    scenario: str | None,
    assignments: Sequence[str],
    duration: float,
    noise: float,
    seed: int,
    output: Path | None,
    force: bool,
) -> Result:
    """Write a scenario whose reference of `duration` [s] reveals stiffness, inertia and friction of the joints best.

    scenario: also a robot file, which gets a first motion and, along the new one, gains. noise [rad]: of encoders that
    the scenario has without errors. Raises FjrError.
    """
    path = library.find(scenario)
    target = output or Path(f"{path.stem}_excite.yaml")
    if target.exists() and not force:
        raise ScenarioError(f"{target} exists; expected a new file, another --output, or --force")
    changes = library.parse_assignments(assignments)
    loaded = library.as_run(path, changes, robot_only=True)[1]
    if library.is_robot_file(path):
        changes = {**first_values(loaded), **changes}
        loaded = library.as_run(path, changes)[1]
    excitation = _designed(loaded, duration, noise, seed)
    write_text(target, _text(path, loaded, excitation, changes))
    library.load(str(target))  # a file that cannot be read back must not look finished
    half, was = (
        {name: HALF_WIDTH * deviations[:, PARAMETERS.index(name)] for name in SHOWN}
        for deviations in (excitation.deviations, excitation.before)
    )
    values = {
        "scenario_file": target,
        "duration_s": excitation.duration,
        "period_s": excitation.period,
        "joints": loaded.joints,
        "relative_half_width": half,
        "relative_half_width_before": was,
    }
    return Result(_table(loaded, excitation, target, half, was), values)


def _designed(scenario: Scenario, duration: float, least: float, seed: int) -> Excitation:
    """Design a motion that uses SHARE of the limits of the controller and the robot.

    Noise is that of the simulated sensors, at least `least` [rad], and EFFORT_NOISE of the effort limits.
    """
    robot, reference = scenario.robot, scenario.reference
    acceleration = vector(scenario.controller_values, "limits.acceleration", robot.n)
    limits = motion_envelope(robot, scenario.settings, acceleration, reference, SHARE, duration)
    sensors = sensor_errors(scenario.plant_values, robot.n)
    link = encoder_noise(np.asarray(sensors.bits_l), np.asarray(sensors.position_l), least)
    motor = encoder_noise(np.asarray(sensors.bits_m), np.asarray(sensors.position_m), least)
    noise = JointNoise(link, motor, EFFORT_NOISE / SHARE * np.abs(robot.B_m) @ limits.upper[-1])
    with phase(f"{scenario.name}: designing {duration:g} s of motion for {plural(robot.n, 'joint')}"):
        return design(robot, limits, noise, reference, duration, scenario.sample_period, seed)


def _text(path: Path, scenario: Scenario, excitation: Excitation, changes: Mapping[str, Any]) -> str:
    """Return the scenario of the file with the changes, the reference, and the plant at rest at its start."""
    motion, robot = excitation.reference, scenario.plant.robot
    position = rest_position(robot, np.asarray(motion.jets(0.0))[0])
    rows = {name: np.ravel(getattr(motion, name)).tolist() for name in ("amplitude", "frequency", "phase")}
    values = {
        **changes,
        "reference.type": "multi_sine",
        **{f"reference.multi_sine.{name}": entries for name, entries in rows.items()},
        "reference.offset": np.ravel(motion.offset).tolist(),
        "initial_link_position": np.ravel(position[: robot.n]).tolist(),
        "initial_motor_position": np.ravel(position[robot.n :]).tolist(),
        "initial_link_velocity": [0.0] * robot.n,
        "initial_motor_velocity": [0.0] * robot.n,
    }
    text = library.as_run(path, values)[0]
    settings = text[text.index("\n/**:") + 1 :]
    return (
        f"# Excitation of {scenario.name}: {excitation.duration:g} s that reveal stiffness, inertia and friction of "
        f"its\n# joints, at rest at 0 s and every {excitation.period:g} s. Run and record it:\n"
        f"#   fjr run THIS_FILE --duration {excitation.duration:g}\n{settings}"
    )


def _table(
    scenario: Scenario, excitation: Excitation, target: Path, half: Mapping[str, Array], was: Mapping[str, Array]
) -> str:
    """Return the expected half widths of the intervals of each joint, and those along the reference of the scenario."""
    frequencies = np.asarray(excitation.reference.frequency) / (2 * np.pi)
    rows = [("joint", *SHOWN.values())]
    for j, joint in enumerate(scenario.joints):
        rows.append((joint, *(f"{_percent(half[name][j])} ({_percent(was[name][j])})" for name in SHOWN)))
    lines = [
        f"scenario   {target}",
        f"reference  multi_sine, {frequencies.min():.3g} to {frequencies.max():.3g} Hz, {excitation.duration:g} s, at "
        f"rest every {excitation.period:g} s",
        f"expected 95 % intervals (Cramer-Rao bound), and those along the reference of {scenario.name}:",
        *(f"  {line}" for line in aligned(rows)),
    ]
    return "\n".join(lines)


def _percent(share: float) -> str:
    return f"+-{100 * share:.2g} %" if share < 1 else "unknown"
