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
from fjr_core.model.port_hamiltonian import Plant
from fjr_core.model.rigid_arm import PayloadArm, RigidArm
from fjr_core.model.robot import Elastic, Robot, SymbolicRobot
from fjr_core.numerics import integrators, symbolic
from fjr_core.numerics.checks import Array
from fjr_core.numerics.symbolic import PackedVector, dense_function
from fjr_core.simulation.deviations import ChangedLinks, has_bodies
from fjr_core.simulation.imperfections import NAMES as IMPERFECTIONS
from fjr_core.simulation.imperfections import Imperfections
from fjr_core.simulation.nonideal_plant import NonidealPlant, dragged

from .draws import PARAMETERS

SCALED = tuple(each.name for each in PARAMETERS.values() if each.is_factor and each.name != "link_mass")
ROOTS = tuple(name for name in SCALED if name != "gravity")  # factors that enter as their square roots
FRICTION = ("coulomb_l", "coulomb_m")
PLAIN, WHOLE = "plain", "full"  # kinds of plants: without and with the deviations of FULL
FULL = (*FRICTION, "cubic", "hysteresis", "payload_mass", "link_mass")
"""Deviations of which one is not nominal only in runs of the full plant."""
NAMES = (*SCALED, *FULL, "smoothing", "link_torque", "slip", "payload_position")
"""Parts of the argument `parameters` of all functions here, in this order."""


@dataclass(frozen=True)
class ScaledLinks:
    """Links with square roots of factors (n,) on their inertia and factors (n,) on their gravity torques."""

    links: RigidArm
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


def _both_sides(root: ca.SX, matrix: ca.SX) -> ca.SX:
    """Return S A S with the entries r_i A_ij r_j."""
    return matrix * (root @ root.T)


def layout(n: int) -> PackedVector:
    """Return the parts of the argument `parameters` for n joints."""
    return PackedVector({name: PARAMETERS[name].width(n) for name in NAMES})


