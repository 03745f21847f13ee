# SPDX-License-Identifier: Apache-2.0
"""Text of robot.yaml: the identified robot, its friction and delay, and a loop that tracks a first motion."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fjr_core.config import ros_yaml
from fjr_core.config.builders import gain_values
from fjr_core.config.robot_file import URDF
from fjr_core.errors import GainsError, TrajectoryError
from fjr_core.model.robot import Robot
from fjr_core.simulation.nonideal_parameters import Nonidealities, friction_rate
from fjr_design.posterior.drawn_plants import MATRICES
from fjr_design.posterior.result import UNKNOWN, Estimate, Identification
from fjr_design.scaffold.first_loop import RATE, Proposal, proposal_of
from fjr_identification.estimation.parameters import PSEUDO_INERTIA
from fjr_identification.robot_file.nominal_robot import (
    NominalRobot,
    corrected_urdf,
    joint_values,
    robot_of,
    significant,
)
from fjr_msgs_py.scenarios.gains_block import gain_lines

FRICTION = {
    "link_coulomb_friction": "coulomb_l",
    "motor_coulomb_friction": "coulomb_m",
    "link_static_friction": "static_l",
    "motor_static_friction": "static_m",
}
PAYLOAD = ("payload_mass", "payload_position_x", "payload_position_y", "payload_position_z")
STABLE_STEP = 2.0  # friction rate times inner step; Runge-Kutta 4 is stable below 2.78
MOST_STEPS = 200
HEAD = """\
# {name}, identified from {records}. Written by `fjr identify`.
# A scenario: fjr check {file}, fjr run {file} --lockstep. As `robot.file` of another one it gives joints, robot and
# imperfections. Intervals are of 95 %; identification.json has them all, identification.html shows the fit.
/**:
  ros__parameters:
"""
LOOP = """\
/**/fjr_plant:   # the simulated arm: at rest next to the reference
  ros__parameters:
    publish_rate: {rate}          # Hz
    inner_steps: {steps}
    initial_link_position: {q_l}
    initial_motor_position: {q_m}
/**/fjr_controller:
  ros__parameters:
    gains:   # beta {beta:g} 1/s {where}; others: fjr gains {file} --write --beta RATE
{gains}
    reference:
      type: sine
      amplitude: {amplitude}
      frequency: {frequency}   # rad/s
      offset: {offset}
      phase: {phase}
    on_stop: gravity_hold
    start: {{ramp_time: 0.1}}       # s
    state_timeout: 0.2            # s
