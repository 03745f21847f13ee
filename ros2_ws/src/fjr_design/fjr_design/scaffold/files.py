# SPDX-License-Identifier: Apache-2.0
"""The text of the robot file and the scenario file of an arm."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from fjr_core.config import ros_yaml
from fjr_core.config.law import gain_values
from fjr_core.model.joints import joined
from fjr_core.numerics.checks import Array
from fjr_design.scaffold.arm import Arm
from fjr_design.scaffold.first_loop import RATE, Proposal
from fjr_msgs_py.console.output import plural
from fjr_msgs_py.scenarios.gains_block import gain_lines

STIFFNESS, INERTIA = "N m/rad", "kg m^2"
SYMBOLS = {"joint_stiffness": "K", "motor_inertia": "M_m, reflected to the link side of the gear"}
SCENARIO = """\
# {name}: slow sines of {joints} about a pose within the ranges. Written by `fjr new`; change it freely.
# docs/your_robot.md explains the file, docs/references.md other motions, docs/safety.md the limits.
/**:
  ros__parameters:
    realtime_priority: 50         # SCHED_FIFO where the system allows it, else a warning; 0: ordinary scheduling
    robot:
      file: {robot_file}

    # fjr_plant, the simulated arm: at rest next to the reference, the springs loaded by the weight
    publish_rate: {rate}          # Hz
    inner_steps: {steps}                # integrator steps per state
    initial_link_position: {q_l}   # {unit}
    initial_motor_position: {q_m}

    # fjr_controller
    gains:   # others: fjr gains {name}.yaml --write --beta RATE
{gains}
    reference:   # q_ld = offset + amplitude sin(frequency t + phase)
      type: sine
      amplitude: {amplitude}   # {unit}
      frequency: {frequency}   # rad/s
      offset: {offset}
      phase: {phase}
    limits:
      from_robot: {from_robot}            # range, speed and effort of the URDF
      deflection: {deflection}   # {unit}, of the springs: 3 times that under the effort limit
      tracking_error: {tracking_error}
      start_error: {start_error}
    on_stop: gravity_hold         # the weight, with damped motors
    start: {{ramp_time: 0.1, join_time: 1.0}}   # s; to the law's effort; to the reference, beyond start_error
    recovery: {{join_time: 1.0}}    # s, or as long as the limits of velocity and acceleration ask
    state_timeout: 0.2            # s without a state: on_stop
"""
ROUNDED, EXACT = 9, 17  # digits of a number
DEFLECTION = 3.0  # times that under the effort limit: more than a motion needs, less than a motor encoder that jumps
TRACKING_ERROR, START_ERROR = (0.15, 0.03), (0.1, 0.02)  # rad, m; limits of revolute and prismatic joints


def robot_text(arm: Arm, folder: Path) -> str:
    """Return the robot file, for a file in this folder."""
    stuck = {name: position for name, position in arm.locked.items() if position}
    lines = [
        f"# {arm.urdf.stem}: {plural(arm.robot.n, 'joint')} of {arm.urdf.name}, base to tip; written by `fjr new`.",
        "# A robot file: `robot.file` of a scenario names it. docs/your_robot.md has all parameters.",
        *([f"# Locked: {locked_joints(arm.locked)}"] if arm.locked else []),
        *(f"# {note}" for note in arm.notes),
        "/**:",
        "  ros__parameters:",
        f"    joints: {_list(arm.joints)}",
        "    robot:",
        "      model: urdf",
        f"      urdf: {_scalar(path_from(folder, arm.urdf))}",
        f"      gravity: {_list(arm.gravity)}   # m/s^2 in the root link of the URDF; differs for a wall-mounted arm",
    ]
    if stuck:
        lines += [f"      locked_joints: {_list(stuck)}", f"      locked_positions: {_list(stuck.values())}"]
    for name, unit, matrix in (("joint_stiffness", STIFFNESS, arm.robot.K), ("motor_inertia", INERTIA, arm.robot.M_m)):
        what = f"{SYMBOLS[name]} [{joined(by_unit(arm, unit, np.diag(matrix)))}]{origin_of(arm, name)}"
        lines.append(f"      {name}: {_list(np.diag(matrix), EXACT)}   # {what}")
    if arm.guesses:
        lines += [
            "      # A URDF has neither. These values are typical for the size of the joints, no data of this robot",
            "      # (docs/your_robot.md): replace them above. `fjr` reports values that still equal their guess here.",
            "      guesses:",
            *(f"        {name}: {_list(values)}" for name, values in arm.guesses.items()),
        ]
    return "\n".join(lines) + "\n"


def scenario_text(name: str, robot_file: str, arm: Arm, proposal: Proposal) -> str:
    """Return the scenario file, next to this robot file."""
    motion, gains, n, limits = proposal.motion, proposal.gains, arm.robot.n, arm.robot.limits
    values = {key.partition(".")[2]: entries for key, entries in gain_values(gains.gains, n).items()}
    slides = [unit.position == "m" for unit in arm.robot.units]
    effort = np.full(n, np.inf) if limits is None else limits.effort
    return SCENARIO.format(
        name=name,
        joints=plural(n, "joint"),
        robot_file=_scalar(robot_file),
        rate=RATE,
        steps=proposal.inner_steps,
        unit=joined(each.position for each in arm.robot.units),
        q_l=_list(proposal.q_l),
        q_m=_list(proposal.q_m),
        gains="\n".join(gain_lines(values, n, indent=6)),
        **{name: _list(getattr(motion, name)) for name in ("amplitude", "frequency", "offset", "phase")},
        from_robot="false" if limits is None else "true",
        deflection=_list(DEFLECTION * effort / np.diag(arm.robot.K), 3),
        tracking_error=_list(TRACKING_ERROR[each] for each in slides),
        start_error=_list(START_ERROR[each] for each in slides),
    )


def by_unit(arm: Arm, unit: str, values: Array) -> dict[str, Array]:
    """Return values (n,) of the joints by their units, of which `unit` is that of a revolute joint."""
    units = np.array([each.of(unit) for each in arm.robot.units])
    return {str(each): values[units == each] for each in dict.fromkeys(units.tolist())}


def origin_of(arm: Arm, name: str) -> str:
    """Return where a value comes from: a guess, published data, or both."""
    known = arm.source if not all(arm.guesses.get(name, (0.0,))) else ""
    guessed = "GUESS" if name in arm.guesses else ""
    return "".join(f"; {part}" for part in (guessed, known) if part)


def path_from(folder: Path, urdf: Path) -> str:
    """Return the URDF's path relative to the folder, so that both can be moved together.

    It is absolute if they have no folder in common but the root of the file system.
    """
    whole, base = urdf.resolve(), folder.resolve()
    together = os.path.commonpath([whole, base]) != base.anchor
    return os.path.relpath(whole, base) if together else str(whole)


def locked_joints(locked: dict[str, float], most: int = 12) -> str:
    """Return the locked joints with their positions on one line, at most so many by name."""
    plain = {re.sub(r"\s+", " ", name): position for name, position in locked.items()}  # no line breaks in a comment
    names = [f"{name}{f' at {position:g}' if position else ''}" for name, position in plain.items()]
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more + (", at 0" if not any(locked.values()) else ", the others at 0")


def _list(entries: Iterable[object] | ArrayLike, digits: int = ROUNDED) -> str:
    return "[" + ", ".join(_scalar(entry, digits) for entry in entries) + "]"  # type: ignore[union-attr]


def _scalar(value: object, digits: int = ROUNDED) -> str:
    """Return a text or a number in YAML; numbers have at most so many digits and a decimal point."""
    if isinstance(value, str):
        return ros_yaml.dump([value]).strip()[1:-1]
    return ros_yaml.dump([float(f"{float(value):.{digits}g}")]).strip()[1:-1]  # type: ignore[arg-type]
