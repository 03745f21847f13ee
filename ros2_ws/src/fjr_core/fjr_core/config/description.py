# SPDX-License-Identifier: Apache-2.0
"""URDF of the robot of a node's parameters: the given file, or a generated one for a closed-form robot."""

from __future__ import annotations

from ..urdf.tree import parse_xml
from ..urdf.writing import Rod, hanging_rod, urdf_of_rods
from . import robot_file
from .parameter import Values, names, vector
from .robot import MODEL


def description(values: Values) -> str:
    """Return the URDF text of the robot of the values; raises ParameterError if the URDF cannot be read.

    A closed-form robot hangs along -z in the x-z plane; the URDF holds its geometry and inertia, not its gravity.
    """
    if values[MODEL.name] == "urdf":
        return str(robot_file.inlined(values)["robot.urdf"])
    build = {"single_link": _single_link, "planar_two_link": _planar_two_link}[str(values[MODEL.name])]
    return urdf_of_rods(str(values[MODEL.name]), names(values, "joints"), build(values))


def locked_positions(values: Values) -> dict[str, float]:
    """Return the positions [rad, m] of the locked joints of the URDF by name; all other joints are locked at 0."""
    if values[MODEL.name] != "urdf":
        return {}
    positions = vector(values, "robot.locked_positions", len(names(values, "robot.locked_joints")))
    locked = zip(names(values, "robot.locked_joints"), positions, strict=True)
    return {name: float(position) for name, position in locked if name}


def robot_name(values: Values) -> str:
    """Return the name of the robot in its URDF."""
    return str(parse_xml(description(values)).get("name", ""))


def _single_link(values: Values) -> list[Rod]:
    inertia, load = (float(vector(values, f"robot.{name}", 1)[0]) for name in ("link_inertia", "gravity_torque"))
    return [hanging_rod(inertia, load)]


def _planar_two_link(values: Values) -> list[Rod]:
    columns = (vector(values, f"robot.link_{name}", 2) for name in ("mass", "length", "com", "inertia"))
    return [Rod(*map(float, row)) for row in zip(*columns, strict=True)]
