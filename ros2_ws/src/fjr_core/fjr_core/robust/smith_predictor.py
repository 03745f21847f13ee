# SPDX-License-Identifier: Apache-2.0
"""Smith predictor: predict the state at the time an effort acts, under the efforts already sent.

An effort sent for the sample at t acts from t + delay until the next one does. The efforts that act between a sample
and `delay` later are therefore known, and the model predicts the state at that time. The new effort is then held; to
account for the mean delay of the hold, the prediction extends over half of the hold period under the newest effort.
"""

from __future__ import annotations

from functools import cached_property

import casadi as ca
import numpy as np

from ..model.port_hamiltonian import derivative_expression
from ..model.robot import Robot
from ..numerics.integrators import rk4_expression
from ..numerics.symbolic import dense_function, symbols

LONGEST_STEP = 2.5e-4  # s, integrator step within one hold period
HOLD_TOLERANCE = 0.1  # of a hold period: an effort that acts longer than 1 + this is integrated in several parts
Terms = dict[str, ca.MX]


class EffortBuffer:
    """The last `count` efforts sent with their ages [s], enough to cover the delay [s]."""

    def __init__(self, n: int, delay: float, hold: float) -> None:
        self.delay = delay
        self.count = (int(np.ceil(delay / hold - 1e-9)) if delay else 0) + 1
        self._n = n
        self.sizes = {"efforts": n * self.count, "ages": self.count}

    def step(self, kept: Terms, sent: ca.MX, dt: ca.MX) -> Terms:
        """Return the updated buffer. sent (n,) [N m]: effort of the sample dt [s] ago; dt = 0 at the first sample."""
        before = ca.if_else(dt > 0, kept["efforts"], ca.repmat(sent, self.count, 1))
        efforts = [sent, *ca.vertsplit(before, self._n)]
        ages = [dt, *(age + dt for age in ca.vertsplit(kept["ages"]))]
        return {"efforts": ca.vertcat(*efforts[:-1]), "ages": ca.vertcat(*ages[:-1])}

    def acting(self, parts: Terms, start: ca.MX | float, end: ca.MX | float) -> list[tuple[ca.MX, ca.MX]]:
        """Return the efforts (n,) that act between start and end [s] from now and their durations [s], oldest first.

        The oldest effort also acts at all earlier times.
        """
        efforts, ages = ca.vertsplit(parts["efforts"], self._n), ca.vertsplit(parts["ages"])
        begins = [self.delay - age for age in ages]
        ends = [ca.inf, *begins[:-1]]
        begins[-1] = -ca.inf
        lengths = [_within(b, start, end) - _within(a, start, end) for a, b in zip(begins, ends, strict=True)]
        return list(zip(efforts, lengths, strict=True))[::-1]

    def mean(self, parts: Terms, dt: ca.MX) -> ca.MX:
        """Return the mean effort (n,) over the dt [s] before this sample."""
        pairs = self.acting(parts, -dt, 0.0)
        return sum(length * u for u, length in pairs) / ca.if_else(dt > 0, dt, 1)


class Predictor:
    """Predict the measured motion of the robot under piecewise constant efforts and torques.

    Each piece lasts at most max(hold, longest) [s]. A piece longer than a hold period (first sample, gap) is integrated
    in several parts.
    """

    def __init__(self, robot: Robot, hold: float, longest: float = 0.0) -> None:
        self.robot, self._steps = robot, max(1, int(np.ceil(hold / LONGEST_STEP - 1e-9)))
        self._hold, self._holds = hold, max(1, int(np.ceil(longest / hold - HOLD_TOLERANCE)))

    def predict(
        self, position: ca.MX, velocity: ca.MX, torque: ca.MX, parts: list[tuple[ca.MX, ca.MX]]
    ) -> tuple[ca.MX, ca.MX]:
        """Return position and velocity (2n,) after parts (effort (n,), duration [s]); torque (2n,): disturbance."""
        n = self.robot.n
        x = self.robot.to_state(position, velocity)
        for u, length in parts:
            x = self._held_step(x, ca.vertcat(u, torque), length)
        return x[: 2 * n], self.robot.to_velocity(x)

    @cached_property
    def _held_step(self) -> ca.Function:
        """Apply _step in as many equal parts as dt has hold periods."""
        if self._holds == 1:
            return self._step
        s = self._symbols()
        x, inputs, dt = s.values()
        count = ca.fmin(ca.fmax(ca.ceil(dt / self._hold - HOLD_TOLERANCE), 1), self._holds)
        part = ca.Function.if_else("part", self._step, dense_function("identity", s, {"after": x}))
        after = self._step(x, inputs, dt / count)
        for k in range(1, self._holds):
            after = part(k < count, after, inputs, dt / count)
        return dense_function("held", s, {"after": after})

    @cached_property
    def _step(self) -> ca.Function:
        s = self._symbols()
        after, inputs, dt = s.values()
        for _ in range(self._steps):
            after = rk4_expression(self._dynamics, after, (inputs, inputs, inputs), dt / self._steps)
        return dense_function("step", s, {"after": after})

    @cached_property
    def _dynamics(self) -> ca.Function:
        """(x, (u, link torque, motor torque)) -> dx."""
        n = self.robot.n
        s = symbols(x=4 * n, inputs=3 * n)
        x, inputs = s.values()
        dx = derivative_expression(self.robot, x, inputs[:n]) + ca.vertcat(ca.SX.zeros(2 * n), inputs[n:])
        return dense_function("disturbed_dynamics", s, {"dx": dx}, cse=True)

    def _symbols(self) -> dict[str, ca.MX]:
        return symbols(ca.MX, x=4 * self.robot.n, inputs=3 * self.robot.n, dt=1)


def _within(t: ca.MX | float, start: ca.MX | float, end: ca.MX | float) -> ca.MX:
    if isinstance(t, float):
        return end if t > 0 else start
    return ca.fmin(ca.fmax(t, start), end)
