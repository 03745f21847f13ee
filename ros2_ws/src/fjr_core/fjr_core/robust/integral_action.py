# SPDX-License-Identifier: Apache-2.0
"""Integral action in discrete time: gains, state update and anti-windup.

The integrals of links and motors have the rates K port_l (law.vdpbc) and K port_m. A constant torque d
gives the steady-state port output G d (steady_state_ports). With K = rate G^-1 the integral compensates the torque at
this rate. G is large for a compliant joint, because the motor stage amplifies the port output by the inverse joint
stiffness. A larger K excites a poorly damped mode of the loop. The extended storage requires a constant K, so G is
averaged over sampled configurations.
"""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

from ..law.gains import CheckedGains
from ..law.linearized import Equilibria, equilibria_at, error_dynamics, error_matrices, metric_roots
from ..model.configuration_sampling import sample_configurations
from ..model.robot import Robot
from ..numerics.checks import Array

Terms = dict[str, ca.MX]
CONFIGURATIONS = 64  # sampled, for the steady-state ports
EQUAL_EFFORT = 1e-9  # N m, below it the effort sent equals the effort requested


class IntegralAction:
    """Integral torques (2n,) [N m] of links, then motors, with gains K of both.

    Anti-windup: where the effort sent differs from the effort requested (saturation, bumpless transfer), a joint's
    integrals change only in the direction that reduces this difference. Gaps in the measurements: a rate is
    integrated for at most two hold periods.
    """

    def __init__(self, robot: Robot, hold: float) -> None:
        n, self._longest = robot.n, 2 * hold
        self._B_m, self._n = ca.DM(robot.B_m), n
        self.sizes = {"integral": 2 * n, "rate": 2 * n, "requested": n}
        self.gain_sizes = {"K_l": n * n, "K_m": n * n, "K_l_inverse": n * n, "K_m_inverse": n * n}

    def step(self, kept: Terms, sent: ca.MX, dt: ca.MX) -> ca.MX:
        """Return the updated torques (2n,). sent (n,) [N m]: effort sent at the last sample, dt [s] ago."""
        excess = ca.mtimes(self._B_m, kept["requested"] - sent)
        excess, rate = ca.vertcat(excess, excess), kept["rate"]
        free = ca.logic_or(ca.fabs(excess) <= EQUAL_EFFORT, rate * excess > 0)
        return kept["integral"] + ca.if_else(free, ca.fmin(dt, self._longest) * rate, 0)

    def parts(self, integral: ca.MX, ports: tuple[ca.MX, ca.MX], gains: Terms, u: ca.MX) -> Terms:
        """Return the state for the next sample; ports (n,) [rad/s] of links and motors, u (n,) [N m] requested."""
        rates = [ca.mtimes(self.matrix(gains, name), port) for name, port in zip(("K_l", "K_m"), ports, strict=True)]
        return {"integral": integral, "rate": ca.vertcat(*rates), "requested": u}

    def energy(self, integral: ca.MX, gains: Terms) -> ca.MX:
        """Return integral' K^-1 integral / 2 [J] summed over links and motors; zero for a zero gain."""
        torques = zip(("K_l_inverse", "K_m_inverse"), ca.vertsplit(integral, self._n), strict=True)
        return sum(ca.dot(torque, ca.mtimes(self.matrix(gains, name), torque)) for name, torque in torques) / 2

    def matrix(self, gains: Terms, name: str) -> ca.MX:
        """Return a gain (n, n) by its name in gain_sizes."""
        return ca.reshape(gains[name], self._n, self._n)


def gain_values(robot: Robot, gains: CheckedGains, rates: tuple[Array, Array]) -> Array:
    """Return the gains of IntegralAction.gain_sizes for rates (n,) [1/s] of links and motors; nan if not finite."""
    n = robot.n
    try:
        with np.errstate(all="ignore"):
            ports = steady_state_ports(_sampled_equilibria(robot), gains)
            K_l, K_m = _gain(ports[:, :n, :n], rates[0]), _gain(ports[:, n:, n:], rates[1])
            parts = [K_l, K_m, np.linalg.pinv(K_l), np.linalg.pinv(K_m)]
    except np.linalg.LinAlgError:  # gains beyond double precision; the effort is not finite either
        return np.full(4 * n * n, np.nan)
    return np.concatenate([K.ravel() for K in parts])


def steady_state_ports(points: Equilibria, gains: CheckedGains) -> Array:
    """Return the gains (k, 2n, 2n) [rad/s per N m] from constant torques on links and motors to steady port outputs.

    Torques d enter the errors as de = A e + E d, E = de/d(p_l, p_m), so e = -A^-1 E d in steady state. The port output
    is E' P e with the metric P.
    """
    E, S = error_matrices(points, gains)[:, :, 2 * points.robot.n :], metric_roots(points, gains)
    steady = np.linalg.solve(error_dynamics(points, gains), -E)
    return np.asarray(np.swapaxes(S @ E, 1, 2) @ (S @ steady))


@lru_cache(maxsize=8)
def _sampled_equilibria(robot: Robot) -> Equilibria:
    return equilibria_at(robot, sample_configurations(robot, CONFIGURATIONS))


def _gain(ports: Array, rate: Array) -> Array:
    """Return the rate times the inverse of the symmetrised mean port gain."""
    mean, root = ports.mean(axis=0), np.sqrt(rate)
    return np.asarray(root[:, None] * np.linalg.inv((mean + mean.T) / 2) * root)
