# SPDX-License-Identifier: Apache-2.0
"""Integral action in discrete time: gains, state update and anti-windup.

The integrals of links and motors have the rates K port_l (law.vdpbc) and K port_m. Under another law than v-dPBC both
ports are the position error of the links, and nothing is proven. A constant torque d gives the steady-state port output
G d (steady_state_ports, steady_state_errors). With K = rate G^-1 the integral compensates the torque at this rate. G is
large for a compliant joint, because the motor stage amplifies the port output by the inverse joint stiffness. A larger
K excites a poorly damped mode of the loop. The extended storage requires a constant K, so G is averaged over sampled
configurations.
"""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

from ..law.gains import CheckedGains
from ..law.interfaces import StaticLaw
from ..law.linearized import Equilibria, equilibria_at, error_dynamics, error_matrices, metric_roots, slope_at_rest
from ..law.vdpbc import TrackingLaw
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


def gain_values(law: StaticLaw, rates: tuple[Array, Array]) -> Array:
    """Return the gains of IntegralAction.gain_sizes for rates (n,) [1/s] of links and motors; nan if not finite."""
    n, points = law.robot.n, _sampled_equilibria(law.robot)
    try:
        with np.errstate(all="ignore"):
            if isinstance(law, TrackingLaw):
                ports = steady_state_ports(points, law.gains)
                sides = ports[:, :n, :n], ports[:, n:, n:]
                means = [(mean + mean.T) / 2 for mean in (side.mean(axis=0) for side in sides)]
            else:
                means = np.split(steady_state_errors(points, law).mean(axis=0), 2, axis=1)
            K_l, K_m = (
                np.sqrt(rate)[:, None] * np.linalg.inv(G) * np.sqrt(rate) for G, rate in zip(means, rates, strict=True)
            )
            parts = [K_l, K_m, np.linalg.pinv(K_l), np.linalg.pinv(K_m)]
    except np.linalg.LinAlgError:  # gains beyond double precision; the effort is not finite either
        return np.full(4 * n * n, np.nan)
    return np.concatenate([K.ravel(order="F") for K in parts])


def steady_state_ports(points: Equilibria, gains: CheckedGains) -> Array:
    """Return the gains (k, 2n, 2n) [rad/s per N m] from constant torques on links and motors to steady port outputs.

    Torques d enter the errors as de = A e + E d, E = de/d(p_l, p_m), so e = -A^-1 E d in steady state. The port output
    is E' P e with the metric P.
    """
    E, S = error_matrices(points, gains)[:, :, 2 * points.robot.n :], metric_roots(points, gains)
    steady = np.linalg.solve(error_dynamics(points, gains), -E)
    return np.asarray(np.swapaxes(S @ E, 1, 2) @ (S @ steady))


def steady_state_errors(points: Equilibria, law: StaticLaw) -> Array:
    """Return the gains (k, n, 2n) [rad/N m] from constant torques on links and motors to the steady link error.

    Links and motors are at rest: (K + N_l) e - K e_m = d_l and K (e_m - e) - B_m F (e, e_m) = d_m, u = F (e, e_m).
    """
    K, n = points.K, law.robot.n
    feedback = law.robot.B_m @ np.array([slope_at_rest(law, q)[0] for q in points.q_l])
    F_l, F_m = feedback[:, :, :n], feedback[:, :, n : 2 * n]
    return np.asarray(np.linalg.inv(points.blocks([K + points.N_l, -K], [-K - F_l, K - F_m]))[:, :n], dtype=float)


@lru_cache(maxsize=8)
def _sampled_equilibria(robot: Robot) -> Equilibria:
    return equilibria_at(robot, sample_configurations(robot, CONFIGURATIONS))
