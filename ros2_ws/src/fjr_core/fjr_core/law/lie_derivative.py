# SPDX-License-Identifier: Apache-2.0
"""Compute total time derivatives along the closed-loop vector field of (x, x_v, t): every dot of the paper.

Link accelerations come from the model, so no accelerometer is needed. The symbols are velocities, not momenta:
dq_lv = M_l(q_l)^-1 p_lv, dq_mv = M_m^-1 p_mv.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate

import casadi as ca

from ..model import springs, virtual_system
from ..model.robot import Robot
from ..motions.reference import REFERENCE_DERIVATIVES
from ..numerics import symbolic

LOAD_RATES = 2  # derivatives of a load torque on the links; it enters the law two derivatives later than q_ld


@dataclass(frozen=True)
class Motion:
    """Symbols (n,) of a state in velocity coordinates: positions, velocities and link accelerations."""

    q_l: ca.SX
    q_m: ca.SX
    dq_l: ca.SX
    dq_m: ca.SX
    ddq_l: ca.SX

    @classmethod
    def named(cls, suffix: str, n: int) -> Motion:
        """Create the symbols."""
        return cls(*(ca.SX.sym(name + suffix, n) for name in ("q_l", "q_m", "dq_l", "dq_m", "ddq_l")))

    @property
    def inputs(self) -> ca.SX:
        """Independent variables (4n,): positions and velocities."""
        return ca.vertcat(self.q_l, self.q_m, self.dq_l, self.dq_m)


@dataclass(frozen=True)
class Load:
    """Symbols of the load torque on the links that the law compensates: known + integral.

    known (n, 3): known torque and its first two derivatives; column k is the k-th derivative.
    integral (n,) [N m]: state of the integral action; its rate is `gain` (n, n) [N m/rad] times the port output
    (docs/robust.md). integral and gain are empty without integral action.
    """

    known: ca.SX
    integral: ca.SX
    gain: ca.SX

    @classmethod
    def named(cls, n: int, integrates: bool = True) -> Load:
        """Create the symbols."""
        m = n if integrates else 0
        return cls(ca.SX.sym("known", n, LOAD_RATES + 1), ca.SX.sym("integral", m), ca.SX.sym("integral_gain", m, m))

    @property
    def integrates(self) -> bool:
        """True with integral action."""
        return self.integral.numel() > 0

    @property
    def torque(self) -> ca.SX:
        """Total load torque (n,) [N m]."""
        return self.known[:, 0] + self.integral if self.integrates else self.known[:, 0]


@dataclass(frozen=True)
class Flow:
    """Symbols of the law and their time derivatives; `virtual` is `measured` where x_v = x.

    jets (n, 5): q_ld .. d4q_ld; column k is the k-th derivative. Link accelerations are symbols that `at` replaces
    by their values, so that no expression is differentiated through M_l^-1.

    The motor acceleration, which depends on the input, and the fifth derivative of the reference are free symbols.
    No derivative of the law contains them, because motor velocities do not enter the differentiated expressions
    (relative degree four). load: load torque on the links that the law compensates, or None.
    """

    robot: Robot
    virtual: Motion
    measured: Motion
    jets: ca.SX
    load: Load | None = None

    @cached_property
    def M_l(self) -> ca.SX:
        """Link inertia M_l (n, n) at the measured q_l."""
        return self.robot.links.M_l(self.measured.q_l)

    @property
    def integrated(self) -> Load | None:
        """The load if it has integral action, else None."""
        return self.load if self.load is not None and self.load.integrates else None

    @property
    def external(self) -> ca.SX:
        """Load torque (n,) [N m] on the links, zero without a load."""
        return ca.SX(self.robot.n, 1) if self.load is None else self.load.torque

    def d(self, *expressions: ca.SX, integral: ca.SX | None = None) -> list[ca.SX]:
        """Return total time derivatives d/dt of column vectors; integral (n,) [N m/s]: rate of the load's integral."""
        return self._along(self._rates if integral is None else self._rates_with(integral), *expressions)

    def momentum_jvp(self, e: ca.SX, dp_l: ca.SX) -> ca.SX:
        """Return (de/dp_l) dp_l for a column vector e at x_v = x; dp_l (n,) [N m s]: variation of the link momenta."""
        motion, ddq_l = self.measured, self._force(self.measured)
        dv = symbolic.solve(self.M_l, dp_l)
        da = symbolic.solve(self.M_l, ca.jtimes(ddq_l, motion.dq_l, dv))
        return ca.jtimes(e, ca.vertcat(motion.dq_l, motion.ddq_l), ca.vertcat(dv, da))

    def momentum_vjp(self, e: ca.SX, y: ca.SX) -> ca.SX:
        """Return (de/dp_l)' y (n,) for a column vector e at x_v = x, with y constant."""
        motion, force = self.measured, self._force(self.measured)
        by_v, by_a = ca.vertsplit(ca.jtimes(e, ca.vertcat(motion.dq_l, motion.ddq_l), y, True), self.robot.n)
        through = ca.jtimes(force, motion.dq_l, symbolic.solve(self.M_l, by_a), True)
        return symbolic.solve(self.M_l, by_v + through)

    def gradient(self, e: ca.SX) -> ca.SX:
        """Return de/d(q_l, q_m, dq_l, dq_m) (4n,) of a scalar e at x_v = x, without differentiating M_l^-1.

        M_l ddq_l = force(z) gives M_l d(ddq_l)/dz = d(force - M_l ddq_l)/dz at constant ddq_l, z = (q_l, .., dq_m).
        """
        motion = self.measured
        multiplier = symbolic.solve(self.M_l, ca.gradient(e, motion.ddq_l))
        residual = self._residual(motion, motion.ddq_l)
        return ca.gradient(e, motion.inputs) + ca.jtimes(residual, motion.inputs, multiplier, True)

    def at(self, x_v: ca.SX, x: ca.SX, *expressions: ca.SX) -> list[ca.SX]:
        """Return the expressions as functions of the states x_v and x (4n,), with momenta, and of the jets.

        Substitute ddq_l = M_l^-1 (phi(zeta) - C dq_l - D_l dq_l - grad P_l), eqs. (36) and (38), then the velocities.
        """
        q_v, q = x_v[: 2 * self.robot.n], x[: 2 * self.robot.n]
        dq_v, dq = virtual_system.velocities(self.robot, x_v, x), self.robot.velocity_expressions(x)
        return self.at_velocities([ca.vertcat(q_v, *dq_v), ca.vertcat(q, *dq)], *expressions)

    def at_velocities(self, states: Sequence[ca.SX], *expressions: ca.SX) -> list[ca.SX]:
        """Return the expressions as functions of positions and velocities (4n,) of each motion, and of the jets."""
        motions = self._motions
        accelerations = [symbolic.solve(self.M_l, self._force(motion)) for motion in motions]
        values = ca.substitute(list(expressions), [motion.ddq_l for motion in motions], accelerations)
        return ca.substitute(values, [motion.inputs for motion in motions], list(states))

    @property
    def _motions(self) -> list[Motion]:
        return [self.measured] if self.virtual is self.measured else [self.virtual, self.measured]

    def inertial_torque(self, w: ca.SX, a: ca.SX) -> ca.SX:
        """Return M_l a + C_l w (n,), with M_l and C_l at the measured state."""
        return self.robot.links.inertial_torque(self.measured.q_l, self.measured.dq_l, w, a)

    def _force(self, motion: Motion) -> ca.SX:
        """M_l ddq_l (n,) of a motion, eq. (38): C_l and M_l at the measured state, P_l and the spring at its own."""
        return self._residual(motion, ca.SX.zeros(self.robot.n))

    def _residual(self, motion: Motion, ddq_l: ca.SX) -> ca.SX:
        """force - M_l ddq_l (n,) of a motion; force: see _force."""
        spring = springs.torque(self.robot, motion.q_m - motion.q_l)
        inertial, weight = self.inertial_torque(motion.dq_l, ddq_l), self.robot.links.grad_P_l(motion.q_l)
        return spring - inertial - self.robot.D_l @ motion.dq_l - weight + self.external

    @cached_property
    def _rates(self) -> tuple[ca.SX, ca.SX]:
        """All symbols z and their rates dz, with the load's integral constant."""
        return self._rates_with(ca.SX.zeros(self.robot.n))

    def _rates_with(self, integral: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return all symbols z and their rates dz; integral (n,) [N m/s]: rate of the integral of the load.

        Jerks follow from d/dt(force - M_l ddq_l) with ddq_l constant: d3q_l = M_l^-1 of it.
        """
        unknown = ca.SX.sym("unknown", self.robot.n)  # ddq_m, d5q_ld and d3w
        z = ca.vertcat(*(motion.inputs for motion in self._motions), ca.vec(self.jets))
        rates = (ca.vertcat(m.dq_l, m.dq_m, m.ddq_l, unknown) for m in self._motions)
        dz = ca.vertcat(*rates, ca.vec(self.jets[:, 1:]), unknown)
        if self.load is not None:
            known = self.load.known
            z, dz = ca.vertcat(z, ca.vec(known)), ca.vertcat(dz, ca.vec(known[:, 1:]), unknown)
            if self.load.integrates:
                z, dz = ca.vertcat(z, self.load.integral), ca.vertcat(dz, integral)
        residuals = (self._along((z, dz), self._residual(motion, motion.ddq_l))[0] for motion in self._motions)
        jerks = [symbolic.solve(self.M_l, residual) for residual in residuals]
        return ca.vertcat(z, *(motion.ddq_l for motion in self._motions)), ca.vertcat(dz, *jerks)

    def _along(self, rates: tuple[ca.SX, ca.SX], *expressions: ca.SX) -> list[ca.SX]:
        stacked = ca.jtimes(ca.vertcat(*expressions), *rates)
        return ca.vertsplit(stacked, [0, *accumulate(e.numel() for e in expressions)])


def flow(robot: Robot, diagonal: bool = False, load: Load | None = None) -> Flow:
    """Create the symbols of a robot's law and their rates; diagonal: x_v = x, with one set of symbols."""
    measured = Motion.named("", robot.n)
    virtual = measured if diagonal else Motion.named("v", robot.n)
    return Flow(robot, virtual, measured, ca.SX.sym("jets", robot.n, REFERENCE_DERIVATIVES + 1), load)
