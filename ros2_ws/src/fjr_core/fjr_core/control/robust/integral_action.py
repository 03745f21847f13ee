# SPDX-License-Identifier: Apache-2.0
"""The integral's part of a sample: its gains, and its state moved on by the rate of the last sample.

The integral on the links moves by K port_l (vdpbc.integral), the one on the motors by K port_m. A constant torque d
makes the port G d where the loop settles (ports_at_rest). With K = rate G^-1 the integral takes up the torque at that
rate. On a soft joint G is large, because the motor stage amplifies the port by K^-1; any larger K drives a mode of the
loop whose frequency grows with K^2 and which is hardly damped. K is constant, as the extended storage needs, so G is
the mean over sampled configurations.
"""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

from ...numerics.checks import Array
from ...robot.configuration_sampling import sample_configurations
from ...robot.equilibrium import RestPoints, rest_points
from ...robot.robot import Robot
from ..vdpbc.gains import CheckedGains
from ..vdpbc.linearized import error_dynamics, error_matrices, metric_roots

Terms = dict[str, ca.MX]
CONFIGURATIONS = 64  # sampled: where the ports at rest are looked at
SAME = 1e-9  # N m: what was sent is what was wanted


class Integral:
    """Torques (2n,) [N m] of the links, then the motors, with the gains K of both sides.

    Where the effort sent last was not the one wanted (a limit, a fade), a joint's integrals move only in the
    direction that brings the effort wanted nearer to the one sent: a torque that grows lowers the effort.
    A rate counts for at most two holds [s]: what was not measured is not integrated.
    """

    def __init__(self, robot: Robot, hold: float) -> None:
        n, self._longest = robot.n, 2 * hold
        self._B_m, self._n = ca.DM(robot.B_m), n
        self.sizes = {"integral": 2 * n, "rate": 2 * n, "wanted": n}
        self.gain_sizes = {"K_l": n * n, "K_m": n * n, "K_l_inverse": n * n, "K_m_inverse": n * n}

    def step(self, kept: Terms, sent: ca.MX, dt: ca.MX) -> ca.MX:
        """The torques (2n,) now. sent (n,): what became of the effort wanted, dt [s] ago."""
        excess = ca.mtimes(self._B_m, kept["wanted"] - sent)
        excess, rate = ca.vertcat(excess, excess), kept["rate"]
        free = ca.logic_or(ca.fabs(excess) <= SAME, rate * excess > 0)
        return kept["integral"] + ca.if_else(free, ca.fmin(dt, self._longest) * rate, 0)

    def parts(self, integral: ca.MX, ports: tuple[ca.MX, ca.MX], gains: Terms, u: ca.MX) -> Terms:
        """What is kept: ports of links and motors (n,) [rad/s], u (n,) wanted [N m]."""
        rates = [ca.mtimes(self.matrix(gains, name), port) for name, port in zip(("K_l", "K_m"), ports, strict=True)]
        return {"integral": integral, "rate": ca.vertcat(*rates), "wanted": u}

    def energy(self, integral: ca.MX, gains: Terms) -> ca.MX:
        """integral' K^-1 integral / 2 of both sides [J]; what has no gain has no integral."""
        torques = zip(("K_l_inverse", "K_m_inverse"), ca.vertsplit(integral, self._n), strict=True)
        return sum(ca.dot(torque, ca.mtimes(self.matrix(gains, name), torque)) for name, torque in torques) / 2

    def matrix(self, gains: Terms, name: str) -> ca.MX:
        """A gain (n, n) by its name in gain_sizes."""
        return ca.reshape(gains[name], self._n, self._n)


def gain_values(robot: Robot, gains: CheckedGains, rates: tuple[Array, Array]) -> Array:
    """Return the numbers of Integral.gain_sizes for rates (n,) [1/s] of links and motors; nan where there are none."""
    n = robot.n
    try:
        with np.errstate(all="ignore"):
            ports = ports_at_rest(_looked_at(robot), gains)
            K_l, K_m = _gain(ports[:, :n, :n], rates[0]), _gain(ports[:, n:, n:], rates[1])
            parts = [K_l, K_m, np.linalg.pinv(K_l), np.linalg.pinv(K_m)]
    except np.linalg.LinAlgError:  # gains beyond double precision, whose effort is not finite either
        return np.full(4 * n * n, np.nan)
    return np.concatenate([K.ravel() for K in parts])


def ports_at_rest(rest: RestPoints, gains: CheckedGains) -> Array:
    """The ports (k, 2n, 2n) [rad/s per N m] that a constant torque on links and motors makes where the loop settles.

    Torques d enter the errors as de = A e + E d, E = de/d(p_l, p_m), so e = -A^-1 E d there. The port is E' P e, P the
    metric.
    """
    E, S = error_matrices(rest, gains)[:, :, 2 * rest.robot.n :], metric_roots(rest, gains)
    settled = np.linalg.solve(error_dynamics(rest, gains), -E)
    return np.asarray(np.swapaxes(S @ E, 1, 2) @ (S @ settled))


@lru_cache(maxsize=8)
def _looked_at(robot: Robot) -> RestPoints:
    return rest_points(robot, sample_configurations(robot, CONFIGURATIONS))


def _gain(ports: Array, rate: Array) -> Array:
    """rate times the inverse of the mean port, made symmetric."""
    mean, root = ports.mean(axis=0), np.sqrt(rate)
    return np.asarray(root[:, None] * np.linalg.inv((mean + mean.T) / 2) * root)
