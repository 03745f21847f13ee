# SPDX-License-Identifier: Apache-2.0
"""Symbolic model of the rigid arm on the link side: inertia, potential, Coriolis terms."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import casadi as ca

from ..numerics.checks import Array
from ..numerics.one_line import joints
from ..numerics.symbolic import directional
from .rigid_body import Body


class RigidArm(Protocol):
    """Terms of the link side in eq. (36) as expressions: ArmDynamics, or ArmDynamics with a payload (robot.payload)."""

    def M_l(self, q_l: ca.SX) -> ca.SX:
        """Inertia M_l (n, n) [kg m^2]."""

    def P_l(self, q_l: ca.SX) -> ca.SX:
        """Potential energy P_l [J]."""

    def grad_P_l(self, q_l: ca.SX) -> ca.SX:
        """Gravity torque grad P_l (n,) [N m]."""

    def grad_T(self, q_l: ca.SX, v: ca.SX) -> ca.SX:
        """Kinetic-energy gradient d/dq_l (v' M_l v / 2) (n,) [N m], v constant."""


@dataclass(frozen=True)
class EndEffector:
    """Forward kinematics of the end-effector frame, which is fixed to the last link.

    position: (q_l, r) -> position (3,) [m] in the base frame of the point r (3,) [m] in the end-effector frame.
    gravity (3,) [m/s^2]: in the base frame.
    """

    position: ca.Function
    gravity: Array


@dataclass(frozen=True)
class ArmDynamics:
    """Rigid-arm model of n joints; the fields are CasADi functions of symbols or numbers.

    M_l: q_l -> inertia (n, n) [kg m^2];  P_l: q_l -> potential energy [J];  grad_P_l: q_l -> (n,) [N m].
    C: (q_l, v, w) -> C(q_l, v) w (n,), with the Christoffel symbols, so that dM_l - 2 C is skew-symmetric.
    inertial_torque: (q_l, v, w, a) -> M_l(q_l) a + C(q_l, v) w (n,), by one recursion where there is one.
    grad_T: (q_l, v) -> d/dq_l (v' M_l v / 2) (n,), v constant.
    M_l_vertices: matrices whose convex hull contains M_l(q_l) for every q_l, or None if unknown. A rate that holds at
    the vertices holds everywhere, because rates are convex in M_l.
    end_effector: end-effector frame for a payload, or None.
    bodies: of the serial chain from base to tip, with joint axes z; empty if unknown. order (n,): joint k of the robot
    is joint order[k] of the chain.
    """

    n: int
    M_l: ca.Function
    P_l: ca.Function
    grad_P_l: ca.Function
    C: ca.Function
    inertial_torque: ca.Function
    grad_T: ca.Function
    M_l_vertices: tuple[Array, ...] | None = None
    end_effector: EndEffector | None = None
    bodies: tuple[Body, ...] = ()
    order: tuple[int, ...] = ()

    def __repr__(self) -> str:
        return f"ArmDynamics({joints(self.n)})"

    @cached_property
    def dM(self) -> ca.Function:
        """(q_l, dq_l, w) -> (d/dt M_l) w (n,) along dq_l, w constant."""
        q_l, dq_l, w = (ca.SX.sym(name, self.n) for name in ("q_l", "dq_l", "w"))
        return ca.Function("dM", [q_l, dq_l, w], [directional(self.M_l(q_l) @ w, q_l, dq_l)])

    def E(self, q_l: ca.SX, dq_l: ca.SX, w: ca.SX) -> ca.SX:
        """Return the workless forces E_l w (n,), eq. (24): E_l = S_H - dM_l/2 = -C' = C - dM_l."""
        return self.C(q_l, dq_l, w) - self.dM(q_l, dq_l, w)


def closed_form(
    n: int,
    inertia: Callable[[ca.SX], ca.SX],
    potential: Callable[[ca.SX], ca.SX],
    vertices: tuple[Array, ...] | None = None,
    end_effector: EndEffector | None = None,
    bodies: Sequence[Body] = (),
) -> ArmDynamics:
    """Return the links of n joints from expressions of M_l(q_l) and P_l(q_l); the other terms by differentiation.

    bodies: of a serial chain with the same inertia, from base to tip.

    C_ij = sum_k (dM_ij/dq_k + dM_ik/dq_j - dM_jk/dq_i) v_k / 2  (Christoffel symbols of the first kind).
    """
    q_l, v, w, a = (ca.SX.sym(name, n) for name in ("q_l", "v", "w", "a"))
    M_l, P_l = inertia(q_l), potential(q_l)
    dM_w, dM_v = directional(M_l @ w, q_l, v), directional(M_l @ v, q_l, w)
    C_w = (dM_w + dM_v - ca.gradient(ca.dot(v, M_l @ w), q_l)) / 2
    return ArmDynamics(
        n=n,
        M_l=ca.Function("M_l", [q_l], [ca.densify(M_l)]),
        P_l=ca.Function("P_l", [q_l], [P_l]),
        grad_P_l=ca.Function("grad_P_l", [q_l], [ca.gradient(P_l, q_l)]),
        C=ca.Function("C", [q_l, v, w], [C_w]),
        inertial_torque=ca.Function("inertial_torque", [q_l, v, w, a], [M_l @ a + C_w]),
        grad_T=ca.Function("grad_T", [q_l, v], [ca.gradient(ca.dot(v, M_l @ v) / 2, q_l)]),
        M_l_vertices=vertices,
        end_effector=end_effector,
        bodies=tuple(bodies),
        order=tuple(range(n)),
    )
