# SPDX-License-Identifier: Apache-2.0
"""Add a point mass to the last link; every term of the rigid arm is affine in this mass."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from .rigid_arm import EndEffector, RigidArm


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
