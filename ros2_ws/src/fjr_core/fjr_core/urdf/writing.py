# SPDX-License-Identifier: Apache-2.0
"""Write the URDF of a closed-form robot as a chain of rods."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

from ..model.closed_form_arms import STANDARD_GRAVITY

SMALLEST_LOAD = 1e-9  # N m, smallest gravity torque that is modelled
WEIGHTLESS_LENGTH = 0.3  # m, of a single link without gravity
LIGHT, DARK = "0.85 0.85 0.88 1", "0.30 0.33 0.38 1"


@dataclass(frozen=True)
class Rod:
    """A link of an arm in a vertical plane: mass [kg], length and centre of mass [m] along -z from its joint.

    inertia [kg m^2] about the centre of mass, in the plane. A negative length points up.
    """

    mass: float
    length: float
    com: float
    inertia: float


def hanging_rod(inertia: float, load: float) -> Rod:
    """Return a uniform rod with inertia [kg m^2] about its joint and m g com = load [N m]: inertia = 4/3 m com^2.

    For a zero load the centre of mass is at the joint.
    """
    if abs(load) < SMALLEST_LOAD:
        return Rod(12 * inertia / WEIGHTLESS_LENGTH**2, WEIGHTLESS_LENGTH, 0.0, inertia)
    com = 0.75 * inertia * STANDARD_GRAVITY / load
    return Rod(abs(load) / (STANDARD_GRAVITY * abs(com)), 2 * com, com, inertia / 4)


def urdf_of_rods(name: str, joints: Sequence[str], rods: Sequence[Rod]) -> str:
    """Return the URDF text of a chain of rods in a vertical plane, one for each joint.

    Each joint axis is -y, so that a hanging link moves towards x for an increasing joint angle.
    """
    robot = ElementTree.Element("robot", name=name)
    for colour, rgba in (("light", LIGHT), ("dark", DARK)):
        ElementTree.SubElement(ElementTree.SubElement(robot, "material", name=colour), "color", rgba=rgba)
    base = ElementTree.SubElement(robot, "link", name="base_link")
    _cylinder(base, 0.02, 0.08, "0 0 0", "dark", across=True)
    parent, height = "base_link", 0.0
    for i, (joint, rod) in enumerate(zip(joints, rods, strict=True), start=1):
        _joint(robot, joint, parent, f"link{i}", height)
        _link(ElementTree.SubElement(robot, "link", name=f"link{i}"), rod)
        parent, height = f"link{i}", -rod.length
    ElementTree.indent(robot)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding="unicode") + "\n"


def _joint(robot: ElementTree.Element, name: str, parent: str, child: str, height: float) -> None:
    joint = ElementTree.SubElement(robot, "joint", name=name, type="continuous")
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    ElementTree.SubElement(joint, "origin", xyz=f"0 0 {height!r}")
    ElementTree.SubElement(joint, "axis", xyz="0 -1 0")


def _link(link: ElementTree.Element, rod: Rod) -> None:
    radius = min(0.02, abs(rod.length) / 8)
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=f"0 0 {-rod.com!r}")
    ElementTree.SubElement(inertial, "mass", value=repr(rod.mass))
    across, along = repr(rod.inertia), repr(min(rod.inertia, rod.mass * radius**2 / 2))
    moments = {"ixx": across, "iyy": across, "izz": along, "ixy": "0", "ixz": "0", "iyz": "0"}
    ElementTree.SubElement(inertial, "inertia", moments)
    _cylinder(link, radius, abs(rod.length), f"0 0 {-rod.length / 2!r}", "light")
    _cylinder(link, 1.4 * radius, 3 * radius, "0 0 0", "dark", across=True)


def _cylinder(
    link: ElementTree.Element, radius: float, length: float, xyz: str, colour: str, across: bool = False
) -> None:
    visual = ElementTree.SubElement(link, "visual")
    ElementTree.SubElement(visual, "origin", xyz=xyz, rpy=f"{math.pi / 2 if across else 0.0!r} 0 0")
    geometry = ElementTree.SubElement(visual, "geometry")
    ElementTree.SubElement(geometry, "cylinder", radius=repr(radius), length=repr(length))
    ElementTree.SubElement(visual, "material", name=colour)
