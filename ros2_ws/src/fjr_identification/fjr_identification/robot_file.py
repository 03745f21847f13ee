# SPDX-License-Identifier: Apache-2.0
"""The robot of a robot file or a scenario before its identification, and robot.yaml after it.

robot.yaml has the identified robot, its friction and delay, and a loop that tracks a first motion.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from fjr_core.config import ros_yaml
from fjr_core.config.law import gain_values
from fjr_core.config.nodes import CONTROLLER, PLANT
from fjr_core.config.parameter import complete, names, refuse_unknown
from fjr_core.config.plant import imperfection_parameters
from fjr_core.config.robot import CUBIC, FILE, GUESSES, guessed_joints, robot_parameters
from fjr_core.config.robot import robot as build_robot
from fjr_core.config.robot_file import URDF, merged
from fjr_core.errors import GainsError, TrajectoryError, prefixed
from fjr_core.files.text_file import is_xml, read_text
from fjr_core.model.rigid_arm import Body, rotation_to
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array
from fjr_core.simulation.imperfections import Imperfections, friction_rate, largest_load
from fjr_core.urdf.tree import parse_xml, read_urdf
from fjr_design.scaffold.files import path_from
from fjr_design.scaffold.first_loop import RATE, Proposal, proposal_of
from fjr_design.uncertainty.posterior import MATRICES, UNKNOWN, Estimate, Identification
from fjr_msgs_py.scenarios.gains_block import gain_lines

from .estimation.elastic_arm import corrected_bodies
from .estimation.parameters import HARDENING, LAG, PAYLOAD, PSEUDO_INERTIA, SMOOTHING, STRIBECK, USUAL_STRIBECK

GEAR_RATIO = "robot.gear_ratio"
CORRECTED = "robot.urdf"
STATED = f"imperfections.{SMOOTHING}"
FRICTION = {
    f"{side}_{kind}_friction": f"{kind}_{side[0]}"
    for kind in ("coulomb", "static", "load")
    for side in ("link", "motor")
}
MOTION = ("amplitude", "frequency", "offset", "phase")
STABLE_STEP = 2.0  # friction rate times inner step; Runge-Kutta 4 is stable below 2.78
MOST_STEPS = 200  # of the integrator in a sample
MARGIN = 2.0  # of the steps, for links that are lighter elsewhere than at zero


@dataclass(frozen=True)
class NominalRobot:
    """Values joints and robot.* of a file, with absolute paths, the robot they describe, and which are guesses.

    smoothing (n,) [rad/s]: imperfections.friction_smoothing_velocity of the file, where its friction turns over.
    """

    path: Path
    given: Mapping[str, object]
    joints: tuple[str, ...]
    robot: Robot
    guessed: Mapping[str, tuple[str, ...]]
    smoothing: Array

    @property
    def name(self) -> str:
        """The name of the robot in its URDF, else of its file."""
        urdf = str(self.given.get(URDF, ""))
        named = parse_xml(urdf if is_xml(urdf) else read_text(Path(urdf))).get("name") if urdf else ""
        return named or self.path.stem.removesuffix("_robot")


def nominal_robot(path: Path) -> NominalRobot:
    """Return the robot of a robot file or scenario; raise ParameterError, which names the file."""
    document = ros_yaml.read(path, "robot file")
    with prefixed(f"{path}: "):
        entries = merged(ros_yaml.values_for(CONTROLLER, document), CONTROLLER, path.parent)
        given = {
            name: value
            for name, value in entries.items()
            if name == "joints" or (name.startswith("robot.") and name != FILE.name)
        }
        parameters = robot_parameters(given)
        refuse_unknown([parameter.name for parameter in parameters], given)
        values = complete(parameters, given)
        robot = build_robot(values)
        of_plant = merged(ros_yaml.values_for(PLANT, document), PLANT, path.parent)
        stated = {name: value for name, value in of_plant.items() if name == STATED}
        smoothing = np.array(complete(imperfection_parameters(robot.n), stated)[STATED], dtype=float)
    return NominalRobot(path, given, names(values, "joints"), robot, guessed_joints(values), smoothing)


@dataclass(frozen=True)
class RobotFile:
    """Text of robot.yaml, and why it has no loop: "" if it has one."""

    text: str
    reason: str = ""


@dataclass(frozen=True)
class IdentifiedRobot:
    """A nominal robot with what was identified of it."""

    nominal: NominalRobot
    identification: Identification

    @cached_property
    def corrected_urdf(self) -> str:
        """The text of the URDF with the identified masses and inertias of the links, "" if none is corrected."""
        joints = self.nominal.joints
        bodies = corrected_bodies(self.nominal.robot.links, joints, self.identification)
        return with_inertias(str(self.nominal.given[URDF]), joints, bodies) if bodies else ""

    @property
    def effort_delay(self) -> float:
        """The largest identified delay of the efforts [s], 0 if no interval is above 0."""
        return max((estimate.value for estimate in self._of("effort_delay") if estimate.low > 0), default=0.0)

    def values(self, folder: Path) -> dict[str, object]:
        """Return joints and robot.* with the identified values, for a file in this folder.

        Motor inertias are reflected to the joint side. robot.guesses.* remain where the records do not determine the
        value.
        """
        given = self.nominal.given
        changed = {name: value for name, value in given.items() if not name.startswith("robot.guesses.")}
        urdf = changed.get(URDF)
        if self.corrected_urdf:
            changed[URDF] = CORRECTED
        elif isinstance(urdf, str) and not is_xml(urdf):
            changed[URDF] = path_from(folder, Path(urdf))
        reflected = changed.pop(GEAR_RATIO, None) is not None
        for name, symbol in MATRICES.items():
            before = np.diag(getattr(self.nominal.robot, symbol))
            values = self._of_joints(name, before)
            if not np.array_equal(values, before) or (reflected and name == "motor_inertia"):
                changed[f"robot.{name}"] = [significant(value) for value in values]
        cubic = self._of_joints(HARDENING, 0.0 if self.nominal.robot.cubic is None else self.nominal.robot.cubic)
        if self._of(HARDENING):
            changed[CUBIC.name] = [significant(max(0.0, value)) for value in cubic]
        for name in GUESSES:
            guesses = [self._guess(changed, name, j) for j in range(len(self.nominal.joints))]
            if any(guesses):
                changed[GUESSES[name].name] = guesses
        return changed

    def file(self, folder: Path, records: Sequence[str], name: str) -> RobotFile:
        """Return the robot file of this name for a folder; without a loop if no gains are found."""
        from jinja2 import Environment, PackageLoader, StrictUndefined  # a tenth of a second, only where it is written

        values, joints, title = self.values(folder), self.nominal.joints, self.nominal.name
        urdf = self.corrected_urdf or self.nominal.given.get(URDF)
        absolute = {**values, **({} if urdf is None else {URDF: urdf})}
        robot, reason, tracking = build_robot(complete(robot_parameters(absolute), absolute)), "", None
        try:
            tracking = self._tracking(robot, proposal_of(robot, joints, title, self.effort_delay))
        except (GainsError, TrajectoryError) as error:
            reason = str(error)
        tree = ros_yaml.tree_of({key: _value(value) for key, value in values.items() if key != "joints"})["robot"]
        placed = {*MATRICES, HARDENING, *FRICTION, STRIBECK, SMOOTHING, *PAYLOAD, *PSEUDO_INERTIA, "effort_delay", LAG}
        known = [estimate for estimate in self.identification.estimates if estimate.verdict != UNKNOWN]
        others = [described(each) for each in known if each.name not in placed]  # no parameter of a scenario
        found = PackageLoader("fjr_identification")
        templates = Environment(loader=found, undefined=StrictUndefined, trim_blocks=True, keep_trailing_newline=True)
        text = templates.get_template("robot.yaml").render(
            name=title,
            records=", ".join(records),
            file=name,
            described=lambda names: [described(each) for one in names for each in self._of(one)],
            joints=_value(values["joints"]),
            robot=tree,
            imperfections=self._imperfections(robot),
            others=others,
            tracking=tracking,
        )
        return RobotFile(text, reason)

    def _of(self, name: str) -> list[Estimate]:
        return [estimate for estimate in self.identification.estimates if estimate.name == name]

    def _of_joints(self, name: str, default: Array | float, end: str = "value") -> Array:
        """Return a parameter of all joints (n,), or an end of its intervals; the default where it was not estimated."""
        joints = self.nominal.joints
        values = np.array(np.broadcast_to(default, len(joints)), dtype=float)
        for estimate in self._of(name):
            if estimate.joint in joints:
                values[joints.index(estimate.joint)] = getattr(estimate, end)
        return values

    def _guess(self, changed: Mapping[str, object], name: str, j: int) -> float:
        """Return the value of a joint if it is still a guess, else 0."""
        joint, n = self.nominal.joints[j], len(self.nominal.joints)
        determined = any(estimate.joint == joint and estimate.verdict != UNKNOWN for estimate in self._of(name))
        if determined or joint not in self.nominal.guessed.get(name, ()):
            return 0.0
        values = np.asarray(changed[f"robot.{name}"], dtype=float)
        return float(values[j] if values.size == n else np.diag(values.reshape(n, -1))[j])

    def _imperfections(self, robot: Robot) -> list[tuple[Sequence[str], dict[str, str]]]:
        """Return friction, payload and delay of the simulated arm: what was identified, and the values that follow."""
        found: list[tuple[Sequence[str], dict[str, str]]]
        found = [([name], {name: _numbers(self._levels[field])}) for name, field in FRICTION.items() if self._of(name)]
        if self._of(STRIBECK):
            falling = _numbers(self._of_joints(STRIBECK, USUAL_STRIBECK))
            found.append(([STRIBECK], {f"{side}_stribeck_velocity": falling for side in ("link", "motor")}))
        if found:
            found.append(([SMOOTHING], {SMOOTHING: f"{_numbers(self._smoothing(robot))}   # enough to be integrated"}))
        if self._of(PAYLOAD[0]):
            mass, *place = (significant(self._of(name)[0].value) for name in PAYLOAD)
            found.append((PAYLOAD, {"payload_mass": f"{max(0.0, mass)}", "payload_position": _value(place)}))
        if self._of("effort_delay"):
            lag = self._of_joints(LAG, 0.0) * (self._of_joints(LAG, 0.0, "low") > 0)
            delay = significant(max(0.0, self.effort_delay - float(np.max(lag))))
            lags = {LAG: _numbers(lag)} if np.any(lag) else {}
            found.append((["effort_delay", LAG], {"command_delay": f"{delay}   # s, without lag", **lags}))
        return found

    @property
    def _levels(self) -> dict[str, Array]:
        """Return the levels (n,) of friction by the names of Imperfections."""
        return {field: np.maximum(0.0, self._of_joints(name, 0.0)) for name, field in FRICTION.items()}

    def _smoothing(self, robot: Robot) -> Array:
        """Return the velocities (n,) [rad/s] over which friction turns over, at least what MOST_STEPS integrate."""
        unit = Imperfections(robot.n, **self._levels, smoothing=1.0)
        rest = np.zeros(robot.n)
        rate = friction_rate(unit, robot.M_l(rest), robot.M_m, largest_load(robot, rest))
        least = rate / (RATE * STABLE_STEP * MOST_STEPS / MARGIN)
        return np.maximum(self._of_joints(SMOOTHING, self.nominal.smoothing), least)

    def _tracking(self, robot: Robot, proposal: Proposal) -> dict[str, object]:
        """Return the values of the loop; integrator steps per sample as springs and friction need them."""
        motion, gains, n = proposal.motion, proposal.gains, robot.n
        turning = Imperfections(n, **self._levels, smoothing=self._smoothing(robot))
        rate = friction_rate(turning, robot.M_l(proposal.q_l), robot.M_m, largest_load(robot, proposal.q_l))
        entries = {key.partition(".")[2]: values for key, values in gain_values(gains.gains, n).items()}
        return {
            "rate": RATE,
            "steps": min(MOST_STEPS, max(proposal.inner_steps, math.ceil(rate / RATE / STABLE_STEP))),
            "q_l": _numbers(proposal.q_l),
            "q_m": _numbers(proposal.q_m),
            "beta": gains.beta,
            "where": gains.where,
            "gains": "\n".join(gain_lines(entries, n, indent=6)),
            **{name: _numbers(np.atleast_1d(getattr(motion, name))) for name in MOTION},
        }


def described(estimate: Estimate) -> str:
    """Return name, joint, value, interval, unit and verdict of an estimate."""
    value = f"{estimate.name} of {estimate.joint or 'the arm'}: {estimate.value:.4g} {estimate.unit}".rstrip()
    seen = f", {estimate.seen}" if estimate.seen else ""
    if estimate.verdict == UNKNOWN:
        return f"{value}{seen}, not identifiable from these records, kept as given ({estimate.reason})"
    for digits in range(4, 9):  # as many as distinguish the ends
        low, high = f"{estimate.low:.{digits}g}", f"{estimate.high:.{digits}g}"
        if low != high:
            break
    why = f" ({estimate.reason})" if estimate.reason else ""
    return f"{value}, {low} to {high}{seen}, {estimate.verdict}{why}"


def significant(value: float) -> float:
    """Return a number with six significant digits."""
    return float(f"{value:.6g}")


def _numbers(values: Iterable[float]) -> str:
    return _value([significant(value) for value in values])


def _value(value: object) -> str:
    """Return a value of a parameter in YAML, on one line."""
    return ros_yaml.dump([value]).strip()[1:-1]


def with_inertias(path_or_xml: str | os.PathLike[str], joints: Sequence[str], bodies: Sequence[Body]) -> str:
    """Return the URDF text with the inertia of each body, whose joint axis is z, at the link that its joint moves.

    Links that are fixed to it, or that joints without a name here carry, lose their own inertia: it is part of the
    body. Raises RobotError for a URDF that cannot be read.
    """
    tree = read_urdf(path_or_xml)
    inline = str(path_or_xml).lstrip().startswith("<")
    root = parse_xml(str(path_or_xml) if inline else Path(path_or_xml).read_bytes())
    links = {element.get("name", ""): element for element in root.findall("link")}
    for link in tree.moved_by(joints):
        for element in links[link].findall("inertial"):
            links[link].remove(element)
    for name, body in zip(joints, bodies, strict=True):
        joint = tree.joints[name]
        turn = rotation_to(np.asarray(joint.axis))
        com, moments = turn @ np.asarray(body.com), turn @ np.asarray(body.inertia) @ turn.T
        inertial = ElementTree.SubElement(links[joint.child], "inertial")
        ElementTree.SubElement(inertial, "origin", xyz=" ".join(f"{each:.9g}" for each in com))
        ElementTree.SubElement(inertial, "mass", value=f"{body.mass:.9g}")
        entries = {f"i{'xyz'[i]}{'xyz'[k]}": f"{moments[i, k]:.9g}" for i in range(3) for k in range(i, 3)}
        ElementTree.SubElement(inertial, "inertia", entries)
    ElementTree.indent(root)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"
