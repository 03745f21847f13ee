# SPDX-License-Identifier: Apache-2.0
"""The total time derivative along the flow of (x, x_v, t): every dot of the paper, without an accelerometer.

Written with velocities: dq_lv = M_l(q_l)^-1 p_lv, dq_mv = M_m^-1 p_mv (method: momenta stay at the boundary).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from ..numerics import symbolic
from ..robot import virtual_system
from ..robot.robot import Robot
from ..trajectories.reference import REFERENCE_DERIVATIVES

LOAD_RATES = 2  # of a torque on the links: it acts two integrations later than q_ld


@dataclass(frozen=True)
class Motion:
    """Symbols of a state in velocities: positions, velocities and, of the links, accelerations; each (n,)."""

    q_l: ca.SX
    q_m: ca.SX
    dq_l: ca.SX
    dq_m: ca.SX
    ddq_l: ca.SX

    @classmethod
    def named(cls, suffix: str, n: int) -> Motion:
        """Fresh symbols."""
        return cls(*(ca.SX.sym(name + suffix, n) for name in ("q_l", "q_m", "dq_l", "dq_m", "ddq_l")))

    @property
    def inputs(self) -> ca.SX:
        """What must be given (4n,): positions and velocities."""
        return ca.vertcat(self.q_l, self.q_m, self.dq_l, self.dq_m)


@dataclass(frozen=True)
class Load:
    """Symbols of the torque on the links that the law believes in beside the model: known + integral.

    known (n, 3): the first part with its two rates, column k is the k-th derivative. integral (n,) [N m]: the second
    part, a state of the law, whose rate is `gain` (n, n) [N m/rad] times what the stages find (docs/robust.md); (0,)
    both: there is none.
    """

    known: ca.SX
    integral: ca.SX
    gain: ca.SX

    @classmethod
    def named(cls, n: int, integrates: bool = True) -> Load:
        """Fresh symbols."""
        m = n if integrates else 0
        return cls(ca.SX.sym("known", n, LOAD_RATES + 1), ca.SX.sym("integral", m), ca.SX.sym("integral_gain", m, m))

    @property
    def integrates(self) -> bool:
        """Whether there is the second part."""
        return self.integral.numel() > 0

    @property
    def torque(self) -> ca.SX:
        """The whole of it (n,) [N m]."""
        return self.known[:, 0] + self.integral if self.integrates else self.known[:, 0]


@dataclass(frozen=True)
class Flow:
    """The law's symbols and their rates; `virtual` is `measured` itself where x_v = x.

    jets (n, 5): q_ld .. d4q_ld, column k is the k-th derivative. The accelerations of the links are symbols
    whose values `at` puts in; so nothing is ever derived through M_l^-1.

    The rates hold the acceleration of the motors, which depends on the input, and the fifth derivative of the
    reference as free symbols: an expression that needed one of them could not become a function. None does,
    because the velocities of the motors never enter what is differentiated (relative degree four).
    load: a torque on the links that acts too, as far as the law knows; None: none.
    """

    robot: Robot
    virtual: Motion
    measured: Motion
    jets: ca.SX
    load: Load | None = None

    @cached_property
    def M_l(self) -> ca.SX:
        """M_l at the measured q_l."""
        return self.robot.links.M_l(self.measured.q_l)

    @property
    def integrated(self) -> Load | None:
        """The load, if it has an integral."""
        return self.load if self.load is not None and self.load.integrates else None

    @property
    def external(self) -> ca.SX:
        """The torque (n,) [N m] of the load on the links."""
        return ca.SX(self.robot.n, 1) if self.load is None else self.load.torque

    def d(self, *expressions: ca.SX, integral: ca.SX | None = None) -> list[ca.SX]:
        """Total time derivatives d/dt of column vectors, in one sweep over them all; integral (n,): rate of load's."""
        return self._along(self._rates if integral is None else self._rates_with(integral), *expressions)

    def pushed(self, e: ca.SX, dp_l: ca.SX) -> ca.SX:
        """(de/dp_l) dp_l of a column vector e at x_v = x, where dp_l (n,) [N m s] is a change of the links' momenta."""
        motion, ddq_l = self.measured, self._force(self.measured)
        dv = symbolic.solve(self.M_l, dp_l)
        da = symbolic.solve(self.M_l, ca.jtimes(ddq_l, motion.dq_l, dv))
        return ca.jtimes(e, ca.vertcat(motion.dq_l, motion.ddq_l), ca.vertcat(dv, da))

    def slope(self, e: ca.SX, y: ca.SX) -> ca.SX:
        """(de/dp_l)' y (n,) of a column vector e at x_v = x, y held."""
        motion, force = self.measured, self._force(self.measured)
        by_v, by_a = ca.vertsplit(ca.jtimes(e, ca.vertcat(motion.dq_l, motion.ddq_l), y, True), self.robot.n)
        through = ca.jtimes(force, motion.dq_l, symbolic.solve(self.M_l, by_a), True)
        return symbolic.solve(self.M_l, by_v + through)

    def at(self, x_v: ca.SX, x: ca.SX, *expressions: ca.SX) -> list[ca.SX]:
        """The expressions as functions of the states x_v and x (4n,), with momenta (and of jets).

        First ddq_l = M_l^-1 (K zeta - C dq_l - D_l dq_l - grad P_l), eqs. (36) and (38), then the velocities.
        """
        robot, positions = self.robot, 2 * self.robot.n
        states = [ca.vertcat(x[:positions], *robot.velocity_expressions(x))]
        if len(self._motions) == 2:
            states.insert(0, ca.vertcat(x_v[:positions], *virtual_system.velocities(robot, x_v, x)))
        return self._evaluated(expressions, states)

    def at_velocities(self, measured: ca.SX, *expressions: ca.SX) -> list[ca.SX]:
        """The expressions at x_v = x as functions of what is measured (4n,): positions and velocities (and of jets)."""
        return self._evaluated(expressions, [measured])

    def _evaluated(self, expressions: Sequence[ca.SX], inputs: list[ca.SX]) -> list[ca.SX]:
        motions = self._motions
        accelerations = [symbolic.solve(self.M_l, self._force(motion)) for motion in motions]
        values = ca.substitute(list(expressions), [motion.ddq_l for motion in motions], accelerations)
        return ca.substitute(values, [motion.inputs for motion in motions], inputs)

    @property
    def _motions(self) -> list[Motion]:
        return [self.measured] if self.virtual is self.measured else [self.virtual, self.measured]

    def _force(self, motion: Motion) -> ca.SX:
        """M_l ddq_l of a motion: C_l and M_l at the measured state, P_l and the spring at its own, eq. (38)."""
        q_l, dq_l, links = self.measured.q_l, self.measured.dq_l, self.robot.links
        spring = self.robot.K @ (motion.q_m - motion.q_l)
        C_l = links.C(q_l, dq_l, motion.dq_l)
        return spring - C_l - self.robot.D_l @ motion.dq_l - links.grad_P_l(motion.q_l) + self.external

    @cached_property
    def _rates(self) -> tuple[ca.SX, ca.SX]:
        """All symbols z and their rates dz, the load's integral held."""
        return self._rates_with(ca.SX.zeros(self.robot.n))

    def _rates_with(self, integral: ca.SX) -> tuple[ca.SX, ca.SX]:
        """The same with the rate (n,) of the load's integral."""
        first = self._rates_up_to_accelerations(integral)
        jerks = [self._jerk(motion, first) for motion in self._motions]
        z, dz = first
        return ca.vertcat(z, *(motion.ddq_l for motion in self._motions)), ca.vertcat(dz, *jerks)

    def _rates_up_to_accelerations(self, integral: ca.SX) -> tuple[ca.SX, ca.SX]:
        unknown = ca.SX.sym("unknown", self.robot.n)  # ddq_m, d5q_ld and d3w
        z = ca.vertcat(*(motion.inputs for motion in self._motions), ca.vec(self.jets))
        rates = (ca.vertcat(m.dq_l, m.dq_m, m.ddq_l, unknown) for m in self._motions)
        dz = ca.vertcat(*rates, ca.vec(self.jets[:, 1:]), unknown)
        if self.load is None:
            return z, dz
        z, dz = ca.vertcat(z, ca.vec(self.load.known)), ca.vertcat(dz, ca.vec(self.load.known[:, 1:]), unknown)
        return (ca.vertcat(z, self.load.integral), ca.vertcat(dz, integral)) if self.load.integrates else (z, dz)

    def _jerk(self, motion: Motion, rates: tuple[ca.SX, ca.SX]) -> ca.SX:
        """d3q_l = M_l^-1 d/dt(force - M_l ddq_l), ddq_l held."""
        q_l = self.measured.q_l
        (left,) = self._along(rates, self._force(motion) - self.robot.links.M_l(q_l) @ motion.ddq_l)
        return symbolic.solve(self.M_l, left)

    def _along(self, rates: tuple[ca.SX, ca.SX], *expressions: ca.SX) -> list[ca.SX]:
        stacked = symbolic.directional(ca.vertcat(*expressions), *rates)
        ends = [0]
        for e in expressions:
            ends.append(ends[-1] + e.numel())
        return ca.vertsplit(stacked, ends)


def flow(robot: Robot, diagonal: bool = False, load: Load | None = None) -> Flow:
    """Symbols of a robot's law and their rates; diagonal: at x_v = x, where everything is said once."""
    measured = Motion.named("", robot.n)
    virtual = measured if diagonal else Motion.named("v", robot.n)
    return Flow(robot, virtual, measured, ca.SX.sym("jets", robot.n, REFERENCE_DERIVATIVES + 1), load)
