# SPDX-License-Identifier: Apache-2.0
"""Corrections of the links' inertia that stay physically consistent: log-Cholesky parameters about the robot's own.

    P = L U U' L',  P_0 = L L',  U = e^alpha [[e^d1, s12, s13, t1], [0, e^d2, s23, t2], [0, 0, e^d3, t3], [0, 0, 0, 1]]

P is the pseudo-inertia of a link, positive definite for every theta, and P_0 that of the robot file, at theta = 0.
Gaussian theta are a prior that is free of units (C. Rucker, P. Wensing, IEEE RA-L 7(2), 2022).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from fjr_core.model.inertial_arm import InertialArm, pseudo_inertia
from fjr_core.model.rigid_arm import ArmDynamics
from fjr_core.model.rigid_body import Body
from fjr_core.numerics.checks import Array
from fjr_design.uncertainty.posterior import Identification

from .parameters import PSEUDO_INERTIA

LEAST = 1e-9  # of the trace; eigenvalue that is added to a link without extension, so that it has a factor
ENTRIES = ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))  # of s12, s23, s13, t1, t2, t3 in U


def correctable(links: ArmDynamics) -> bool:
    """Return whether the links consist of bodies in the order of the joints, as from a URDF, unlike a closed form."""
    return links.M_l_vertices is None and bool(links.bodies) and links.order == tuple(range(links.n))


def corrected_arm(links: ArmDynamics, theta: Sequence[Any]) -> InertialArm:
    """Return the links with expressions theta, ten for each link, as in PSEUDO_INERTIA."""
    assert links.end_effector is not None  # every serial chain has one
    inertias = [_corrected(body, each, ca.SX.eye(4), ca.exp) for body, each in zip(links.bodies, theta, strict=True)]
    return InertialArm(links.bodies, inertias, links.end_effector.gravity)


def corrected_body(body: Body, theta: Array) -> Body:
    """Return a body with the correction theta (10,)."""
    P = np.asarray(_corrected(body, theta, np.eye(4), np.exp))
    mass, com = float(P[3, 3]), P[:3, 3] / P[3, 3]
    second = P[:3, :3] - mass * np.outer(com, com)
    return replace(body, mass=mass, com=com, inertia=np.trace(second) * np.eye(3) - second)


def corrected_bodies(links: ArmDynamics, joints: Sequence[str], found: Identification) -> tuple[Body, ...]:
    """Return the bodies of the links with the identified corrections, () without any."""
    theta = np.zeros((links.n, len(PSEUDO_INERTIA)))
    for each in found.estimates:
        if each.name in PSEUDO_INERTIA:
            theta[joints.index(each.joint), PSEUDO_INERTIA.index(each.name)] = each.value
    if not np.any(theta):
        return ()
    return tuple(corrected_body(body, each) for body, each in zip(links.bodies, theta, strict=True))


def _corrected(body: Body, theta: Any, U: Any, exp: Any) -> Any:
    """Return P (4, 4); U: a unit matrix, which is filled."""
    P = pseudo_inertia(body)
    L = np.linalg.cholesky(P + LEAST * np.trace(P) * np.eye(4))
    for k in range(3):
        U[k, k] = exp(theta[1 + k])
    for k, (row, column) in enumerate(ENTRIES):
        U[row, column] = theta[4 + k]
    factor = L @ (exp(theta[0]) * U)
    return factor @ factor.T
