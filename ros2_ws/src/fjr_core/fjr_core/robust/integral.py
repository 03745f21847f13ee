# SPDX-License-Identifier: Apache-2.0
"""The integral's part of a sample: its state moved on by the rate of the last sample, but not into a limit."""

from __future__ import annotations

import casadi as ca

from ..robot import Robot

Terms = dict[str, ca.MX]
SAME = 1e-9  # N m: what was sent is what was wanted


class Integral:
    """Torques (2n,) [N m] of the links, then the motors, whose rates are gain * port; see vdpbc.integral.

    Where the effort sent last was not the one wanted (a limit, a fade), a joint's integrals move only in the
    direction that brings the effort wanted nearer to the one sent: a torque that grows lowers the effort.
    """

    def __init__(self, robot: Robot) -> None:
        self._B_m = ca.DM(robot.B_m)
        self.sizes = {"integral": 2 * robot.n, "rate": 2 * robot.n, "wanted": robot.n}

    def step(self, kept: Terms, sent: ca.MX, dt: ca.MX) -> ca.MX:
        """The torques (2n,) now. sent (n,): what became of the effort wanted, dt [s] ago."""
        excess = ca.mtimes(self._B_m, kept["wanted"] - sent)
        excess, rate = ca.vertcat(excess, excess), kept["rate"]
        free = ca.logic_or(ca.fabs(excess) <= SAME, rate * excess > 0)
        return kept["integral"] + ca.if_else(free, dt * rate, 0)

    def parts(self, integral: ca.MX, ports: ca.MX, gains: ca.MX, u: ca.MX) -> Terms:
        """What is kept: ports (2n,) [rad/s], gains (2n,) [N m/rad], u (n,) wanted [N m]."""
        return {"integral": integral, "rate": gains * ports, "wanted": u}


def energy(integral: ca.MX, gains: ca.MX) -> ca.MX:
    """integral' gain^-1 integral / 2 [J]; joints without a gain have no integral."""
    return ca.sum1(integral**2 / ca.if_else(gains > 0, gains, 1)) / 2
