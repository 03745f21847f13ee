# SPDX-License-Identifier: Apache-2.0
"""The law u(x_v, x, t) with its storage V and exact dissipation, as functions of numbers."""

from __future__ import annotations

from collections.abc import Callable, Set
from dataclasses import dataclass, fields
from functools import cached_property

import casadi as ca
from numpy.typing import ArrayLike

from ...numerics.casadi_function import NumericFunction, dense_function
from ...numerics.checks import Array
from ...numerics.jit_cache import recalled
from ...robot.robot import Robot
from ...trajectories.reference import REFERENCE_DERIVATIVES
from ..lie_derivative import Flow, flow
from ..static_law import StaticLaw
from .convergence_rate import Rate, rate
from .gains import Gains
from .link_stage import LinkStage, link_stage
from .motor_stage import MotorStage, motor_stage
from .symbolic_gains import GainSymbols, GainTerms, terms


@dataclass(frozen=True)
class Evaluation:
    """The law and its certificate at one instant; dV = -dissipation + s_m' omega, exactly.

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


class TrackingLaw(StaticLaw):
    """The tracking law of a robot with given gains; pure functions of (x_v, x, jets, omega), bound once.

    The controller applies u(x, x, t); analysis uses x_v != x. x_v and x are states (4n,) with momenta,
    jets (5, n) holds q_ld .. d4q_ld, omega (n,) [N m] is the external input of eq. (42).
    compile: as machine code where the machine has a C compiler (numerics.jit); the same numbers to rounding.
    Raises GainsError (see Gains.checked) at birth, StateError for wrong shapes. Nothing is limited and
    nothing non-finite is caught here: that is the caller's.
    """

    def __init__(self, robot: Robot, gains: Gains, compile: bool = False) -> None:
        self.robot = robot
        self.gains = gains.checked(robot.n)
        self.compiles = compile

    def with_gains(self, gains: Gains) -> TrackingLaw:
        """The same law with other gains, whose measured_command is ready at once: nothing is built or compiled.

        Raises GainsError as at birth, and for a matrix with entries off the diagonal where this law's is diagonal.
        """
        other = TrackingLaw(self.robot, gains, self.compiles)
        other._symbols, other.measured_function = self._symbols, self.measured_function
        other._gain_values = self._symbols.values(other.gains)
        return other

    def effort(self, x_v: ArrayLike, x: ArrayLike, jets: ArrayLike, omega: ArrayLike = 0.0) -> Array:
        """Effort u (n,) [N m], eq. (42)."""
        return self._effort(x_v, x, jets, omega)[0]

    def evaluate(self, x_v: ArrayLike, x: ArrayLike, jets: ArrayLike, omega: ArrayLike = 0.0) -> Evaluation:
        """The effort with all errors, the storage V of eq. (43) (undifferentiated) and its exact rate."""
        results = self._evaluate(x_v, x, jets, omega)
        u, u_l, q_md, q_tilde_l, sigma_l, q_tilde_m, sigma_m = results[:7]
        V, dissipation, dV = (float(result[0]) for result in results[7:])
        return Evaluation(u, u_l, q_md, q_tilde_l, sigma_l, q_tilde_m, sigma_m, V, dissipation, dV)

    def rate(self, configurations: ArrayLike | None = None) -> Rate:
        """Rates beta and eq. (50) [1/s], proven where M_l is covered, else sampled at configurations (k, n)."""
        return rate(self.robot, self.gains, configurations)

    @cached_property
    def function(self) -> ca.Function:
        """The CasADi function (x_v, x, jets (n, 5), omega) -> u, with derivatives."""
        return self._function("effort", {"u"})

    @cached_property
    def errors_function(self) -> ca.Function:
        """The CasADi function (x_v, x, jets (n, 5), omega) -> q_tilde_l, sigma_l, q_tilde_m, sigma_m; derivable."""
        return self._function("errors", {"q_tilde_l", "sigma_l", "q_tilde_m", "sigma_m"})

    @cached_property
    def command_function(self) -> ca.Function:
        """The CasADi function (x, jets (n, 5)) -> u(x, x, t), V; machine code if that was asked for."""
        return self.ready(self._function("command", {"u", "V"}, diagonal=True))

    def measured_expressions(
        self, f: Flow | None = None, omega: ca.SX | None = None
    ) -> tuple[dict[str, ca.SX], dict[str, ca.SX]]:
        """The arguments of measured_function, and all that Evaluation names, with s_m, as expressions of them.

        f: a flow at x_v = x, e.g. with a load; omega (n,) [N m]: of eq. (42), zero if not given. port_l: dV/dp_l (n,)
        [rad/s], where the flow has a load with an integral.
        """
        n, symbols = self.robot.n, self._symbols
        f = flow(self.robot, diagonal=True) if f is None else f
        outputs = self._expressions(f, symbols.terms, ca.SX.zeros(n) if omega is None else omega)
        position, velocity = ca.SX.sym("position", 2 * n), ca.SX.sym("velocity", 2 * n)
        values = f.at_velocities(ca.vertcat(position, velocity), *outputs.values())
        inputs = {"position": position, "velocity": velocity, "jets": f.jets, "gains": symbols.vector}
        return inputs, dict(zip(outputs, values, strict=True))

    def derived(self, name: str, build: Callable[[], ca.Function]) -> ca.Function:
        """What `build` derives from robot and shape of the gains; as machine code, which is found again, where so."""
        return recalled(name, self.robot.fingerprint(), self._symbols.pattern, build) if self.compiles else build()

    @property
    def gain_values(self) -> Array:
        """The argument `gains` of measured_function."""
        return self._gain_values

    @property
    def hold_damping(self) -> Array:
        """K_md."""
        return self.gains.K_md

    @cached_property
    def _symbols(self) -> GainSymbols:
        return GainSymbols(self.gains)

    @cached_property
    def _gain_values(self) -> Array:
        return self._symbols.values(self.gains)

    @cached_property
    def _effort(self) -> NumericFunction:
        return self._numeric(self.function)

    @cached_property
    def _evaluate(self) -> NumericFunction:
        return self._numeric(self._function("evaluate", {f.name for f in fields(Evaluation)}))

    def _numeric(self, function: ca.Function) -> NumericFunction:
        n = self.robot.n
        return NumericFunction(self.ready(function), ((4 * n,), (4 * n,), (REFERENCE_DERIVATIVES + 1, n), (n,)))

    def _function(self, name: str, wanted: Set[str], diagonal: bool = False) -> ca.Function:
        """(x_v, x, jets, omega) -> the wanted values in Evaluation's order; (x, jets) -> at x_v = x, omega = 0."""
        n = self.robot.n
        f, omega = flow(self.robot, diagonal), ca.SX.zeros(n) if diagonal else ca.SX.sym("omega", n)
        x_v, x = ca.SX.sym("x_v", 4 * n), ca.SX.sym("x", 4 * n)
        outputs = {key: value for key, value in self._expressions(f, terms(self.gains), omega).items() if key in wanted}
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
        """-dV/dt for omega = 0: qt_l' Pi_l phi_l + s_l' (D_l + K_ld) s_l + the same of the motors."""
        r = self.robot
        d_l = ca.dot(link.q_tilde_l, g.Pi_l @ g.phi_l(link.q_tilde_l)) + ca.dot(link.s_l, (r.D_l + g.K_ld) @ link.s_l)
        d_m = ca.dot(motor.q_tilde_m, g.Pi_m @ g.phi_m(motor.q_tilde_m))
        return d_l + d_m + ca.dot(motor.s_m, (r.D_m + g.K_md) @ motor.s_m)


def _storage(g: GainTerms, link: LinkStage, motor: MotorStage) -> ca.SX:
    """V = (qt_l' Pi_l qt_l + s_l' sigma_l + qt_m' Pi_m qt_m + s_m' sigma_m) / 2, eq. (43) integrated."""
    V_l = ca.dot(link.q_tilde_l, g.Pi_l @ link.q_tilde_l) + ca.dot(link.s_l, link.sigma_l)
    V_m = ca.dot(motor.q_tilde_m, g.Pi_m @ motor.q_tilde_m) + ca.dot(motor.s_m, motor.sigma_m)
    return (V_l + V_m) / 2
