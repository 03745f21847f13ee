# SPDX-License-Identifier: Apache-2.0
"""The state when an effort will act: predicted by the model under the efforts that were sent and still act.

An effort sent for the sample at t acts from t + delay until the next one does. So between a sample and `delay` later
the efforts that act are known, and the model predicts the state there; the new effort is then held, and stands for
its mean: half of the hold is predicted over too, under the newest of the efforts sent.
"""

from __future__ import annotations

from functools import cached_property

import casadi as ca
import numpy as np

from ...numerics.casadi_function import dense_function
from ...numerics.integrators import rk4_expression
from ...robot.coordinates import Coordinates
from ...robot.port_hamiltonian import derivative_expression
from ...robot.robot import Robot

LONGEST_STEP = 2.5e-4  # s of the integrator in a regular hold
LATE = 0.1  # of a hold: what an effort may act longer than one before it is split
Terms = dict[str, ca.MX]


class Waiting:
    """The efforts sent of the last samples, with their ages; the last `count` are kept, enough for the delay [s]."""

    def __init__(self, n: int, delay: float, hold: float) -> None:
        self.delay = delay
        self.count = (int(np.ceil(delay / hold - 1e-9)) if delay else 0) + 1
        self._n = n
        self.sizes = {"efforts": n * self.count, "ages": self.count}

    def step(self, kept: Terms, sent: ca.MX, dt: ca.MX) -> Terms:
        """The parts anew: `sent` answered the sample dt [s] before this one; dt 0: it acted before the first one."""
        before = ca.if_else(dt > 0, kept["efforts"], ca.repmat(sent, self.count, 1))
        efforts = [sent, *ca.vertsplit(before, self._n)]
        ages = [dt, *(age + dt for age in ca.vertsplit(kept["ages"]))]
        return {"efforts": ca.vertcat(*efforts[:-1]), "ages": ca.vertcat(*ages[:-1])}

    def acting(self, parts: Terms, start: ca.MX | float, end: ca.MX | float) -> list[tuple[ca.MX, ca.MX]]:
        """Efforts (n,) and for how long [s] each acts between start and end (from now), the oldest first.

        Before the oldest, it.
        """
        efforts, ages = ca.vertsplit(parts["efforts"], self._n), ca.vertsplit(parts["ages"])
        begins = [self.delay - age for age in ages]
        ends = [ca.inf, *begins[:-1]]
        begins[-1] = -ca.inf
        lengths = [_within(b, start, end) - _within(a, start, end) for a, b in zip(begins, ends, strict=True)]
        return list(zip(efforts, lengths, strict=True))[::-1]

    def mean(self, parts: Terms, dt: ca.MX) -> ca.MX:
        """The mean effort (n,) that acted in the dt [s] before this sample."""
        pairs = self.acting(parts, -dt, 0.0)
        return sum(length * u for u, length in pairs) / ca.if_else(dt > 0, dt, 1)


class Model:
    """The robot's motion under efforts and torques, each held for at most max(hold, longest) [s], in what is measured.

    An effort that acts longer than a hold (at the first sample, after a gap) is one that acts several times.
    """

    def __init__(self, robot: Robot, hold: float, longest: float = 0.0) -> None:
        self.robot, self._steps = robot, max(1, int(np.ceil(hold / LONGEST_STEP - 1e-9)))
        self._coordinates = Coordinates(robot)
        self._hold, self._holds = hold, max(1, int(np.ceil(longest / hold - LATE)))

    def after(
        self, position: ca.MX, velocity: ca.MX, torque: ca.MX, parts: list[tuple[ca.MX, ca.MX]]
    ) -> tuple[ca.MX, ca.MX]:
        """Position and velocity (2n,) after efforts (n,) for times [s], one after another; torque (2n,): beside."""
        n = self.robot.n
        x = self._coordinates.to_momenta(position, velocity)
        for u, length in parts:
            x = self._held(x, ca.vertcat(u, torque), length)
        return x[: 2 * n], self._coordinates.to_velocities(x)

    @cached_property
    def _held(self) -> ca.Function:
        """_moved in as many equal parts as there are holds in dt; the others are not run."""
        if self._holds == 1:
            return self._moved
        n = self.robot.n
        x, inputs, dt = ca.MX.sym("x", 4 * n), ca.MX.sym("inputs", 3 * n), ca.MX.sym("dt")
        count = ca.fmin(ca.fmax(ca.ceil(dt / self._hold - LATE), 1), self._holds)
        part = ca.Function.if_else("part", self._moved, self._rests)
        after = self._moved(x, inputs, dt / count)
        for k in range(1, self._holds):
            after = part(k < count, after, inputs, dt / count)
        return dense_function("held", {"x": x, "inputs": inputs, "dt": dt}, {"after": after})

    @cached_property
    def _rests(self) -> ca.Function:
        n = self.robot.n
        x, inputs, dt = ca.MX.sym("x", 4 * n), ca.MX.sym("inputs", 3 * n), ca.MX.sym("dt")
        return dense_function("rests", {"x": x, "inputs": inputs, "dt": dt}, {"after": x})

    @cached_property
    def _moved(self) -> ca.Function:
        n = self.robot.n
        x, inputs, dt = ca.MX.sym("x", 4 * n), ca.MX.sym("inputs", 3 * n), ca.MX.sym("dt")
        after = x
        for _ in range(self._steps):
            after = rk4_expression(self._dynamics, after, (inputs, inputs, inputs), dt / self._steps)
        return dense_function("moved", {"x": x, "inputs": inputs, "dt": dt}, {"after": after})

    @cached_property
    def _dynamics(self) -> ca.Function:
        """(x, (u, torque on links, torque on motors)) -> dx."""
        n = self.robot.n
        x, inputs = ca.SX.sym("x", 4 * n), ca.SX.sym("inputs", 3 * n)
        dx = derivative_expression(self.robot, x, inputs[:n]) + ca.vertcat(ca.SX.zeros(2 * n), inputs[n:])
        return dense_function("dynamics_beside", {"x": x, "inputs": inputs}, {"dx": dx}, cse=True)


def _within(t: ca.MX | float, start: ca.MX | float, end: ca.MX | float) -> ca.MX:
    if isinstance(t, float):
        return end if t > 0 else start
    return ca.fmin(ca.fmax(t, start), end)
