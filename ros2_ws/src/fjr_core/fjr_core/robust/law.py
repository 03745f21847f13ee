# SPDX-License-Identifier: Apache-2.0
"""Robust extensions of a law: estimate disturbances, predict the state, integrate, compute the effort."""

from __future__ import annotations

from functools import cached_property

import casadi as ca
import numpy as np

from ..errors import GainsError
from ..law.interfaces import SampledLaw, StaticLaw
from ..law.lie_derivative import Load, flow
from ..law.vdpbc import TrackingLaw
from ..numerics.checks import Array
from ..numerics.symbolic import PackedVector, dense_function
from .disturbance_observer import DisturbanceObserver
from .integral_action import IntegralAction, gain_values
from .options import Robust
from .smith_predictor import EffortBuffer, Predictor

OUTPUTS = ("u", "V", "dissipation", "port_m", "port_l")


def loaded_expression(law: TrackingLaw, integrates: bool = True) -> ca.Function:
    """Return the CasADi function of the law u(x, x, t) with a load, not compiled.

    (position (2n,), velocity (2n,), jets (n, 5), gains (g,), known (n, 3), matched (n,), integral (n,),
    integral_gain (n, n)) -> OUTPUTS. known: link torque with two derivatives. matched (n,) [N m]: motor torque. The law
    compensates both. integral (n,) [N m]: state of the integral action with the symmetric gain integral_gain
    [N m/rad] (lie_derivative.Load). V [J] without the energy of the integral. dissipation [W]: see
    law.vdpbc. port_m = s_m = dV/dp_m, port_l = dV/dp_l (n,) [rad/s]. integrates = False omits the last
    two arguments and port_l, which cost as much as the law.
    """
    n = law.robot.n
    load, matched = Load.named(n, integrates), ca.SX.sym("matched", n)
    inputs, outputs = law.measured_expressions(flow(law.robot, diagonal=True, load=load), -matched)
    arguments = inputs | {"known": load.known, "matched": matched}
    if integrates:
        arguments |= {"integral": load.integral, "integral_gain": load.gain}
    found, names = outputs | {"port_m": outputs["s_m"]}, OUTPUTS if integrates else OUTPUTS[:-1]
    return dense_function("loaded_command", arguments, {name: found[name] for name in names}, cse=True)


def loaded_by_springs(
    law: StaticLaw, at: tuple[ca.MX, ca.MX], jets: ca.MX, gains: ca.MX, known: ca.MX, matched: ca.MX
) -> tuple[ca.MX, ca.MX]:
    """Return u (n,) [N m] and V of any law that compensates known (n, 3) and matched (n,), see loaded_expression.

    With straight springs and theta' = theta + K^-1 w the links move as without the torque w, and the motors as under

        B_m u' = B_m u + w_m + w + D_m K^-1 dw + M_m K^-1 d2w.

    The law computes u' at (q, theta'). For v-dPBC this is loaded_expression.
    """
    robot, (w, dw, d2w) = law.robot, ca.horzsplit(known)
    K_inverse, B_inverse, none = (ca.DM(np.linalg.inv(robot.K)), ca.DM(np.linalg.inv(robot.B_m)), ca.MX(robot.n, 1))
    position, velocity = (x + ca.vertcat(none, ca.mtimes(K_inverse, d)) for x, d in zip(at, (w, dw), strict=True))
    u, V = law.measured_expression(position, velocity, jets, gains)
    lag = ca.mtimes(ca.DM(robot.D_m), ca.mtimes(K_inverse, dw)) + ca.mtimes(ca.DM(robot.M_m), ca.mtimes(K_inverse, d2w))
    return u - ca.mtimes(B_inverse, matched + w + lag), V


def sampled_law(law: StaticLaw, robust: Robust | None = None) -> SampledLaw:
    """Return the law with the robust action requested, as it is run alone if there is none. Raises GainsError."""
    robust = (robust or Robust()).checked(law.robot.n)
    return law.sampled if robust.off else RobustLaw(law, robust)


