# SPDX-License-Identifier: Apache-2.0
"""The robot of a robot file or a scenario before its identification, and after it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fjr_core.config import builders, robot_file, ros_yaml
from fjr_core.config.guesses import GUESSED, GUESSES, guessed_joints
from fjr_core.config.parameter import complete, names, refuse_unknown
from fjr_core.config.robot import FILE, robot_parameters
from fjr_core.config.scenario import CONTROLLER
from fjr_core.errors import ParameterError
from fjr_core.files.text_file import read_text
from fjr_core.model.robot import Robot
from fjr_core.model.urdf_inertia import with_inertias
from fjr_core.model.urdf_parser import parse_xml
from fjr_core.numerics.checks import Array
from fjr_design.scaffold.files import path_from
from fjr_design.uncertainty.posterior import MATRICES, UNKNOWN, Identification
from fjr_identification.estimation.pseudo_inertia import corrected_bodies

GEAR_RATIO = "robot.gear_ratio"
CORRECTED = "robot.urdf"


@dataclass(frozen=True)
class NominalRobot:
    """Values joints and robot.* of a file, with absolute paths, the robot they describe, and which are guesses."""

    path: Path
    given: Mapping[str, object]
    joints: tuple[str, ...]
    robot: Robot
    guessed: Mapping[str, tuple[str, ...]]

    @property
    def name(self) -> str:
        """The name of the robot in its URDF, else of its file."""
        urdf = str(self.given.get(robot_file.URDF, ""))
        found = parse_xml(urdf if robot_file.is_xml(urdf) else read_text(Path(urdf))).get("name") if urdf else ""
        return found or self.path.stem.removesuffix("_robot")


def nominal_robot(path: Path) -> NominalRobot:
    """Return the robot of a robot file or scenario; raise ParameterError, which names the file."""
    document = ros_yaml.read(path, "robot file")
    try:
        merged = robot_file.merged(ros_yaml.values_for(CONTROLLER, document), CONTROLLER, path.parent)
        given = {
            name: value
            for name, value in merged.items()
            if name == "joints" or (name.startswith("robot.") and name != FILE.name)
        }
        known = robot_parameters(given)
        refuse_unknown([each.name for each in known], given)
        values = complete(known, given)
        robot = builders.robot(values)
    except ParameterError as error:
        raise ParameterError(f"{path}: {error}") from None
    return NominalRobot(path, given, names(values, "joints"), robot, guessed_joints(values))


def identified_values(nominal: NominalRobot, found: Identification, folder: Path) -> dict[str, object]:
    """Return joints and robot.* with the identified values, for a file in this folder.

    Motor inertias are reflected to the joint side.
    robot.guesses.* remain for guesses that the records do not tell.
    """
    changed: dict[str, object] = {
        name: value for name, value in nominal.given.items() if not name.startswith("robot.guesses.")
    }
    urdf = changed.get(robot_file.URDF)
    if corrected_urdf(nominal, found):
        changed[robot_file.URDF] = CORRECTED
    elif isinstance(urdf, str) and not robot_file.is_xml(urdf):
        changed[robot_file.URDF] = path_from(folder, Path(urdf))
    reflected = changed.pop(GEAR_RATIO, None) is not None
    for name, symbol in MATRICES.items():
        own = np.diag(getattr(nominal.robot, symbol))
        values = joint_values(found, name, nominal.joints, own)
        if not np.array_equal(values, own) or (reflected and name == "motor_inertia"):
            changed[f"robot.{name}"] = [significant(each) for each in values]
    for name in GUESSED:
        guesses = [_guess(nominal, found, changed, name, j) for j in range(len(nominal.joints))]
        if any(guesses):
            changed[GUESSES[name].name] = guesses
    return changed


def corrected_urdf(nominal: NominalRobot, found: Identification) -> str:
    """Return the text of the URDF with the identified masses and inertias of the links, "" if none is corrected."""
    bodies = corrected_bodies(nominal.robot.links, nominal.joints, found)
    return with_inertias(str(nominal.given[robot_file.URDF]), nominal.joints, bodies) if bodies else ""


def _guess(nominal: NominalRobot, found: Identification, changed: Mapping[str, object], name: str, j: int) -> float:
    """Return the value of a joint if it is still a guess, else 0."""
    joint = nominal.joints[j]
    if joint not in nominal.guessed.get(name, ()):
        return 0.0
    told = [each for each in found.estimates if (each.name, each.joint) == (name, joint) and each.verdict != UNKNOWN]
    if told:
        return 0.0
    values = np.asarray(changed[f"robot.{name}"], dtype=float)
    return float(
        values[j] if values.size == len(nominal.joints) else np.diag(values.reshape(len(nominal.joints), -1))[j]
    )


def joint_values(found: Identification, name: str, joints: tuple[str, ...], default: Array | float) -> Array:
    """Return a parameter of all joints (n,), the default where it was not estimated."""
    values = np.array(np.broadcast_to(default, len(joints)), dtype=float)
    for each in found.estimates:
        if each.name == name and each.joint in joints:
            values[joints.index(each.joint)] = each.value
    return values


def robot_of(values: Mapping[str, object]) -> Robot:
    """Return the robot that values joints and robot.* describe; raise ParameterError."""
    return builders.robot(complete(robot_parameters(values), values))


def significant(value: float) -> float:
    """Return a number with six significant digits."""
    return float(f"{value:.6g}")
