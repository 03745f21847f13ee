# SPDX-License-Identifier: Apache-2.0
"""Velocities from positions: the robot's own step under the held effort, corrected at every sample.

    predict   x = step of eq. (36) from (q_hat, dq_hat) over dt, u held          e = (q_l, q_m) measured - predicted
    correct   q_hat = q + g e,   dq_hat = dq + h e / dt,   g = 1 - z^2, h = (1 - z)^2, z = exp(-bandwidth dt)

A Luenberger observer with high gain, as S. Nicosia, A. Tornambe, "High-gain observers in the state and parameter
estimation of robots having elastic joints", Systems & Control Letters 13 (1989) 331-337, use it in continuous time,
in the form for sampled positions: the model between the samples, a correction at each. (g, h) are those of the
critically damped g-h filter (E. Brookner, "Tracking and Kalman Filtering Made Easy", Wiley 1998): for
dq = const both poles of the error are at z. One bandwidth for all links and motors.

What is guaranteed, for the exact model and effort and exact positions:
- an exact estimate stays exact, up to the integrator;
- near it the error decays exponentially wherever the spectral radius of its linearisation is below 1
  (observer_error.error_radii: at rest, at sampled configurations); nothing global is claimed;
- without damping that linearisation splits into the 2n modes of the robot at rest. A mode omega, theta = omega dt, has
  the poles of lambda^2 - ((1 + z^2) cos(theta) - (1 - z)^2 sin(theta) / theta) lambda + z^2: of modulus z wherever they
  are complex, and below 1 for every bandwidth up to theta = 2.33 (371 Hz at 1 kHz), for small ones almost up to pi.
  Where gravity topples (omega = i nu) it takes a bandwidth above about nu;
- in motion Coriolis terms come on top: the bandwidth is to be large beside the velocities [rad/s]. For Lipschitz
  systems and short sample periods observers of this kind are proven to converge exponentially (T. N. Dinh,
  V. Andrieu, M. Nadri, U. Serres, "Continuous-discrete time observer design for Lipschitz systems with sampled
  measurements", IEEE Transactions on Automatic Control 60 (2015) 787-792); no constants are computed here.
An acceleration a [rad/s^2] that the model does not know makes dq_hat wrong by about 2 a / bandwidth.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ..errors import ParameterError
from ..numerics.casadi_function import bind, dense_function
from ..numerics.checks import Array
from ..numerics.jit import compiled
from ..robot.configuration_sampling import checked_configurations
from ..robot.equilibrium import plant_matrices, rest_points
from ..robot.port_hamiltonian import Plant
from ..robot.robot import Robot

LONGEST_CALL = 1.5e-3  # s; more is predicted in several calls
LONGEST_GAP = 0.1  # s; after a longer one the observer begins anew
CONFIGURATIONS = 64  # sampled: for the fastest mode and where the error's radius is looked at
FINE = 0.6  # the fastest mode's rate [1/s] times a Runge-Kutta step [s] is at most this
FEWEST_STEPS, MOST_STEPS = 4, 64  # Runge-Kutta steps in a call; 4 are as many as the simulated plant takes


def corrections(bandwidth: float, dt: float) -> tuple[float, float]:
    """(g, h) with both poles at z = exp(-bandwidth dt); bandwidth [rad/s], dt [s]."""
    z = math.exp(-bandwidth * dt)
    return 1 - z * z, (1 - z) ** 2


def first_corrections(k: int) -> tuple[float, float]:
    """(g, h) of the k-th sample after the first: a straight line through all so far, by least squares (Brookner)."""
    return 2 * (2 * k + 1) / ((k + 1) * (k + 2)), 6 / ((k + 1) * (k + 2))


class VelocityObserver:
    """Velocities (and smoothed positions) of a robot, sample by sample; see this module for what it guarantees.

    robot: the model. bandwidth [rad/s]: of the error's double pole, ParameterError unless positive and finite.
    compile: as machine code where the machine has a C compiler (numerics.jit). Not for two threads at once.

    The first sample gives velocity 0, the second the difference, and the gains of first_corrections shrink from there
    to those of the bandwidth: a robot met in motion is known after some samples, not after some 1 / bandwidth.
    """

    def __init__(self, robot: Robot, bandwidth: float, compile: bool = False) -> None:
        if not (math.isfinite(bandwidth) and bandwidth > 0):
            raise ParameterError(f"bandwidth is {bandwidth} rad/s; expected a positive finite number")
        self.robot = robot
        self.bandwidth = float(bandwidth)
        self._compile = compile
        self._n = n = robot.n
        self._x_hat, self._x_next, self._y = np.zeros(4 * n), np.zeros(4 * n), np.zeros(2 * n)
        self._u, self._dt, self._gain = np.zeros(n), np.zeros(1), np.zeros(2)
        self._dq_l, self._dq_m = self._x_hat[2 * n : 3 * n], self._x_hat[3 * n :]
        self._stamp: int | None = None
        self._k = 0

    @property
    def state(self) -> Array:
        """The estimate (4n,): q_l, q_m [rad] smoothed, dq_l, dq_m [rad/s]; good until the next update."""
        return self._x_hat

    @property
    def fresh(self) -> bool:
        """Whether the last update began anew: the velocities are 0 because nothing is known of them."""
        return self._k == 0

    @cached_property
    def function(self) -> ca.Function:
        """The CasADi function (x_hat, y, u, dt, gain) -> x_hat at the next sample; machine code if asked for.

        x_hat (4n,) as `state`, y (2n,) the positions [rad] measured after dt [s], u (n,) [N m] held meanwhile,
        gain (2,): g and h / dt; zeros only predict.
        """
        function = _observer_function(self.robot, steps_of(self.robot))
        return compiled(function) if self._compile else function

    def reset(self) -> None:
        """Forget everything: the next sample is the first."""
        self._stamp = None

    def warm_up(self) -> None:
        """Build what is built once, so that the first update is as fast as any other."""
        _ = self._advance

    def update(self, stamp: int, q_l: ArrayLike, q_m: ArrayLike, u: ArrayLike) -> tuple[Array, Array]:
        """Velocities (dq_l, dq_m), each (n,) [rad/s], at `stamp` [ns]; they are good until the next update.

        q_l, q_m (n,) [rad]: finite positions at that time; u (n,) [N m]: the effort applied since the last update.
        A repeated stamp changes nothing. A stamp that went back or jumped by more than LONGEST_GAP begins anew, and
        so does an estimate that is not finite.
        """
        if stamp == self._stamp:
            return self._dq_l, self._dq_m
        self._y[: self._n], self._y[self._n :] = q_l, q_m
        dt = math.inf if self._stamp is None else (stamp - self._stamp) * 1e-9
        self._stamp = stamp
        if 0 < dt <= LONGEST_GAP:
            self._u[:] = u
            self._continue(dt)
        else:
            self._begin()
        return self._dq_l, self._dq_m

    def _begin(self) -> None:
        n = self._n
        self._x_hat[: 2 * n], self._x_hat[2 * n :] = self._y, 0.0
        self._k = 0

    def _continue(self, dt: float) -> None:
        calls = math.ceil(dt / LONGEST_CALL)
        self._dt[0] = dt / calls
        if calls > 1:
            self._gain[:] = 0.0
            for _ in range(calls - 1):
                self._advance()
                self._x_hat[:] = self._x_next
        g, h = self._corrections(dt)
        self._gain[0], self._gain[1] = g, h / dt
        self._advance()
        self._x_hat[:] = self._x_next
        if not self._x_hat.dot(self._x_hat) < math.inf:
            self._begin()

    def _corrections(self, dt: float) -> tuple[float, float]:
        self._k += 1
        last, first = corrections(self.bandwidth, dt), first_corrections(self._k)
        return first if first[1] > last[1] else last

    @cached_property
    def _advance(self) -> Callable[[], None]:
        return bind(self.function, [self._x_hat, self._y, self._u, self._dt, self._gain], [self._x_next])


def _observer_function(robot: Robot, steps: int) -> ca.Function:
    n = robot.n
    sizes = {"x_hat": 4 * n, "y": 2 * n, "u": n, "dt": 1, "gain": 2}
    x_hat, y, u, dt, gain = (ca.MX.sym(name, size) for name, size in sizes.items())
    to_momenta, to_velocities = _coordinates(robot)
    x, step = to_momenta(x_hat), Plant(robot).step_function
    for _ in range(steps):
        x = step(x, u, dt / steps)
    q, dq = ca.vertsplit(to_velocities(x), 2 * n)
    e = y - q
    x_next = ca.vertcat(q + gain[0] * e, dq + gain[1] * e)
    return ca.Function("observer", [x_hat, y, u, dt, gain], [x_next], list(sizes), ["x_next"])


def _coordinates(robot: Robot) -> tuple[ca.Function, ca.Function]:
    """(q_l, q_m, dq_l, dq_m) -> x of eq. (36), and back."""
    x = ca.SX.sym("x", 4 * robot.n)
    q_l, q_m, dq_l, dq_m = ca.vertsplit(x, robot.n)
    momenta = ca.vertcat(q_l, q_m, robot.links.M_l(q_l) @ dq_l, robot.M_m @ dq_m)
    velocities = ca.vertcat(q_l, q_m, *robot.velocity_expressions(x))
    return (
        dense_function("momenta", {"x": x}, {"p": momenta}, cse=True),
        dense_function("velocities", {"x": x}, {"dq": velocities}, cse=True),
    )


def steps_of(robot: Robot) -> int:
    """Return the number of Runge-Kutta steps in one call, enough for the robot's fastest mode at rest."""
    rest = rest_points(robot, checked_configurations(robot, None, CONFIGURATIONS))
    fastest = float(np.abs(np.linalg.eigvals(plant_matrices(rest)[0])).max())
    return min(max(math.ceil(LONGEST_CALL * fastest / FINE), FEWEST_STEPS), MOST_STEPS)
