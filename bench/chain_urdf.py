# SPDX-License-Identifier: Apache-2.0
"""Generate a URDF of a serial arm with any number of revolute joints in general position."""

from __future__ import annotations

import numpy as np

LINK = """<link name="link{i}"><inertial><origin xyz="{com}"/><mass value="2.0"/>
  <inertia ixx="0.03" iyy="0.025" izz="0.02" ixy="0.002" ixz="-0.001" iyz="0.003"/></inertial></link>
"""
JOINT = """<joint name="joint{i}" type="continuous"><origin xyz="{xyz}" rpy="{rpy}"/>
  <parent link="link{parent}"/><child link="link{i}"/><axis xyz="0 0 1"/></joint>
"""


def joint_names(n: int) -> list[str]:
    """Return the names of the n joints from base to tip."""
    return [f"joint{i}" for i in range(1, n + 1)]


def chain_urdf(n: int) -> str:
    """Return the URDF: no joint axes are parallel or intersect, so that no term of the dynamics vanishes."""
    random = np.random.default_rng(12)
    parts = ['<robot name="chain">\n<link name="link0"/>\n']
    for i in range(1, n + 1):
        com, xyz, rpy = (_text(random.uniform(-size, size, 3)) for size in (0.05, 0.2, 1.5))
        parts += [LINK.format(i=i, com=com), JOINT.format(i=i, parent=i - 1, xyz=xyz, rpy=rpy)]
    return "".join([*parts, "</robot>\n"])


def _text(vector: np.ndarray) -> str:
    return " ".join(f"{value:.4f}" for value in vector)
