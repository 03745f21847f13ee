# SPDX-License-Identifier: Apache-2.0
"""Evaluate the v-dPBC law u(x_v, x, t) with its storage V and exact dissipation."""

from __future__ import annotations

from collections.abc import Callable, Set
from dataclasses import dataclass, fields
from functools import cached_property

import casadi as ca
from numpy.typing import ArrayLike

from ...files import other_package
from ...model.domain import GOAL, MOST_BOXES, Domain
from ...model.robot import Robot
from ...numerics.casadi_function import NumericFunction, dense_function
from ...numerics.checks import Array
from ...numerics.jit_cache import compiled_from_inputs
from ...numerics.one_line import one_line
from ..lie_derivative import Flow, flow
from ..static_law import StaticLaw
from .convergence_rate import Rate, rate
from .gains import Gains
from .link_stage import LinkStage, link_stage
from .motor_stage import MotorStage, motor_stage
from .symbolic_gains import GainTerms, terms


@dataclass(frozen=True)
class Evaluation:
    """The law and its certificate at one instant; dV = -dissipation + s_m' omega holds exactly.

    u, u_l (n,) [N m], q_md, q_tilde_l, q_tilde_m (n,) [rad], sigma_l, sigma_m (n,) [N m s],
    V [J], dissipation and dV [W].
    """

    u: Array
    u_l: Array
    q_md: Array
    q_tilde_l: Array
    sigma_l: Array
    q_tilde_m: Array
    sigma_m: Array
    V: float
    dissipation: float
    dV: float

    __repr__ = one_line


