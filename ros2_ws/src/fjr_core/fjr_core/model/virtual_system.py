# SPDX-License-Identifier: Apache-2.0
"""Virtual control system of the robot, eqs. (25)-(28) and (38), and its variational system."""

from __future__ import annotations

from functools import cached_property

import casadi as ca
from numpy.typing import ArrayLike

from ..numerics import symbolic
from ..numerics.checks import Array
from ..numerics.symbolic import dense_function, evaluate
from . import springs
from .robot import Robot, check_robot


def derivative_expression(robot: Robot, x_v: ca.SX, x: ca.SX, u: ca.SX) -> ca.SX:
    """Return dx_v/dt (4n,) of eq. (38) as an expression; M_l, E_l and D at the measured x, P_l and spring at x_v."""
    links = robot.links
    q_l = x[: robot.n]
    q_lv, q_mv, _, _ = ca.vertsplit(x_v, robot.n)
    dq_l = robot.velocity_expressions(x)[0]
    dq_lv, dq_mv = velocities(robot, x_v, x)
    spring = springs.torque(robot, q_mv - q_lv)
    dp_lv = -(links.grad_P_l(q_lv) - spring) - links.E(q_l, dq_l, dq_lv) - robot.D_l @ dq_lv
    dp_mv = -spring - robot.D_m @ dq_mv + robot.B_m @ u
    return ca.vertcat(dq_lv, dq_mv, dp_lv, dp_mv)


def velocities(robot: Robot, x_v: ca.SX, x: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return (dq_lv, dq_mv) = (M_l(q_l)^-1 p_lv, M_m^-1 p_mv), eq. (27), with the inertia at the measured q_l."""
    return robot.velocity_expressions(ca.vertcat(x[: robot.n], x_v[robot.n :]))


class VirtualSystem:
    """The virtual control system Gamma(x_v, x, u) of a robot and its variational system.

    Gamma(x, x, u) is the time derivative of the plant state. Raises StateError for wrong shapes.
    """

    def __repr__(self) -> str:
        return f"VirtualSystem({self.robot!r})"

    def __init__(self, robot: Robot) -> None:
        check_robot(robot)
        self.robot = robot

    def derivative(self, x_v: ArrayLike, x: ArrayLike, u: ArrayLike) -> Array:
        """Return dx_v/dt (4n,), eq. (38), at the virtual state x_v, the measured state x (4n,) and effort u (n,)."""
        return evaluate(self._derivative, x_v, x, u)[0]

    def variational(self, x_v: ArrayLike, x: ArrayLike, delta_x_v: ArrayLike, delta_u: ArrayLike) -> Array:
        """Return d(delta x_v)/dt (4n,), eq. (28), for variations delta_x_v (4n,) and delta_u (n,)."""
        return evaluate(self._variational, x_v, x, delta_x_v, delta_u)[0]

    def _symbols(self) -> dict[str, ca.SX]:
        return symbolic.symbols(x_v=4 * self.robot.n, x=4 * self.robot.n, u=self.robot.n)

    @cached_property
    def _derivative(self) -> ca.Function:
        symbols = self._symbols()
        return dense_function("virtual", symbols, {"dx_v": derivative_expression(self.robot, **symbols)})

    @cached_property
    def _variational(self) -> ca.Function:
        symbols = self._symbols()
        x_v, x, u = symbols.values()
        dx_v = derivative_expression(self.robot, **symbols)
        deltas = symbolic.symbols(delta_x_v=x_v.numel(), delta_u=u.numel())
        variation = ca.jtimes(dx_v, ca.vertcat(x_v, u), ca.vertcat(*deltas.values()))
        return dense_function("variational", {"x_v": x_v, "x": x, **deltas}, {"d_delta_x_v": variation})