class ParametricPlant(NonidealPlant):
    """NonidealPlant whose robot, too, follows from the parameters, as CasADi functions from which C can be generated.

    kind: PLAIN leaves the deviations FULL out, which makes a step cheaper. own: a plant in Python, whose parameters are
    not drawn (see `refuse`), with drawn friction, hysteresis and external torques. Momenta are those of the drawn
    inertia. There is no lag: the state is (x, s) (5n,), with the sliders s of hysteresis.
    """

    def __init__(self, robot: Robot, kind: str, own: Plant | None = None) -> None:
        super().__init__(own or Plant(robot))
        self.robot, self._kind, self.layout = robot, kind, layout(robot.n)

    def named(self, parameters: ca.SX) -> SimpleNamespace:
        """Return the drawn parameters and the imperfections that are not drawn, by name."""
        ideal = Imperfections(self.robot.n)
        p = SimpleNamespace(**{name: ca.DM(getattr(ideal, name)) for name in IMPERFECTIONS})
        for name, value in self.layout.unpack(parameters).items():
            if self._kind == WHOLE or name not in FULL:
                setattr(p, name, value)
        p.static_l, p.static_m = p.coulomb_l, p.coulomb_m
        return p

    def robot_of(self, p: SimpleNamespace) -> Elastic:
        """Return the robot with the drawn factors."""
        own = self.robot
        if self.plant.in_python:
            return own
        M_m, inverse = symbolic.sparse(own.M_m), symbolic.sparse(np.linalg.inv(own.M_m))
        return SymbolicRobot(
            own,
            links=self._links_of(p),
            K=_both_sides(p.stiffness, symbolic.sparse(own.K)),
            curves=tuple(of.scaled(p.stiffness[j] ** 2) for j, of in enumerate(own.curves)),
            D_l=_both_sides(p.link_damping, symbolic.sparse(own.D_l)),
            D_m=_both_sides(p.motor_damping, symbolic.sparse(own.D_m)),
            B_m=symbolic.sparse(own.B_m),
            M_m=_both_sides(p.motor_inertia, M_m),
            M_m_inverse=_both_sides(1 / p.motor_inertia, inverse),
            added=p.cubic,
        )

    def _links_of(self, p: SimpleNamespace) -> RigidArm:
        """Return the links with the drawn factors and the payload."""
        links = self.robot.links
        if self._kind == PLAIN or links.end_effector is None:
            return ScaledLinks(links, p.link_inertia, p.gravity)
        bodies = ChangedLinks(links, {"link_mass": p.link_mass}) if has_bodies(links) else links
        scaled = ScaledLinks(bodies, p.link_inertia, p.gravity)
        return PayloadArm(scaled, links.end_effector, p.payload_mass, p.payload_position)

    @cached_property
    def functions_as_c(self) -> dict[str, ca.Function]:
        """Return the functions of struct fjr_plant in loop.h, by kind and member."""
        n = self.robot.n
        s = symbolic.symbols(x=4 * n, position=2 * n, velocity=2 * n, deflected=3 * n, parameters=self.layout.size)
        (q, sliders), none = ca.vertsplit(s["deflected"], [0, 2 * n, 3 * n]), ca.SX(2 * n, 1)
        results = {
            "velocity": (["x"], self._measure(ca.vertcat(s["x"], none), s["parameters"])[0]),
            "state": (["position", "velocity"], self._state(s["position"], s["velocity"], s["parameters"])),
            "torque": (["deflected"], self._measure(ca.vertcat(q, none, none[:n], sliders), s["parameters"])[1]),
        }
        functions = [self._held_step]
        for name, (arguments, result) in results.items():
            inputs = {each: s[each] for each in (*arguments, "parameters")}
            functions.append(dense_function(f"{self._kind}_{name}", inputs, {"result": result}, cse=True))
        return {each.name(): each for each in functions}

    @property
    def _held_step(self) -> ca.Function:
        """The function (state, u, parameters, dt) -> state (5n,), a Runge-Kutta step of order 4 with u held."""
        n, python = self.robot.n, self.plant.in_python
        s = symbolic.symbols(ca.MX if python else ca.SX, state=5 * n, u=n, parameters=self.layout.size, dt=1)
        state, u, parameters, dt = s.values()
        (x, sliders), p = ca.vertsplit(state, [0, 4 * n, 5 * n]), self.named(parameters)
        inputs = ca.vertcat(u, p.link_torque, sliders, parameters)
        x_next = integrators.rk4_expression(self.dynamics, x, (inputs,) * 3, dt)
        if self._kind == WHOLE:
            sliders = dragged(sliders, x_next[n : 2 * n] - x_next[:n], p.slip)
        return dense_function(f"{self._kind}_step", s, {"next": ca.vertcat(x_next, sliders)}, cse=not python)


def refuse(robot: Robot, in_python: bool, parts: dict[str, Array]) -> None:
    """Raise ParameterError for drawn parameters that the robot does not have.

    Only eq. (36) has factors, payload and cubic springs, a plant in Python has not; link_mass is of known bodies.
    """
    own = (*SCALED, "link_mass", "payload_mass", "cubic") if in_python else ()
    changed = [name for name in own if np.any(parts[name] != PARAMETERS[name].nominal)]
    if changed:
        raise ParameterError(
            f"{', '.join(changed)} of a run {'are' if len(changed) > 1 else 'is'} not nominal; expected the nominal "
            "value for a plant in Python, which has its own parameters plant.options.*"
        )
    if np.any(parts["link_mass"] != 1.0) and not has_bodies(robot.links):
        raise ParameterError("link_mass of a run is not 1 for an arm without bodies; expected a chain of bodies")


def vector(parts: dict[str, Array]) -> Array:
    """Return `parameters` of k runs (k, size) from their parts (k, .), with factors before the square root."""
    columns = [np.sqrt(parts[name]) if name in ROOTS else parts[name] for name in NAMES]
    return np.ascontiguousarray(np.hstack(columns))