class TrackingLaw(StaticLaw):
    """The v-dPBC tracking law of a robot, as pure functions of (x_v, x, jets, omega).

    Eqs. (30)-(33) are in link_stage, eqs. (39)-(42) in motor_stage; the storage V is here.
    The controller applies u(x, x, t); analysis uses x_v != x. x_v and x are states (4n,) with momenta,
    jets (5, n) holds q_ld .. d4q_ld, omega (n,) [N m] is the external input of eq. (42).
    compile: compile to machine code if a C compiler is available (numerics.jit); results agree to rounding.
    Raises GainsError (see Gains.checked) on construction and StateError for wrong shapes. Efforts are neither
    saturated nor checked for finite values; that is the caller's duty.
    """

    def __init__(self, robot: Robot, gains: Gains, compile: bool = False) -> None:
        super().__init__(robot, gains.checked(robot.n), compile)

    def effort(self, x_v: ArrayLike, x: ArrayLike, jets: ArrayLike, omega: ArrayLike = 0.0) -> Array:
        """Return the effort u (n,) [N m], eq. (42)."""
        return self._effort(x_v, x, jets, omega)[0]

    def evaluate(self, x_v: ArrayLike, x: ArrayLike, jets: ArrayLike, omega: ArrayLike = 0.0) -> Evaluation:
        """Return the effort, all errors, the storage V of eq. (43) (undifferentiated) and its exact rate."""
        results = self._evaluate(x_v, x, jets, omega)
        u, u_l, q_md, q_tilde_l, sigma_l, q_tilde_m, sigma_m = results[:7]
        V, dissipation, dV = (float(result[0]) for result in results[7:])
        return Evaluation(u, u_l, q_md, q_tilde_l, sigma_l, q_tilde_m, sigma_m, V, dissipation, dV)

    def rate(self, configurations: ArrayLike | None = None) -> Rate:
        """Return the convergence rates [1/s], proven if the vertices of M_l are known, else sampled (k, n)."""
        return rate(self.robot, self.gains, configurations)

    def proven_rate(self, domain: Domain | None = None, goal: float = GOAL, most_boxes: int = MOST_BOXES) -> Rate:
        """Return convergence rates [1/s] that are proven on a domain of positions, by default the joint range.

        The search ends if beta >= goal times a rate attained at a configuration, or after most_boxes; what is proven
        by then is returned. Raises RobotError for a robot whose bodies are unknown or with more than 8 revolute joints,
        MissingPackageError without the package of the proofs.
        """
        prover = other_package.module("fjr_proofs.rate")
        rate: Rate = prover.proof_of_rate(self.robot, self.gains, domain, goal, most_boxes).rate
        return rate

    @cached_property
    def function(self) -> ca.Function:
        """The CasADi function (x_v, x, jets (n, 5), omega) -> u; differentiable."""
        return self._function("effort", {"u"})

    @cached_property
    def errors_function(self) -> ca.Function:
        """The CasADi function (x_v, x, jets (n, 5), omega) -> q_tilde_l, sigma_l, q_tilde_m, sigma_m."""
        return self._function("errors", {"q_tilde_l", "sigma_l", "q_tilde_m", "sigma_m"})

    @cached_property
    def command_function(self) -> ca.Function:
        """The CasADi function (x, jets (n, 5)) -> u(x, x, t), V; compiled if requested."""
        return self.ready(self._function("command", {"u", "V"}, diagonal=True))

    @cached_property
    def measured_function(self) -> ca.Function:
        """The CasADi function (position (2n,), velocity (2n,), jets (n, 5), gains) -> u, V; compiled if requested."""
        return self.derived("measured_command", lambda: self.measured_expression)

    def measured_expressions(
        self, f: Flow | None = None, omega: ca.SX | None = None, slope: bool = False
    ) -> tuple[dict[str, ca.SX], dict[str, ca.SX]]:
        """Return the arguments of measured_function, and expressions of the fields of Evaluation, s_m and port_l.

        f: flow at x_v = x, e.g. with a load. omega (n,) [N m]: input of eq. (42), zero by default.
        port_l = dV/dp_l (n,) [rad/s], defined if the flow has a load with integral action.
        slope: also return slope = dV/d(position, velocity) (4n,) at a constant reference.
        """
        f = flow(self.robot, diagonal=True) if f is None else f
        omega = ca.SX.zeros(self.robot.n) if omega is None else omega
        outputs = self._expressions(f, GainTerms(**self.symbols.by_name), omega)
        if slope:
            outputs["slope"] = f.gradient(outputs["V"])
        return self.at_measured(f, outputs)

    def derived(self, name: str, build: Callable[[], ca.Function]) -> ca.Function:
        """Return build(), a function of the robot and the gain pattern; if the law is compiled, from the code cache."""
        if not self.compiles:
            return build()
        return compiled_from_inputs(name, self.robot.fingerprint(), self.symbols.pattern, build)

    @property
    def hold_damping(self) -> Array:
        """Injected motor damping K_md (n, n) [N m s/rad]."""
        return self.gains.K_md

    @cached_property
    def _effort(self) -> NumericFunction:
        return NumericFunction(self.ready(self.function))

    @cached_property
    def _evaluate(self) -> NumericFunction:
        return NumericFunction(self.ready(self._function("evaluate", {f.name for f in fields(Evaluation)})))

    def _function(self, name: str, names: Set[str], diagonal: bool = False) -> ca.Function:
        """Build (x_v, x, jets, omega) -> the outputs named; diagonal: (x, jets) -> outputs at x_v = x, omega = 0."""
        n = self.robot.n
        f, omega = flow(self.robot, diagonal), ca.SX.zeros(n) if diagonal else ca.SX.sym("omega", n)
        x_v, x = ca.SX.sym("x_v", 4 * n), ca.SX.sym("x", 4 * n)
        outputs = {key: value for key, value in self._expressions(f, terms(self.gains), omega).items() if key in names}
        values = f.at(x_v, x, *outputs.values())
        inputs = {"x": x, "jets": f.jets} if diagonal else {"x_v": x_v, "x": x, "jets": f.jets, "omega": omega}
        return dense_function(name, inputs, dict(zip(outputs, values, strict=True)), cse=True)

    def _expressions(self, f: Flow, gains: GainTerms, omega: ca.SX) -> dict[str, ca.SX]:
        link = link_stage(f, gains)
        motor = motor_stage(f, gains, link, omega)
        dissipation = self._dissipation(gains, link, motor)
        return {
            "u": motor.u,
            "u_l": link.u_l,
            "q_md": motor.q_md,
            "q_tilde_l": link.q_tilde_l,
            "sigma_l": link.sigma_l,
            "q_tilde_m": motor.q_tilde_m,
            "sigma_m": motor.sigma_m,
            "s_m": motor.s_m,
            "port_l": motor.port,
            "V": _storage(gains, link, motor),
            "dissipation": dissipation,
            "dV": -dissipation + ca.dot(motor.s_m, omega),
        }

    def _dissipation(self, g: GainTerms, link: LinkStage, motor: MotorStage) -> ca.SX:
        """-dV/dt [W]: qt_l' Pi_l phi_l + s_l' (D_l + K_ld) s_l + qt_m' Pi_m phi_m + s_m' (D_m + K_md) s_m."""
        r = self.robot
        d_l = ca.dot(link.q_tilde_l, g.Pi_l @ g.phi_l(link.q_tilde_l)) + ca.dot(link.s_l, (r.D_l + g.K_ld) @ link.s_l)
        d_m = ca.dot(motor.q_tilde_m, g.Pi_m @ g.phi_m(motor.q_tilde_m))
        return d_l + d_m + ca.dot(motor.s_m, (r.D_m + g.K_md) @ motor.s_m)


def _storage(g: GainTerms, link: LinkStage, motor: MotorStage) -> ca.SX:
    """V [J] = (qt_l' Pi_l qt_l + s_l' sigma_l + qt_m' Pi_m qt_m + s_m' sigma_m) / 2, eq. (43) integrated."""
    V_l = ca.dot(link.q_tilde_l, g.Pi_l @ link.q_tilde_l) + ca.dot(link.s_l, link.sigma_l)
    V_m = ca.dot(motor.q_tilde_m, g.Pi_m @ motor.q_tilde_m) + ca.dot(motor.s_m, motor.sigma_m)
    return (V_l + V_m) / 2
