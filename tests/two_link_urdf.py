# SPDX-License-Identifier: Apache-2.0
"""The arm of fjr.planar_two_link() as a URDF that hangs straight down at zero, with an optional wrist to lock."""

from __future__ import annotations

JOINTS = ["shoulder", "elbow"]
STIFFNESS, MOTOR_INERTIA = [40.0, 25.0], [0.02, 0.01]
LINK_DAMPING, MOTOR_DAMPING = [0.2, 0.1], [0.02, 0.01]


def link(name: str, mass: float, com: float, inertia: float) -> str:
    return f"""<link name="{name}"><inertial><origin xyz="0 0 {-com}"/><mass value="{mass}"/>
    <inertia ixx="{inertia}" ixy="0" ixz="0" iyy="{inertia}" iyz="0" izz="{inertia}"/></inertial></link>"""


def joint(name: str, parent: str, child: str, height: float) -> str:
    return f"""<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>
    <origin xyz="0 0 {height}"/><axis xyz="0 1 0"/><limit lower="-3" upper="3" velocity="5" effort="30"/></joint>"""


def two_link_urdf(wrist_mass: float = 0.0) -> str:
    """Return the XML text; a wrist mass [kg] adds a third joint 'wrist' that carries it 0.1 m below."""
    wrist = link("hand", wrist_mass, 0.1, 1e-3) + joint("wrist", "lower", "hand", -0.25) if wrist_mass else ""
    return f"""<?xml version="1.0"?>
<robot name="two_link">
  <link name="world"/>
  {link("upper", 1.2, 0.15, 0.010)}
  {link("lower", 0.8, 0.12, 0.005)}
  {joint("shoulder", "world", "upper", 0.0)}
  {joint("elbow", "upper", "lower", -0.3)}
  {wrist}
</robot>
"""
