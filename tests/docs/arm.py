# SPDX-License-Identifier: Apache-2.0
"""my_arm.urdf, the example arm of the documents: three joints, a gripper and a fixed base."""

from __future__ import annotations

from two_link_urdf import link

JOINTS = {"shoulder": (0.0, "1 0 0"), "elbow": (-0.3, "0 1 0"), "wrist": (-0.25, "0 1 0"), "gripper": (-0.1, "0 0 1")}
LINKS = (("upper", 3.0, 0.15, 0.05), ("lower", 2.0, 0.12, 0.03), ("hand", 1.0, 0.05, 0.01), ("finger", 0.2, 0.02, 1e-3))


def my_arm_urdf() -> str:
    """Return the XML text."""
    parents = ["world", *(name for name, *_ in LINKS)]
    joints = [
        f"""<joint name="{name}" type="revolute"><parent link="{parents[k]}"/><child link="{parents[k + 1]}"/>
        <origin xyz="0 0 {height}"/><axis xyz="{axis}"/>
        <limit lower="-2.5" upper="2.5" velocity="5" effort="150"/></joint>"""
        for k, (name, (height, axis)) in enumerate(JOINTS.items())
    ]
    parts = [link(*each) for each in LINKS] + joints
    return '<?xml version="1.0"?>\n<robot name="my_arm"><link name="world"/>\n' + "\n".join(parts) + "\n</robot>\n"
