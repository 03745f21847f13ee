# SPDX-License-Identifier: Apache-2.0
"""The flexible-joint robot as a port-Hamiltonian system, eq. (36): dx = (J - R) dH/dx + G u."""

from __future__ import annotations

from functools import cached_property

import casadi as ca
from numpy.typing import ArrayLike

from ..errors import ParameterError
from ..numerics import symbolic
from ..numerics.checks import Array
from ..numerics.integrators import INTEGRATORS, LONGEST_COPIED, step
from ..numerics.jit import compiled
from ..numerics.symbolic import dense_function, evaluate
from . import springs
from .robot import Elastic, Robot, check_robot


def structure_expressions(robot: Elastic) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return J, R and G of eq. (36) as expressions, for numeric or symbolic robot parameters."""
    n = robot.n
    zero, one = ca.SX(2 * n, 2 * n), ca.SX.eye(2 * n)
    J = ca.blockcat([[zero, one], [-one, zero]])
    R = ca.diagcat(zero, symbolic.sparse(robot.D_l), symbolic.sparse(robot.D_m))
    G = ca.vertcat(ca.SX(3 * n, n), symbolic.sparse(robot.B_m))
    return J, R, G


def gradient_expression(robot: Elastic, x: ca.SX) -> ca.SX:
    """Return dH/dx (4n,); d/dq_l (p_l' M_l^-1 p_l / 2) = E_l dq_l = -d/dq_l (dq_l' M_l dq_l / 2), eq. (22)."""
    q_l, q_m, _, _ = ca.vertsplit(x, robot.n)
    dq_l, dq_m = robot.velocity_expressions(x)
    spring = springs.torque(robot, q_m - q_l)
    dH_dq_l = -robot.links.grad_T(q_l, dq_l) + robot.links.grad_P_l(q_l) - spring
    return ca.vertcat(dH_dq_l, spring, dq_l, dq_m)


def derivative_expression(robot: Elastic, x: ca.SX, u: ca.SX) -> ca.SX:
    """Return dx/dt (4n,) of eq. (36) as an expression."""
    J, R, G = structure_expressions(robot)
    return (J - R) @ gradient_expression(robot, x) + G @ u


class Plant:
    """The plant dx/dt = f(x, u), eq. (36), with its integrator, as pure functions of (x, u).

    integrator: "rk4" (explicit, order 4) or "implicit_midpoint" (order 2, no energy drift).
    compile: compile the step to machine code if a C compiler is available (numerics.jit).
    Units: positions rad, momenta N m s, effort u N m. Raises StateError for wrong shapes and
    ParameterError for an unknown integrator.
    in_python: True for a plant that is evaluated in Python and cannot be compiled.
    """

    in_python = False

    def __repr__(self) -> str:
        return f"Plant({self.robot!r}, integrator={self.integrator!r})"

    def __init__(self, robot: Robot, integrator: str = "rk4", compile: bool = False) -> None:
        check_robot(robot)
        if integrator not in INTEGRATORS:
            raise ParameterError(f"integrator is {integrator!r}; expected one of {', '.join(INTEGRATORS)}")
        self.robot = robot
        self.integrator = integrator
        self.compiles = compile

    def raise_failure(self) -> None:
        """Raise the error of an evaluation since the last call; only a plant in Python fails."""

    @cached_property
    def dynamics(self) -> ca.Function:
        """The CasADi function (x, u) -> dx; differentiable."""
        x, u = ca.SX.sym("x", 4 * self.robot.n), ca.SX.sym("u", self.robot.n)
        return dense_function("dynamics", {"x": x, "u": u}, {"dx": derivative_expression(self.robot, x, u)}, cse=True)

    @cached_property
    def step_function(self) -> ca.Function:
        """The CasADi function (x, u, dt) -> x_next; compiled if requested."""
        copied = not self.compiles or self.dynamics.n_instructions() <= LONGEST_COPIED
        return self.ready(step(self.integrator, self.dynamics, copied=copied))

    @cached_property
    def output_function(self) -> ca.Function:
        """The CasADi function (x, u) -> positions, velocities and torques (spring, applied), (2n,) each.

        Compiled if requested.
        """
        n, robot = self.robot.n, self.robot
        x, u = ca.SX.sym("x", 4 * n), ca.SX.sym("u", n)
        q_l, q_m, _, _ = ca.vertsplit(x, n)
        torques = ca.vertcat(springs.torque(robot, q_m - q_l), symbolic.sparse(robot.B_m) @ u)
        outputs = {"q": x[: 2 * n], "dq": ca.vertcat(*robot.velocity_expressions(x)), "torques": torques}
        return self.ready(dense_function("outputs", {"x": x, "u": u}, outputs))

    def ready(self, function: ca.Function) -> ca.Function:
        """Return the function, compiled if this plant is compiled."""
        return compiled(function) if self.compiles else function

    def derivative(self, x: ArrayLike, u: ArrayLike) -> Array:
        """Return dx/dt (4n,) at state x (4n,) and effort u (n,) [N m], eq. (36). Raises UserCodeError."""
        dx = evaluate(self.dynamics, x, u)[0]
        self.raise_failure()
        return dx

    def step(self, x: ArrayLike, u: ArrayLike, dt: float) -> Array:
        """Return the state (4n,) after one integrator step of dt [s] with u held."""
        return evaluate(self.step_function, x, u, dt)[0]

    def gradient(self, x: ArrayLike) -> Array:
        """Return dH/dx (4n,): (dH/dq_l, dH/dq_m, dq_l, dq_m)."""
        return evaluate(self._gradient, x)[0]

    def structure(self, x: ArrayLike | None = None) -> tuple[Array, Array, Array]:
        """Return J (4n, 4n) skew, R (4n, 4n) positive semidefinite and G (4n, n) of eq. (36); all are constant."""
        J, R, G = (ca.evalf(part).full() for part in structure_expressions(self.robot))
        return J, R, G

    @cached_property
    def _gradient(self) -> ca.Function:
        x = ca.SX.sym("x", 4 * self.robot.n)
        return dense_function("gradient", {"x": x}, {"dH": gradient_expression(self.robot, x)})
