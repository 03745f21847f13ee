# SPDX-License-Identifier: Apache-2.0
"""Values of the parameters of all robot models, without CasADi, and URDFs that show `closed_form_arms`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from .rigid_arm import Body

SINGLE_LINK: dict[str, Any] = {
    "stiffness": 31.0,  # N m/rad
    "link_inertia": 0.031,  # kg m^2, about the joint
    "gravity_torque": 0.8,  # N m
    "motor_inertia": 0.004,  # kg m^2
    "link_damping": 0.2,  # N m s/rad
    "motor_damping": 0.007,  # N m s/rad
    "input_gain": 1.0,
}
"""Joint of the paper, Table 1 with the stiffness of figure 1. The paper states no input gain."""
PLANAR_TWO_LINK: dict[str, Any] = {
    "stiffness": (40.0, 25.0),  # N m/rad
    "link_mass": (1.2, 0.8),  # kg
    "link_length": (0.3, 0.25),  # m
    "link_com": (0.15, 0.12),  # m, from the joint
    "link_inertia": (0.010, 0.005),  # kg m^2, about the centre of mass
    "gravity": 9.81,  # m/s^2
    "motor_inertia": (0.02, 0.01),  # kg m^2
    "link_damping": (0.2, 0.1),  # N m s/rad
    "motor_damping": (0.02, 0.01),  # N m s/rad
    "input_gain": 1.0,
}
"""An arm of our own choice."""
URDF_ARM: dict[str, Any] = {"gear_ratio": 1.0, "link_damping": 0.0, "motor_damping": 0.0, "input_gain": 1.0}
URDF_ARM |= {"gravity_vector": (0.0, 0.0, -9.81)}  # m/s^2, in the root link
"""What is taken of an arm of a URDF where nothing else is given; its motor inertia is reflected already."""
STANDARD_GRAVITY = 9.81
"""Gravity [m/s^2] on the payload of a model without a parameter for it."""
SMALLEST_LOAD = 1e-9
"""Smallest gravity torque [N m] of a body."""
WEIGHTLESS_LENGTH = 0.3
"""Length [m] of a single link without gravity in its URDF."""
COLOURS = {"light": "0.85 0.85 0.88 1", "dark": "0.30 0.33 0.38 1"}


def urdf_of_links(name: str, joints: Sequence[str], bodies: Sequence[Body], length: float = 0.0) -> str:
    """Return the URDF text of an arm in a vertical plane, which hangs along -z; bodies: one for each joint.

    Each joint axis is -y, so that a hanging link moves towards x for an increasing joint angle. length [m]: of the last
    link, 0: twice the distance of its centre of mass.
    """
    from html import escape  # loaded on use; that of xml.sax imports an HTTP client
    from xml.etree import ElementTree

    colours = (f'<material name="{each}"><color rgba="{rgba}"/></material>' for each, rgba in COLOURS.items())
    parts = [*colours, f'<link name="base_link">{_cylinder(0.02, 0.08, 0.0, "dark", across=True)}</link>']
    ends = [float(np.asarray(body.translation)[0]) for body in bodies[1:]]
    ends.append(length or 2 * float(np.asarray(bodies[-1].com)[0]) or WEIGHTLESS_LENGTH)
    parent, height = "base_link", 0.0
    for i, (joint, body, end) in enumerate(zip(joints, bodies, ends, strict=True), start=1):
        parts.append(
            f'<joint name="{escape(joint)}" type="continuous"><parent link="{parent}"/><child link="link{i}"/>'
            f'<origin xyz="0 0 {height!r}"/><axis xyz="0 -1 0"/></joint>'
            f'<link name="link{i}">{_inside(body, end)}</link>'
        )
        parent, height = f"link{i}", -end
    robot = ElementTree.fromstring(f'<robot name="{escape(name)}">{"".join(parts)}</robot>')
    ElementTree.indent(robot)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding="unicode") + "\n"


def _inside(body: Body, length: float) -> str:
    """Return inertia and looks of a link: a thin cylinder along it, and one across at its joint."""
    com, across = float(np.asarray(body.com)[0]), float(np.asarray(body.inertia)[2, 2])
    radius = min(0.02, abs(length) / 8)
    along = min(across, body.mass * radius**2 / 2)
    return (
        f'<inertial><origin xyz="0 0 {-com!r}"/><mass value="{body.mass!r}"/>'
        f'<inertia ixx="{across!r}" iyy="{across!r}" izz="{along!r}" ixy="0" ixz="0" iyz="0"/></inertial>'
        + _cylinder(radius, abs(length), -length / 2, "light")
        + _cylinder(1.4 * radius, 3 * radius, 0.0, "dark", across=True)
    )


def _cylinder(radius: float, length: float, z: float, colour: str, across: bool = False) -> str:
    return (
        f'<visual><origin xyz="0 0 {z!r}" rpy="{math.pi / 2 if across else 0.0!r} 0 0"/><geometry>'
        f'<cylinder radius="{radius!r}" length="{length!r}"/></geometry><material name="{colour}"/></visual>'
    )
