# SPDX-License-Identifier: Apache-2.0
"""The rigid arm on the link side: its bodies, its terms in eq. (36) as expressions, and a payload at its tip."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ..errors import RobotError
from ..numerics import checks
from ..numerics.checks import Array
from ..numerics.one_line import joints, one_line

EXACT = 1e-12  # tolerance: entries of rotations this close to 0, 1 or -1 are rounded


class RigidArm(Protocol):
    """Terms of the link side in eq. (36) as expressions: ArmDynamics, or ArmDynamics with a payload (PayloadArm)."""

    def M_l(self, q_l: ca.SX) -> ca.SX:
        """Inertia M_l (n, n) [kg m^2]."""

    def P_l(self, q_l: ca.SX) -> ca.SX:
        """Potential energy P_l [J]."""

    def grad_P_l(self, q_l: ca.SX) -> ca.SX:
        """Gravity torque grad P_l (n,) [N m]."""

    def grad_T(self, q_l: ca.SX, v: ca.SX) -> ca.SX:
        """Kinetic-energy gradient d/dq_l (v' M_l v / 2) (n,) [N m], v constant."""


@dataclass(frozen=True)
class ArmDynamics:
    """Rigid-arm model of n joints; the fields are CasADi functions of symbols or numbers.

    M_l: q_l -> inertia (n, n) [kg m^2];  P_l: q_l -> potential energy [J];  grad_P_l: q_l -> (n,) [N m].
    inertial_torque: (q_l, v, w, a) -> M_l(q_l) a + C(q_l, v) w (n,), by one recursion where there is one, with the
    Christoffel symbols, so that dM_l - 2 C is skew-symmetric.
    grad_T: (q_l, v) -> d/dq_l (v' M_l v / 2) (n,), v constant.
    M_l_vertices: matrices whose convex hull contains M_l(q_l) for every q_l, or None if unknown. A rate that holds at
    the vertices holds everywhere, because its condition D_l + K_ld - beta M_l >= 0 is linear in M_l.
    end_effector: end-effector frame for a payload, or None.
    bodies: of the serial chain from base to tip, with joint axes z; empty if unknown. order (n,): joint k of the robot
    is joint order[k] of the chain.
    """

    n: int
    M_l: ca.Function
    P_l: ca.Function
    grad_P_l: ca.Function
    inertial_torque: ca.Function
    grad_T: ca.Function
    M_l_vertices: tuple[Array, ...] | None = None
    end_effector: EndEffector | None = None
    bodies: tuple[Body, ...] = ()
    order: tuple[int, ...] = ()

    def __repr__(self) -> str:
        return f"ArmDynamics({joints(self.n)})"

    def C(self, q_l: ca.SX, v: ca.SX, w: ca.SX) -> ca.SX:
        """Return the Coriolis product C(q_l, v) w (n,)."""
        return self.inertial_torque(q_l, v, w, 0)

    @cached_property
    def dM(self) -> ca.Function:
        """(q_l, dq_l, w) -> (d/dt M_l) w (n,) along dq_l, w constant."""
        q_l, dq_l, w = (ca.SX.sym(name, self.n) for name in ("q_l", "dq_l", "w"))
        return ca.Function("dM", [q_l, dq_l, w], [ca.jtimes(self.M_l(q_l) @ w, q_l, dq_l)])

    def E(self, q_l: ca.SX, dq_l: ca.SX, w: ca.SX) -> ca.SX:
        """Return the workless forces E_l w (n,), eq. (24): E_l = S_H - dM_l/2 = -C' = C - dM_l."""
        return self.C(q_l, dq_l, w) - self.dM(q_l, dq_l, w)


@dataclass(frozen=True)
class EndEffector:
    """Forward kinematics of the end-effector frame, which is fixed to the last link.

    position: (q_l, r) -> position (3,) [m] in the base frame of the point r (3,) [m] in the end-effector frame.
    gravity (3,) [m/s^2]: in the base frame.
    """

    position: ca.Function
    gravity: Array


def tip_frame(links: ArmDynamics) -> tuple[Array, Array]:
    """Return rotation (3, 3) and origin (3,) [m] of the end-effector frame in the frame of the last body."""
    R, r, tip = np.eye(3), np.zeros(3), links.end_effector
    assert tip is not None  # of links with bodies
    for body in links.bodies:
        R, r = R @ np.asarray(body.rotation), r + R @ np.asarray(body.translation)
    points = [tip.position(np.zeros(links.n), point).full().ravel() for point in np.vstack([np.zeros(3), np.eye(3)])]
    return R.T @ (np.array(points[1:]) - points[0]).T, R.T @ (points[0] - r)


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
    dM_w, dM_v = ca.jtimes(M_l @ w, q_l, v), ca.jtimes(M_l @ v, q_l, w)
    C_w = (dM_w + dM_v - ca.gradient(ca.dot(v, M_l @ w), q_l)) / 2
    return ArmDynamics(
        n=n,
        M_l=ca.Function("M_l", [q_l], [ca.densify(M_l)]),
        P_l=ca.Function("P_l", [q_l], [P_l]),
        grad_P_l=ca.Function("grad_P_l", [q_l], [ca.gradient(P_l, q_l)]),
        inertial_torque=ca.Function("inertial_torque", [q_l, v, w, a], [M_l @ a + C_w]),
        grad_T=ca.Function("grad_T", [q_l, v], [ca.gradient(ca.dot(v, M_l @ v) / 2, q_l)]),
        M_l_vertices=vertices,
        end_effector=end_effector,
        bodies=tuple(bodies),
        order=tuple(range(n)),
    )


@dataclass(frozen=True)
class Body:
    """A joint and the rigid body it moves; lengths [m], masses [kg], inertias [kg m^2].

    rotation (3, 3), translation (3,): pose of the joint frame in the parent body frame at q = 0. axis (3,): joint axis
    in the joint frame. prismatic: the joint slides along the axis. mass, com (3,) and inertia (3, 3) about the centre
    of mass: of the body, in the joint frame.
    Raises RobotError for physically impossible numbers.
    """

    rotation: ArrayLike
    translation: ArrayLike
    axis: ArrayLike
    mass: float
    com: ArrayLike
    inertia: ArrayLike
    prismatic: bool = False

    __repr__ = one_line

    def __post_init__(self) -> None:
        for name in ("translation", "axis", "com"):
            object.__setattr__(self, name, checks.vector(name, getattr(self, name), 3, RobotError))
        for name in ("rotation", "inertia"):
            object.__setattr__(self, name, checks.matrix(name, getattr(self, name), 3, RobotError))
        checks.positive_semidefinite("inertia", np.asarray(self.inertia), RobotError)
        object.__setattr__(self, "mass", checks.positive("mass", self.mass, RobotError, "kg", zero=True))
        if not np.linalg.norm(np.asarray(self.axis)) > 0:
            raise RobotError("axis is zero; expected a direction")
        R = np.asarray(self.rotation)
        if not (np.allclose(R @ R.T, np.eye(3), atol=1e-9) and np.linalg.det(R) > 0):
            raise RobotError(f"rotation is {R.tolist()}; expected a rotation matrix")


def z_aligned(bodies: Sequence[Body]) -> list[Body]:
    """Return the chain with body frames rotated so that every joint axis is z; round nearly exact rotations."""
    aligned, previous = [], np.eye(3)
    for body in bodies:
        turn = rotation_to(np.asarray(body.axis))
        rotation = previous.T @ np.asarray(body.rotation) @ turn
        nearest = np.round(rotation)
        aligned.append(
            replace(
                body,
                rotation=np.where(np.abs(rotation - nearest) < EXACT, nearest, rotation),
                translation=previous.T @ np.asarray(body.translation),
                axis=(0.0, 0.0, 1.0),
                com=turn.T @ np.asarray(body.com),
                inertia=turn.T @ np.asarray(body.inertia) @ turn,
            )
        )
        previous = turn
    return aligned


def rotation_to(axis: Array) -> Array:
    """Return a rotation whose third column is the axis; a permutation matrix for a coordinate axis."""
    z = axis / np.linalg.norm(axis)
    x = np.roll(np.eye(3)[np.argmax(np.abs(z))], 1)
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


@dataclass(frozen=True)
class PayloadArm:
    """A rigid arm with a point mass [kg] at `position` (3,) [m] in the end-effector frame, both expressions.

    With the point at p(q_l) and J = dp/dq_l, the mass m adds m J'J to M_l and -m g'p to P_l.
    """

    links: RigidArm
    end_effector: EndEffector
    mass: ca.SX
    position: ca.SX

    def M_l(self, q_l: ca.SX) -> ca.SX:
        """Inertia M_l (n, n) [kg m^2] with the payload."""
        J = self._jacobian(q_l, self.position)
        return self.links.M_l(q_l) + self.mass * (J.T @ J)

    def P_l(self, q_l: ca.SX) -> ca.SX:
        """Potential energy P_l [J] with the payload."""
        weight = self.mass * ca.dot(self.end_effector.gravity, self.end_effector.position(q_l, self.position))
        return self.links.P_l(q_l) - weight

    def grad_P_l(self, q_l: ca.SX) -> ca.SX:
        """Gravity torque grad P_l (n,) [N m] with the payload."""
        J = self._jacobian(q_l, self.position)
        return self.links.grad_P_l(q_l) - self.mass * (J.T @ self.end_effector.gravity)

    def grad_T(self, q_l: ca.SX, v: ca.SX) -> ca.SX:
        """d/dq_l (v' M_l v / 2) (n,) [N m] with the payload, v constant."""
        return self.links.grad_T(q_l, v) + self.mass * self._point_grad_T(q_l, v, self.position)

    def inertial_torque_of_mass(self, q_l: ca.SX, v: ca.SX, a: ca.SX) -> ca.SX:
        """Part of the payload in M_l a + C v (n,) [N m]: m J' times the acceleration J a + (d^2 p / dq_l^2)(v, v)."""
        point, J = self.end_effector.position(q_l, self.position), self._jacobian(q_l, self.position)
        return self.mass * (J.T @ (J @ a + ca.jtimes(ca.jtimes(point, q_l, v), q_l, v)))

    @cached_property
    def _jacobian(self) -> ca.Function:
        """(q_l, r) -> dp/dq_l (3, n)."""
        q_l, r = self.end_effector.position.sx_in()
        return ca.Function("jacobian", [q_l, r], [ca.jacobian(self.end_effector.position(q_l, r), q_l)])

    @cached_property
    def _point_grad_T(self) -> ca.Function:
        """(q_l, v, r) -> d/dq_l (|dp|^2 / 2) (n,), dp = J v."""
        q_l, r = self.end_effector.position.sx_in()
        v = ca.SX.sym("v", q_l.numel())
        dp = ca.jtimes(self.end_effector.position(q_l, r), q_l, v)
        return ca.Function("point_grad_T", [q_l, v, r], [ca.gradient(ca.dot(dp, dp) / 2, q_l)])
