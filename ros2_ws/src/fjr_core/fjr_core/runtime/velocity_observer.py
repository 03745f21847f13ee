# SPDX-License-Identifier: Apache-2.0
"""Estimate velocities from sampled positions: model prediction under the held effort, correction at every sample.

    predict   x = step of eq. (36) from (q_hat, dq_hat) over dt, u held          e = (q_l, q_m) measured - predicted
    correct   q_hat = q + g e,   dq_hat = dq + h e / dt,   g = 1 - z^2, h = (1 - z)^2, z = exp(-bandwidth dt)

This is the sampled-data form of the high-gain Luenberger observer of S. Nicosia, A. Tornambe, "High-gain observers in
the state and parameter estimation of robots having elastic joints", Systems & Control Letters 13 (1989) 331-337.
(g, h) are the gains of the critically damped g-h filter (E. Brookner, "Tracking and Kalman Filtering Made Easy",
Wiley 1998): for constant dq both poles of the error are at z. All links and motors have the same bandwidth.

Guarantees for an exact model, exact effort and exact positions:
- An exact estimate stays exact, up to the integrator error.
- A small error decays exponentially if the spectral radius of the linearised error dynamics is below 1
  (tested about equilibria, at sampled configurations). No global result is claimed.
- Without damping the linearised error dynamics split into the 2n modes of the robot. A mode omega, theta = omega dt,
  has the poles of lambda^2 - ((1 + z^2) cos(theta) - (1 - z)^2 sin(theta) / theta) lambda + z^2. Complex poles have
  modulus z. The modulus is below 1 for every bandwidth up to theta = 2.33 (371 Hz at 1 kHz), and for a small bandwidth
  almost up to pi. An unstable equilibrium (omega = i nu) requires a bandwidth above about nu.
- In motion, Coriolis terms are added; the bandwidth should be large compared with the velocities [rad/s]. Observers of
  this kind converge exponentially for Lipschitz systems and short sample periods (T. N. Dinh, V. Andrieu, M. Nadri,
  U. Serres, "Continuous-discrete time observer design for Lipschitz systems with sampled measurements", IEEE
  Transactions on Automatic Control 60 (2015) 787-792); no constants are computed here.
An unmodelled acceleration a [rad/s^2] causes an error of dq_hat of about 2 a / bandwidth.
"""

from __future__ import annotations

import math
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ..errors import ParameterError
from ..law.linearized import equilibria_at, plant_matrices
from ..model.configuration_sampling import checked_configurations
from ..model.port_hamiltonian import Plant
from ..model.robot import Robot, check_robot
from ..numerics.checks import Array, positive
from ..numerics.jit import compiled
from ..numerics.one_line import brief
from ..numerics.symbolic import evaluate, symbols

LONGEST_CALL = 1.5e-3  # s; longer intervals are predicted in several calls
LONGEST_GAP = 0.1  # s; after a longer gap the observer restarts
CONFIGURATIONS = 64  # sampled, for the fastest mode and the spectral radii
LARGEST_STEP = 0.6  # largest Runge-Kutta step [s] times the rate of the fastest mode [1/s]
FEWEST_STEPS, MOST_STEPS = 4, 64  # Runge-Kutta steps per call; the simulated plant takes 4


def corrections(bandwidth: float, dt: float) -> tuple[float, float]:
    """Return (g, h) with both poles at z = exp(-bandwidth dt); bandwidth [rad/s], dt [s]."""
    z = math.exp(-bandwidth * dt)
    return 1 - z * z, (1 - z) ** 2


def first_corrections(k: int) -> tuple[float, float]:
    """Return (g, h) of the k-th sample after the first: least-squares line through all samples so far (Brookner)."""
    return 2 * (2 * k + 1) / ((k + 1) * (k + 2)), 6 / ((k + 1) * (k + 2))


