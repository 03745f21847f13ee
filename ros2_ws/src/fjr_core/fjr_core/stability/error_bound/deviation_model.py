# SPDX-License-Identifier: Apache-2.0
"""Equations of the deviation z of the robot from its ideal motion along a reference, with wrong parameters.

    z = (q_l - q_ld, zeta - zeta_d, dq_l - dq_ld, dq_m - dq_md),   zeta = q_m - q_l
    M_l(q_l) dz_3 = h(z) = (f_K K zeta - f_D D_l dq_l) / (p f_M) - C dq_l - f_g / f_M grad P_l - M_l(q_l) ddq_ld
    M_m dz_4      = (B_m u - f_K K zeta - f_Dm D_m dq_m) / f_Mm - M_m ddq_md

The ideal motion (index d) solves the equations of the model: u_d keeps the links on the reference. The factors of the
true robot are `FACTORS`; p multiplies inertia and weight of the links together. At z = 0, h is the torque error d_l of
the links along the reference, in which the terms of the model cancel; likewise d_m of the motors.
"""

from __future__ import annotations

from functools import cached_property

import casadi as ca
import numpy as np

from ...control.inverse_dynamics import spring_torque
from ...control.static_law import StaticLaw
from ...numerics.symbolic import directional, sparse
from ...trajectories.reference import JETS

FACTORS = (
    "payload",
    "link_inertia",
    "gravity",
    "stiffness",
    "motor_inertia",
    "link_damping",
    "motor_damping",
)
"""Factors of the true robot on the parameters of the model, 1 without an error."""
DERIVATIVES = JETS + 1
"""Columns of the arguments `jets` here: q_ld .. d5q_ld; the rate of the effort needs the fifth derivative."""


class DeviationModel:
    """CasADi functions of the deviation under a static law and its robot; n joints.

    Arguments: jets (n, 6) q_ld .. d5q_ld, z (4n,), f (7,) factors.
    """

    def __init__(self, law: StaticLaw) -> None:
        self.law, self.robot, self.n = law, law.robot, law.robot.n
        self._jets = ca.SX.sym("jets", self.n, DERIVATIVES)
        self._z, self._f = ca.SX.sym("z", 4 * self.n), ca.SX.sym("f", len(FACTORS))

    @cached_property
    def torque_errors(self) -> ca.Function:
        """(jets, f) -> torque errors d_l, d_m (n,) [N m] along the reference, rate of B_m u_d (n,) [N m/s]."""
        robot, (p, f_M, f_g, f_K, f_Mm, f_D, f_Dm) = self.robot, ca.vertsplit(self._f)
        q, dq, ddq = (self._jets[:, i] for i in range(3))
        inertial = robot.links.inertial_torque(q, dq, dq, ddq)
        friction, weight = sparse(robot.D_l) @ dq, robot.links.grad_P_l(q)
        d_l = (f_K / (p * f_M) - 1) * inertial + (f_K - f_D) / (p * f_M) * friction
        d_l += (f_K / p - f_g) / f_M * weight
        tau, _, dq_m, ddq_m, torque = self._ideal
        motors = (1 - f_Mm) * (sparse(robot.M_m) @ ddq_m) + (1 - f_Dm) * (sparse(robot.D_m) @ dq_m) + (1 - f_K) * tau
        return self._function("torque_errors", (self._jets, self._f), (d_l, motors / f_Mm, self._rate(torque)))

    @cached_property
    def link_slope(self) -> ca.Function:
        """(jets, z, f) -> dh/dz (n, 4n), M_l(q_l) (n, n)."""
        p, f_M, f_g, f_K, _, f_D, _ = ca.vertsplit(self._f)
        robot, (q_l, zeta, dq_l, _) = self.robot, self._moving
        spring, friction = f_K * (sparse(robot.K) @ zeta), f_D * (sparse(robot.D_l) @ dq_l)
        h = (spring - friction) / (p * f_M) - f_g / f_M * robot.links.grad_P_l(q_l)
        h -= robot.links.inertial_torque(q_l, dq_l, dq_l, self._jets[:, 2])
        results = ca.jacobian(h, self._z), robot.links.M_l(q_l)
        return self._function("link_slope", (self._jets, self._z, self._f), results)

    @cached_property
    def motor_slope(self) -> ca.Function:
        """(f) -> slope (n, 4n) of M_m dz_4 in z, and B_m / f_Mm (n, n)."""
        _, _, _, f_K, f_Mm, _, f_Dm = ca.vertsplit(self._f)
        zero = ca.SX(self.n, self.n)
        slope = ca.horzcat(zero, -f_K / f_Mm * self.robot.K, zero, -f_Dm / f_Mm * self.robot.D_m)
        return self._function("motor_slope", (self._f,), (slope, self.robot.B_m / f_Mm))

    @cached_property
    def law_slope(self) -> ca.Function:
        """(jets, z) -> du/dz (n, 4n) of the law."""
        q_l, zeta, dq_l, dq_m = self._moving
        position, velocity = ca.vertcat(q_l, q_l + zeta), ca.vertcat(dq_l, dq_m)
        jets, gains = self._jets[:, :JETS], ca.DM(self.law.gain_values)
        u, _ = self.law.measured_expression(position, velocity, jets, gains)
        return self._function("law_slope", (self._jets, self._z), (ca.jacobian(u, self._z),))

    @property
    def _moving(self) -> list[ca.SX]:
        """q_l, zeta, dq_l and dq_m (n,) at the deviation z."""
        tau, _, dq_m, _, _ = self._ideal
        zeta = ca.DM(np.linalg.inv(self.robot.K)) @ tau
        ideal = ca.vertcat(self._jets[:, 0], zeta, self._jets[:, 1], dq_m)
        return ca.vertsplit(ideal + self._z, self.n)

    @cached_property
    def _ideal(self) -> tuple[ca.SX, ...]:
        """Spring torque, motor position, velocity and acceleration, and motor torque B_m u_d along the reference."""
        robot, jets = self.robot, self._jets
        tau = spring_torque(robot, *(jets[:, i] for i in range(3)))
        q_m = jets[:, 0] + sparse(np.linalg.inv(robot.K)) @ tau
        dq_m = self._rate(q_m)
        ddq_m = self._rate(dq_m)
        torque = sparse(robot.M_m) @ ddq_m + sparse(robot.D_m) @ dq_m + tau
        return tau, q_m, dq_m, ddq_m, torque

    def _rate(self, e: ca.SX) -> ca.SX:
        """Return de/dt along the reference; e must not depend on d5q_ld."""
        return directional(e, ca.vec(self._jets[:, :-1]), ca.vec(self._jets[:, 1:]))

    @staticmethod
    def _function(name: str, arguments: tuple[ca.SX, ...], results: tuple[ca.SX, ...]) -> ca.Function:
        return ca.Function(name, list(arguments), [ca.densify(ca.SX(result)) for result in results], {"cse": True})