class RobustLaw(SampledLaw):
    """A law with robust action (docs/robust.md).

    Each sample estimates the disturbance torques, predicts the state at the time the effort acts, and evaluates there
    the law that compensates the estimates and the integral. V is the storage at this state, for v-dPBC plus the energy
    of the integral. Springs with a curve require a TrackingLaw for estimates and integral action.
    Raises GainsError for inconsistent options.
    """

    def __init__(self, law: StaticLaw, robust: Robust) -> None:
        self.law, self.robust = law, robust.checked(law.robot.n)
        self.robot, self.in_python, self.lead = law.robot, law.in_python, self.robust.lead
        if law.observes and not self.robust.off:
            raise GainsError(
                f"{type(law).__name__} estimates {law.observes} itself; expected robust.* of 0: two estimates of one "
                "torque cannot be told apart, and a prediction leaves its observer behind"
            )
        if law.robot.curve and (self.robust.estimates or self.robust.integrates) and not isinstance(law, TrackingLaw):
            raise GainsError(
                f"{type(law).__name__} is given springs with a {law.robot.curve}; expected v_dpbc, or robust.delay "
                "only: other laws compensate torques through straight springs"
            )

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.law!r}, {self.robust!r})"

    def raise_failure(self) -> None:
        """Raise the error of an evaluation of the law in Python since the last call."""
        self.law.raise_failure()

    @property
    def static(self) -> StaticLaw:
        """The law without robust action."""
        return self.law

    @property
    def hold_damping(self) -> Array:
        """That of the law."""
        return self.law.hold_damping

    @property
    def gain_values(self) -> Array:
        """Gains of the law, then residual gains (2n,) and integral gains (integral_action.gain_values) if enabled."""
        r, values = self.robust, [self.law.gain_values]
        if r.estimates:
            values += [np.asarray(r.residual_gain), np.asarray(r.motor_residual_gain)]
        if r.integrates:
            values.append(gain_values(self.law, (np.asarray(r.integral_gain), np.asarray(r.motor_integral_gain))))
        return np.concatenate(values)

    @property
    def memory(self) -> Array:
        """Initial controller state: zeros."""
        return np.zeros(self._memory.size)

    @cached_property
    def function(self) -> ca.Function:
        """step_function, compiled if the law is compiled."""
        law, r = self.law, self.robust
        if not isinstance(law, TrackingLaw):
            return law.ready(self.step_function)
        which = f"{r.estimates:d}{r.integrates:d}_{r.delay!r}_{r.hold!r}".replace(".", "p").replace("-", "m")
        return law.derived(f"robust_law_{which}", lambda: self.step_function)

    def with_law(self, law: StaticLaw) -> RobustLaw:
        """Return this robust law for a law made by `self.law.with_gains`; nothing is built again."""
        other = type(self)(law, self.robust)
        other.__dict__.update(step_function=self.step_function, function=self.function)
        return other

    @cached_property
    def step_function(self) -> ca.Function:
        """SampledLaw.step_function."""
        s, r, n = self.step_symbols(), self.robust, self.robot.n
        gains, kept = self._gains.unpack(s["gains"]), self._memory.unpack(s["memory"])
        buffer, observer, action = self._buffer, DisturbanceObserver(self.robot), self._integral
        parts = buffer.step(kept, s["sent"], s["dt"]) if r.estimates or r.predicts else {}
        known, estimate, integral = ca.MX.zeros(n, 3), ca.MX.zeros(2 * n), ca.MX.zeros(2 * n)
        if r.estimates:
            acted, L = buffer.mean(parts, s["dt"]), gains["residual"]
            parts |= observer.step(kept, s["position"], s["velocity"], acted, L, s["dt"])
            known, estimate = observer.fed_forward(parts, L), parts["r"]
        if r.integrates:
            integral = action.step(kept, s["sent"], s["dt"])
        at = s["position"], s["velocity"]
        if r.predicts:  # the state at the time the effort acts
            newest = ca.vertsplit(parts["efforts"], n)[0]
            efforts = [*buffer.acting(parts, 0.0, r.delay), (newest, r.hold / 2)]
            at = Predictor(self.robot, r.hold, r.delay).predict(*at, estimate if r.estimates else integral, efforts)
        if not (r.estimates or r.integrates):
            u, V = self.law.measured_expression(*at, s["jets"], gains["law"])
        elif isinstance(self.law, TrackingLaw):  # the law that compensates these torques
            loaded = loaded_expression(self.law, r.integrates)
            arguments = (*at, s["jets"], gains["law"], known, estimate[n:] + integral[n:])
            if r.integrates:
                u, V, _, port_m, port_l = loaded(*arguments, integral[:n], action.matrix(gains, "K_l"))
                parts |= action.parts(integral, (port_l, port_m), gains, u)
                V += action.energy(integral, gains)
            else:
                u, V, *_ = loaded(*arguments)
        else:
            e, de = (each[:n] - s["jets"][:, k] for k, each in enumerate(at))
            if r.integrates:
                K_l = action.matrix(gains, "K_l")
                known += ca.horzcat(integral[:n], ca.mtimes(K_l, e), ca.mtimes(K_l, de))
            u, V = loaded_by_springs(self.law, at, s["jets"], gains["law"], known, estimate[n:] + integral[n:])
            if r.integrates:
                parts |= action.parts(integral, (e, e), gains, u)
        return dense_function("robust_law", s, {"u": u, "V": V, "next": self._memory.pack(parts)})

    @cached_property
    def _gains(self) -> PackedVector:
        r, residual = self.robust, {"residual": 2 * self.robot.n}
        law = {"law": len(self.law.gain_values)}
        return PackedVector(
            law | (residual if r.estimates else {}) | (self._integral.gain_sizes if r.integrates else {})
        )

    @cached_property
    def _memory(self) -> PackedVector:
        r = self.robust
        sizes = self._buffer.sizes if r.estimates or r.predicts else {}
        sizes = sizes | (DisturbanceObserver(self.robot).sizes if r.estimates else {})
        return PackedVector(sizes | (self._integral.sizes if r.integrates else {}))

    @property
    def _buffer(self) -> EffortBuffer:
        return EffortBuffer(self.robot.n, self.robust.delay, self.robust.hold)

    @property
    def _integral(self) -> IntegralAction:
        return IntegralAction(self.robot, self.robust.hold)
