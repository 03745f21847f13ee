# SPDX-License-Identifier: Apache-2.0
"""The arms of `closed_form_arms` without CasADi: the values of their parameters, and URDFs that show them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

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
STANDARD_GRAVITY = 9.81
"""Gravity [m/s^2] on the payload of a model without a parameter for it."""
SMALLEST_LOAD = 1e-9
"""Smallest gravity torque [N m] that a URDF models."""
WEIGHTLESS_LENGTH = 0.3
"""Length [m] of a single link without gravity in its URDF."""
COLOURS = {"light": "0.85 0.85 0.88 1", "dark": "0.30 0.33 0.38 1"}


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
    from html import escape  # loaded on use; that of xml.sax imports an HTTP client
    from xml.etree import ElementTree

    colours = (f'<material name="{each}"><color rgba="{rgba}"/></material>' for each, rgba in COLOURS.items())
    parts = [*colours, f'<link name="base_link">{_cylinder(0.02, 0.08, 0.0, "dark", across=True)}</link>']
    parent, height = "base_link", 0.0
    for i, (joint, rod) in enumerate(zip(joints, rods, strict=True), start=1):
        parts.append(
            f'<joint name="{escape(joint)}" type="continuous"><parent link="{parent}"/><child link="link{i}"/>'
            f'<origin xyz="0 0 {height!r}"/><axis xyz="0 -1 0"/></joint>'
            f'<link name="link{i}">{_inside(rod)}</link>'
        )
        parent, height = f"link{i}", -rod.length
    robot = ElementTree.fromstring(f'<robot name="{escape(name)}">{"".join(parts)}</robot>')
    ElementTree.indent(robot)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding="unicode") + "\n"


def _inside(rod: Rod) -> str:
    """Return inertia and looks of a rod: a thin cylinder along it, and one across at its joint."""
    radius = min(0.02, abs(rod.length) / 8)
    across, along = rod.inertia, min(rod.inertia, rod.mass * radius**2 / 2)
    return (
        f'<inertial><origin xyz="0 0 {-rod.com!r}"/><mass value="{rod.mass!r}"/>'
        f'<inertia ixx="{across!r}" iyy="{across!r}" izz="{along!r}" ixy="0" ixz="0" iyz="0"/></inertial>'
        + _cylinder(radius, abs(rod.length), -rod.length / 2, "light")
        + _cylinder(1.4 * radius, 3 * radius, 0.0, "dark", across=True)
    )


def _cylinder(radius: float, length: float, z: float, colour: str, across: bool = False) -> str:
    return (
        f'<visual><origin xyz="0 0 {z!r}" rpy="{math.pi / 2 if across else 0.0!r} 0 0"/><geometry>'
        f'<cylinder radius="{radius!r}" length="{length!r}"/></geometry><material name="{colour}"/></visual>'
    )