"""


@dataclass(frozen=True)
class RobotFile:
    """Text of robot.yaml, and why it has no loop: "" if it has one."""

    text: str
    reason: str = ""


def robot_file(
    nominal: NominalRobot, found: Identification, values: Mapping[str, object], records: Sequence[str], file: str
) -> RobotFile:
    """Return the robot file of identified values; without a loop if no gains are found."""
    robot, name = robot_of({**values, **_urdf(nominal, found)}), nominal.name
    head = HEAD.format(name=name, records=", ".join(records), file=file)
    body = [head, *_robot_lines(found, values), *_imperfection_lines(found, nominal.joints), *_left_out(found)]
    text = "\n".join(line.rstrip("\n") for line in body) + "\n"
    try:
        proposal = proposal_of(robot, nominal.joints, name, effort_delay(found))
    except (GainsError, TrajectoryError) as error:
        return RobotFile(text, str(error))
    return RobotFile(text + _loop(robot, found, nominal.joints, proposal, file))


def _urdf(nominal: NominalRobot, found: Identification) -> dict[str, object]:
    """Return the value of the URDF with its absolute path, or its text with corrected links."""
    given = {name: value for name, value in nominal.given.items() if name == URDF}
    text = corrected_urdf(nominal, found)
    return {URDF: text} if text else given


def effort_delay(found: Identification) -> float:
    """Return the largest identified delay of the efforts [s], 0 if no interval is above 0."""
    return max((each.value for each in found.estimates if each.name == "effort_delay" and each.low > 0), default=0.0)


def _robot_lines(found: Identification, values: Mapping[str, object]) -> Iterator[str]:
    yield f"    joints: {_list(values['joints'])}"
    yield "    robot:"
    tree = ros_yaml.tree_of({name: value for name, value in values.items() if name != "joints"})["robot"]
    for key, value in tree.items():
        yield from _comments(found, key, "      ")
        if isinstance(value, dict):
            yield f"      {key}:   # reported until they are replaced"
            yield from (f"        {name}: {_value(each)}" for name, each in value.items())
        else:
            yield f"      {key}: {_value(value)}"


def _imperfection_lines(found: Identification, joints: tuple[str, ...]) -> Iterator[str]:
    """Yield friction, payload and delay for the simulated arm."""
    known = {each.name for each in found.estimates}
    lines: list[str] = []
    for name in FRICTION:
        if name in known:
            lines += _comments(found, name, "      ")
            lines.append(
                f"      {name}: {_list(significant(max(0.0, each)) for each in joint_values(found, name, joints, 0.0))}"
            )
    if PAYLOAD[0] in known:
        mass, *place = (_single(found, name) for name in PAYLOAD)
        lines += [line for name in PAYLOAD for line in _comments(found, name, "      ")]
        lines += [f"      payload_mass: {significant(max(0.0, mass))}", f"      payload_position: {_list(place)}"]
    if "effort_delay" in known:
        lines += _comments(found, "effort_delay", "      ")
        lines.append(
            f"      command_delay: {significant(max(0.0, effort_delay(found)))}   # s, the largest of all joints"
        )
    yield from (["    imperfections:   # of the simulated arm", *lines] if lines else [])


def _left_out(found: Identification) -> Iterator[str]:
    """Yield comments on what no parameter of a scenario expresses."""
    placed = {*MATRICES, *FRICTION, *PAYLOAD, *PSEUDO_INERTIA, "effort_delay"}
    others = [each for each in found.estimates if each.name not in placed and each.verdict != UNKNOWN]
    if others:
        yield "    # Without a parameter here; correct these in the driver:"
        yield from (f"    #   {each.name} of {each.joint or 'the arm'}: {described(each)}" for each in others)


def _comments(found: Identification, name: str, indent: str) -> list[str]:
    """Return a line for each joint with interval and verdict of a parameter."""
    own = [each for each in found.estimates if each.name == name]
    return [f"{indent}# {name} of {each.joint or 'the arm'}: {described(each)}" for each in own]


def described(each: Estimate) -> str:
    """Return value, interval, unit and verdict of an estimate."""
    if each.verdict == UNKNOWN:
        return f"{each.value:.4g} {each.unit}, not identifiable from these records, as before ({each.reason})"
    why = f" ({each.reason})" if each.reason else ""
    return f"{each.value:.4g} {each.unit}, {plain_interval(each)}, {each.verdict}{why}"


def plain_interval(each: Estimate) -> str:
    """Return an interval without superscripts, with as many digits as tell its ends apart."""
    for digits in range(4, 9):
        ends = f"{each.low:.{digits}g}", f"{each.high:.{digits}g}"
        if ends[0] != ends[1]:
            break
    return f"{ends[0]} to {ends[1]}"


def _loop(robot: Robot, found: Identification, joints: tuple[str, ...], proposal: Proposal, file: str) -> str:
    """Return the sections of the single nodes."""
    motion, gains, n = proposal.motion, proposal.gains, robot.n
    entries = {key.partition(".")[2]: values for key, values in gain_values(gains.gains, n).items()}
    return LOOP.format(
        rate=RATE,
        steps=_inner_steps(robot, found, joints, proposal),
        q_l=_list(map(significant, proposal.q_l)),
        q_m=_list(map(significant, proposal.q_m)),
        beta=gains.beta,
        where=gains.where,
        file=file,
        gains="\n".join(gain_lines(entries, n, indent=6)),
        **{name: _list(map(significant, np.atleast_1d(getattr(motion, name)))) for name in MOTION},
    )


MOTION = ("amplitude", "frequency", "offset", "phase")


def _inner_steps(robot: Robot, found: Identification, joints: tuple[str, ...], proposal: Proposal) -> int:
    """Return the integrator steps per sample that springs and friction need."""
    levels = {field: np.maximum(0.0, joint_values(found, name, joints, 0.0)) for name, field in FRICTION.items()}
    rate = friction_rate(Nonidealities(robot.n, **levels), robot.M_l(proposal.q_l), robot.M_m)
    return min(MOST_STEPS, max(proposal.inner_steps, math.ceil(rate / RATE / STABLE_STEP)))


def _single(found: Identification, name: str) -> float:
    return next(significant(each.value) for each in found.estimates if each.name == name)


def _list(values: object) -> str:
    return ros_yaml.dump(list(values)).strip()  # type: ignore[call-overload]


def _value(value: object) -> str:
    """Return a value of a parameter in YAML, on one line."""
    return ros_yaml.dump([value]).strip()[1:-1]
