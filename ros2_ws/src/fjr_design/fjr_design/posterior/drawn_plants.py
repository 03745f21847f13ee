# SPDX-License-Identifier: Apache-2.0
"""Draw plants from the posterior of an identification, with the correlations of its parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fjr_core.errors import ParameterError
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array

from ..stability.drawn_plants import DrawnPlants
from .result import UNKNOWN, Identification

LEAST = 1e-3  # of the robot's own value; smallest drawn stiffness and motor inertia
MATRICES = {"joint_stiffness": "K", "motor_inertia": "M_m", "link_damping": "D_l", "motor_damping": "D_m"}
"""Matrices of a robot whose diagonals are drawn, by the name of their parameter."""


def check_joints(found: Identification, joints: Sequence[str]) -> None:
    """Raise ParameterError unless the identification is of these joints."""
    if found.joints != tuple(joints):
        raise ParameterError(
            f"the identification is of joints {', '.join(found.joints)}; expected those of the scenario, "
            f"{', '.join(joints)}"
        )


def drawn_values(found: Identification, drawn: Array, name: str) -> dict[str, Array]:
    """Return the draws (k,) of a parameter by joint, from the draws (k, p) of all estimates."""
    return {each.joint: drawn[:, i] for i, each in enumerate(found.estimates) if each.name == name}


def drawn_plants(found: Identification, robot: Robot, count: int, seed: int, widened: float = 1.0) -> DrawnPlants:
    """Return `count` plants; what is not identified is as in the robot, which has the joints of the identification.

    widened: factor on the posterior's standard deviations. The delay of a plant is the largest of its joints.
    """
    wide = replace(found, covariance=widened**2 * found.covariance)
    drawn = wide.draws(count, seed)
    columns = {}
    for name, matrix in MATRICES.items():
        own = np.diag(getattr(robot, matrix))
        values = drawn_values(found, drawn, name)
        table = np.stack([values.get(joint, np.full(count, own[j])) for j, joint in enumerate(found.joints)], axis=1)
        columns[name] = np.maximum(table, LEAST * own if matrix in ("K", "M_m") else 0.0)
    delays = drawn_values(found, drawn, "effort_delay")
    delay = np.max(np.stack(list(delays.values())), axis=0) if delays else np.zeros(count)
    return DrawnPlants(
        columns["joint_stiffness"], columns["motor_inertia"], columns["link_damping"], columns["motor_damping"], delay
    )


def kept_at_prior(found: Identification, names: Sequence[str]) -> list[str]:
    """Return "parameter of joint" for those of these parameters that no draw changes, because they are unknown."""
    return [
        f"{each.name} of {each.joint}" if each.joint else each.name
        for each in found.estimates
        if each.verdict == UNKNOWN and each.name in names
    ]
