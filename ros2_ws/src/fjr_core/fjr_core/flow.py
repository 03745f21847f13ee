# SPDX-License-Identifier: Apache-2.0
"""The total time derivative along the flow of (x, x_v, t): every dot of the paper, without an accelerometer."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from . import plant, symbolic, virtual
from .robot import Robot

REFERENCE_DERIVATIVES = 4  # q_ld .. d4q_ld: the law has relative degree four


@dataclass(frozen=True)
class Flow:
    """Symbols z = (x_v, x, q_ld .. d4q_ld) and their rates dz; jets (n, 5), column k is the k-th derivative.

    The rates hold the unknown input u and the fifth derivative of the reference as free symbols: an
    expression that needed one of them could not become a function. None does, because the momenta of
    the motors never enter what is differentiated (relative degree four).
    """

    robot: Robot
    x_v: ca.SX
    x: ca.SX
    jets: ca.SX
    z: ca.SX
    dz: ca.SX

    def d(self, *expressions: ca.SX) -> list[ca.SX]:
        """Total time derivatives d/dt of column vectors, in one sweep over them all."""
        stacked = symbolic.directional(ca.vertcat(*expressions), self.z, self.dz)
        ends = [0]
        for e in expressions:
            ends.append(ends[-1] + e.numel())
        return ca.vertsplit(stacked, ends)


def flow(robot: Robot) -> Flow:
    """Symbols of a robot's law and their rates: plant (36), virtual system (38), jets shifted by one."""
    n = robot.n
    x_v, x = ca.SX.sym("x_v", 4 * n), ca.SX.sym("x", 4 * n)
    jets = ca.SX.sym("jets", n, REFERENCE_DERIVATIVES + 1)
    u, d5q_ld = ca.SX.sym("unknown_u", n), ca.SX.sym("unknown_d5q_ld", n)
    dx_v = virtual.derivative_expression(robot, x_v, x, u)
    dx = plant.derivative_expression(robot, x, u)
    djets = ca.horzcat(jets[:, 1:], d5q_ld)
    z = ca.vertcat(x_v, x, ca.vec(jets))
    return Flow(robot, x_v, x, jets, z, ca.vertcat(dx_v, dx, ca.vec(djets)))