class VelocityObserver:
    """Recursive estimate of velocities and smoothed positions; the module docstring lists the guarantees.

    robot: model. bandwidth [rad/s]: of the double pole of the error; ParameterError unless positive and finite.
    compile: compile to machine code if a C compiler is available (numerics.jit). Not thread-safe.

    The first sample gives zero velocity, the second the difference quotient. The gains then decrease from
    first_corrections to those of the bandwidth, so that the estimate of a moving robot settles within a few samples.
    """

    def __repr__(self) -> str:
        return f"VelocityObserver({self.robot!r}, bandwidth={brief(self.bandwidth)} rad/s)"

    def __init__(self, robot: Robot, bandwidth: float, compile: bool = False) -> None:
        check_robot(robot)
        self.robot, self._compile = robot, compile
        self.bandwidth = positive("bandwidth", bandwidth, ParameterError, "rad/s")
        self._n = n = robot.n
        self._x_hat, self._y = np.zeros(4 * n), np.zeros(2 * n)
        self._dq_l, self._dq_m = self._x_hat[2 * n : 3 * n], self._x_hat[3 * n :]
        self._stamp: int | None = None
        self._k = 0

    @property
    def state(self) -> Array:
        """Estimate (4n,): smoothed q_l, q_m [rad] and dq_l, dq_m [rad/s]; valid until the next update."""
        return self._x_hat

    @property
    def samples(self) -> int:
        """Number of samples since the last reset; the control step uses velocities from the sample OBSERVED on."""
        return self._k

    @cached_property
    def function(self) -> ca.Function:
        """The CasADi function (x_hat, y, u, dt, gain) -> x_hat at the next sample; compiled if requested.

        x_hat (4n,) as `state`; y (2n,) [rad]: positions measured after dt [s]; u (n,) [N m]: held effort;
        gain (2,): g and h / dt, zero for prediction only.
        """
        n, robot, steps = self._n, self.robot, steps_of(self.robot)
        s = symbols(ca.MX, x_hat=4 * n, y=2 * n, u=n, dt=1, gain=2)
        x_hat, y, u, dt, gain = s.values()
        step, x = Plant(robot).step_function, robot.to_state(x_hat[: 2 * n], x_hat[2 * n :])
        for _ in range(steps):
            x = step(x, u, dt / steps)
        q, dq = x[: 2 * n], robot.to_velocity(x)
        e = y - q
        x_next = ca.vertcat(q + gain[0] * e, dq + gain[1] * e)
        function = ca.Function("observer", list(s.values()), [x_next], list(s), ["x_next"])
        return compiled(function) if self._compile else function

    def reset(self) -> None:
        """Reset the observer; the next sample is the first."""
        self._stamp = None

    def update(self, stamp: int, q_l: ArrayLike, q_m: ArrayLike, u: ArrayLike) -> tuple[Array, Array]:
        """Return the velocities (dq_l, dq_m), each (n,) [rad/s], at `stamp` [ns]; they are valid until the next update.

        q_l, q_m (n,) [rad]: finite positions at that time. u (n,) [N m]: effort applied since the last update.
        A repeated stamp changes nothing. A stamp that decreases or jumps by more than LONGEST_GAP, or a non-finite
        estimate, restarts the observer.
        """
        if stamp == self._stamp:
            return self._dq_l, self._dq_m
        n = self._n
        self._y[:n], self._y[n:] = q_l, q_m
        dt = math.inf if self._stamp is None else (stamp - self._stamp) * 1e-9
        self._stamp, continues = stamp, 0 < dt <= LONGEST_GAP
        if continues:
            self._continue(dt, u)
        if not (continues and self._x_hat.dot(self._x_hat) < math.inf):  # the first one, a gap, or not finite
            self._x_hat[: 2 * n], self._x_hat[2 * n :] = self._y, 0.0
            self._k = 0
        return self._dq_l, self._dq_m

    def _continue(self, dt: float, u: ArrayLike) -> None:
        """Predict over dt [s], in calls of at most LONGEST_CALL, and correct at the end."""
        self._k += 1
        last, first = corrections(self.bandwidth, dt), first_corrections(self._k)
        g, h = first if first[1] > last[1] else last
        calls = math.ceil(dt / LONGEST_CALL)
        for call in range(1, calls + 1):
            gain = np.array([g, h / dt]) if call == calls else np.zeros(2)
            self._x_hat[:] = evaluate(self.function, self._x_hat, self._y, u, dt / calls, gain)[0]


def steps_of(robot: Robot) -> int:
    """Return the number of Runge-Kutta steps in one call, sufficient for the fastest mode of the robot."""
    points = equilibria_at(robot, checked_configurations(robot, None, CONFIGURATIONS))
    fastest = float(np.abs(np.linalg.eigvals(plant_matrices(points)[0])).max())
    return min(max(math.ceil(LONGEST_CALL * fastest / LARGEST_STEP), FEWEST_STEPS), MOST_STEPS)
