# SPDX-License-Identifier: Apache-2.0
"""Inertia that a joint carries: the least that its spring may feel, and none where a URDF leaves it out."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..numerics.checks import Array
from .configuration_sampling import sample_configurations
from .robot import Robot

THINNEST = 1e-3  # m; least radius of gyration of real links about their joint; those of public URDFs have 13 mm or more
CONFIGURATIONS = 64


def least_free_inertia(M_l: ArrayLike) -> Array:
    """Return for each joint (n,) the least 1 / (M_l^-1)_ii [kg m^2] over link inertias (k, n, n)."""
    return np.asarray(1 / np.diagonal(np.linalg.inv(np.asarray(M_l)), axis1=1, axis2=2).max(axis=0))


def joints_without_inertia(robot: Robot) -> dict[int, str]:
    """Return a sentence for each revolute joint of a serial chain whose links have no inertia about it, by its number.

    Their radius of gyration is below THINNEST in some configuration: a URDF lacks the inertia, or has a placeholder.
    """
    if not robot.links.bodies:
        return {}
    M_l = np.array([robot.M_l(q_l) for q_l in sample_configurations(robot, CONFIGURATIONS)])
    inertia = np.diagonal(M_l, axis1=1, axis2=2).min(axis=0)
    slides, bodies = robot.prismatic or (False,) * robot.n, robot.links.bodies
    mass = [sum(body.mass for body in bodies[place:]) for place in robot.links.order]
    return {
        i: f"turns {mass[i]:.3g} kg with an inertia of {inertia[i]:.2g} kg m^2, which no real link has"
        for i in range(robot.n)
        if not slides[i] and inertia[i] < mass[i] * THINNEST**2
    }
