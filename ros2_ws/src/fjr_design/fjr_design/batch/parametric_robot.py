# SPDX-License-Identifier: Apache-2.0
"""Robot whose parameters are arguments: the drawn parameters of a run enter as one vector.

Factors f scale a matrix from both sides, S M S with S = diag(sqrt f): it stays symmetric positive definite, the entries
of a diagonal matrix are multiplied by f, and one factor for all joints multiplies the matrix. For the inertia of the
links, M_l(q_l) -> S M_l(q_l) S; the kinetic energy of v is then that of S v, from which all other terms follow.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from types import SimpleNamespace

import casadi as ca
import numpy as np

from fjr_core.errors import ParameterError
from fjr_core.model import springs
from fjr_core.model.port_hamiltonian import Plant, derivative_expression, gradient_expression
from fjr_core.model.rigid_arm import ArmDynamics, PayloadArm, RigidArm
from fjr_core.model.robot import Robot
from fjr_core.numerics import integrators, symbolic
from fjr_core.numerics.checks import Array
from fjr_core.numerics.symbolic import PackedVector, dense_function
from fjr_core.simulation.nonideal_plant import friction, hysteresis

from .draws import PARAMETERS

SCALED = tuple(each.name for each in PARAMETERS.values() if each.is_factor)
ROOTS = tuple(name for name in SCALED if name != "gravity")
"""Factors that enter as their square roots."""
FRICTION = ("coulomb_l", "coulomb_m")
FULL = (*FRICTION, "cubic", "hysteresis", "payload_mass")
"""Levels of which one is not 0 only in runs of the full plant."""
NAMES = (*SCALED, *FULL, "smoothing", "external", "slip", "payload_position")
"""Parts of the argument `parameters` of all functions here, in this order."""


def layout(n: int) -> PackedVector:
    """Return the parts of the argument `parameters` for n joints."""
    return PackedVector({name: PARAMETERS[name].width(n) for name in NAMES})


@dataclass(frozen=True)
class ScaledLinks:
    """Links with square roots of factors (n,) on their inertia and factors (n,) on their gravity torques."""

    links: ArmDynamics
    root: ca.SX
    gravity: ca.SX

    def M_l(self, q_l: ca.SX) -> ca.SX:
        """Inertia S M_l S (n, n)."""
        return _both_sides(self.root, self.links.M_l(q_l))

    def P_l(self, q_l: ca.SX) -> ca.SX:
        """Potential energy, valid if all joints have the same factor; otherwise no potential exists."""
        return self.gravity[0] * self.links.P_l(q_l)

    def grad_P_l(self, q_l: ca.SX) -> ca.SX:
        """Gravity torques (n,)."""
        return self.gravity * self.links.grad_P_l(q_l)

    def grad_T(self, q_l: ca.SX, v: ca.SX) -> ca.SX:
        """d/dq_l (v' S M_l S v / 2) (n,), v held."""
        return self.links.grad_T(q_l, self.root * v)


@dataclass(frozen=True)
class ScaledRobot:
    """Robot with the drawn parameters in place of its own, as expressions."""

    n: int
    links: RigidArm
    K: ca.SX
    curves: tuple[springs.CubicCurve | springs.TorsionCurve, ...]
    D_l: ca.SX
    D_m: ca.SX
    B_m: ca.SX
    M_m_inverse: ca.SX

    def velocity_expressions(self, x: ca.SX, links: RigidArm | None = None) -> tuple[ca.SX, ca.SX]:
        """(dq_l, dq_m) = (M_l^-1 p_l, S^-1 M_m^-1 S^-1 p_m)."""
        q_l, _, p_l, p_m = symbolic.blocks(x, self.n)
        return symbolic.solve((links or self.links).M_l(q_l), p_l), self.M_m_inverse @ p_m


def _both_sides(root: ca.SX, matrix: ca.SX) -> ca.SX:
    """Return S A S with the entries r_i A_ij r_j."""
    return matrix * (root @ root.T)


class ParametricPlant:
    """Eq. (36) with drawn parameters as CasADi functions of (.., parameters), from which C can be generated.

    full: false leaves the levels of FULL out and makes a step cheaper. own: a plant in Python, whose parameters are not
    drawn (see `refuse`), with drawn friction, hysteresis and external torques. Momenta are those of the drawn inertia.
    The sliders of hysteresis (n,) [rad] follow x (4n,) in the state, as in nonideal_plant.
    """

    def __init__(self, robot: Robot, full: bool, own: Plant | None = None) -> None:
        self.robot, self._full, self._own = robot, full, own
        self._kind = ca.SX if own is None else ca.MX

    @cached_property
    def dynamics(self) -> ca.Function:
        """Return the function (x, inputs) -> dx/dt (4n,); inputs: effort u and sliders (n,) each, parameters."""
        n = self.robot.n
        s = symbolic.symbols(self._kind, x=4 * n, inputs=2 * n + layout(n).size)
        x, inputs = s.values()
        u, sliders, parameters = ca.vertsplit(inputs, [0, n, 2 * n, inputs.numel()])
        dx, dq_l, dq_m = self._motion(x, u, parameters)
        p = layout(n).named(parameters)
        links, motors = p.external, ca.DM(n, 1)
        if self._full or self._own:
            links -= friction(dq_l, p.coulomb_l, p.coulomb_l, ca.DM(1), p.smoothing)
            motors = -friction(dq_m, p.coulomb_m, p.coulomb_m, ca.DM(1), p.smoothing)
            element = hysteresis(x[n : 2 * n] - x[:n], sliders, p)
            links, motors = links + element, motors - element
        dx += ca.vertcat(ca.DM(2 * n, 1), links, motors)
        return dense_function("parametric_dynamics", s, {"dx": dx}, cse=self._own is None)

    def _motion(self, x: ca.SX, u: ca.SX, parameters: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return dx/dt (4n,) without friction and external torques, and the velocities dq_l, dq_m (n,)."""
        n = self.robot.n
        if self._own:
            return self._own.dynamics(x, u), *ca.vertsplit(self.robot.to_velocity(x), n)
        p, robot = self._drawn(parameters)
        dH = gradient_expression(robot, x, cubic=p.cubic if self._full else None)
        _, _, dq_l, dq_m = symbolic.blocks(dH, n)
        return derivative_expression(robot, x, u, dH), dq_l, dq_m

    def step(self, name: str) -> ca.Function:
        """Return the function (state, u, parameters, dt) -> state (5n,), a Runge-Kutta step of order 4 with u held."""
        n = self.robot.n
        s = symbolic.symbols(self._kind, state=5 * n, u=n, parameters=layout(n).size, dt=1)
        state, u, parameters, dt = s.values()
        x, sliders = ca.vertsplit(state, [0, 4 * n, 5 * n])
        x_next = integrators.rk4_expression(self.dynamics, x, (ca.vertcat(u, sliders, parameters),) * 3, dt)
        if self._full:
            zeta, slip = x_next[n : 2 * n] - x_next[:n], layout(n).named(parameters).slip
            sliders = ca.fmin(ca.fmax(sliders, zeta - slip), zeta + slip)
        return dense_function(name, s, {"next": ca.vertcat(x_next, sliders)}, cse=self._own is None)

    def velocity(self, name: str) -> ca.Function:
        """Return the function (x, parameters) -> (dq_l, dq_m) (2n,)."""
        n = self.robot.n
        s = symbolic.symbols(x=4 * n, parameters=layout(n).size)
        x, parameters = s.values()
        _, robot = self._drawn(parameters)
        velocity = ca.vertcat(*robot.velocity_expressions(x))
        return dense_function(name, s, {"velocity": velocity}, cse=True)

    def state(self, name: str) -> ca.Function:
        """Return the function (position (2n,), velocity (2n,), parameters) -> x (4n,)."""
        n = self.robot.n
        s = symbolic.symbols(position=2 * n, velocity=2 * n, parameters=layout(n).size)
        position, velocity, parameters = s.values()
        p, robot = self._drawn(parameters)
        p_l = robot.links.M_l(position[:n]) @ velocity[:n]
        p_m = p.motor_inertia * (symbolic.sparse(self.robot.M_m) @ (p.motor_inertia * velocity[n:]))
        return dense_function(name, s, {"x": ca.vertcat(position, p_l, p_m)})

    def torque(self, name: str) -> ca.Function:
        """Return the function (position with sliders (3n,), parameters) -> torque of the springs (n,)."""
        n = self.robot.n
        s = symbolic.symbols(position=3 * n, parameters=layout(n).size)
        position, parameters = s.values()
        p, robot = self._drawn(parameters)
        zeta = position[n : 2 * n] - position[:n]
        torque = springs.torque(robot, zeta, p.cubic if self._full else None)
        torque += hysteresis(zeta, position[2 * n :], p) if self._full else 0
        return dense_function(name, s, {"torque": torque})

    def _drawn(self, parameters: ca.SX) -> tuple[SimpleNamespace, ScaledRobot]:
        own, p = self.robot, layout(self.robot.n).named(parameters)
        links: RigidArm = ScaledLinks(own.links, p.link_inertia, p.gravity)
        if self._full and self._own is None and own.links.end_effector is not None:
            links = PayloadArm(links, own.links.end_effector, p.payload_mass, p.payload_position)
        return p, ScaledRobot(
            n=own.n,
            links=links,
            K=_both_sides(p.stiffness, symbolic.sparse(own.K)),
            curves=tuple(of.scaled(p.stiffness[j] ** 2) for j, of in enumerate(own.curves)),
            D_l=_both_sides(p.link_damping, symbolic.sparse(own.D_l)),
            D_m=_both_sides(p.motor_damping, symbolic.sparse(own.D_m)),
            B_m=symbolic.sparse(own.B_m),
            M_m_inverse=_both_sides(1 / p.motor_inertia, symbolic.sparse(np.linalg.inv(own.M_m))),
        )


def refuse(parts: dict[str, Array]) -> None:
    """Raise ParameterError if runs of a plant in Python change parameters that only eq. (36) has."""
    nominal = {**dict.fromkeys(SCALED, 1.0), "payload_mass": 0.0, "cubic": 0.0}
    changed = [name for name, value in nominal.items() if np.any(parts[name] != value)]
    if changed:
        raise ParameterError(
            f"{', '.join(changed)} of a run {'are' if len(changed) > 1 else 'is'} not nominal; expected the nominal "
            "value for a plant in Python, which has its own parameters plant.options.*"
        )


def vector(parts: dict[str, Array]) -> Array:
    """Return `parameters` of k runs (k, size) from their parts (k, .), with factors before the square root."""
    columns = [np.sqrt(parts[name]) if name in ROOTS else parts[name] for name in NAMES]
    return np.ascontiguousarray(np.hstack(columns))
