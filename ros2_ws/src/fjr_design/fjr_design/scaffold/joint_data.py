# SPDX-License-Identifier: Apache-2.0
"""Published stiffness and motor inertia of the joints of robots (config/joint_data.yaml), found by joint names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml
from ament_index_python.packages import get_package_share_directory

FILE = "config/joint_data.yaml"


@dataclass(frozen=True)
class JointData:
    """Published values of a robot by joint, and their source."""

    motor_inertia: dict[str, float]
    joint_stiffness: dict[str, float]
    source: str


def published(joints: Sequence[str]) -> JointData | None:
    """Return the data of the first robot that has all these joints; None if there is none."""
    path = Path(get_package_share_directory("fjr_bringup"), FILE)
    for entry in yaml.safe_load(path.read_text(encoding="utf-8")):
        if set(joints) <= set(entry["joints"]):
            inertia, stiffness = (_by_joint(entry, name) for name in ("motor_inertia", "joint_stiffness"))
            return JointData(inertia, stiffness, entry["source"])
    return None


def _by_joint(entry: dict[str, list[float]], name: str) -> dict[str, float]:
    return dict(zip(map(str, entry["joints"]), entry[name], strict=True)) if name in entry else {}
