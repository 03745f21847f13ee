# SPDX-License-Identifier: Apache-2.0
"""Functions of a plant bound to arrays of their own: many steps for the price of one call."""

from __future__ import annotations

import casadi as ca
import numpy as np

from fjr_core import Robot
from fjr_core.numerics.casadi_function import bind, dense_function, not_converged
from fjr_core.numerics.checks import Array


class Stepper:
    """A step function (state, held inputs.., dt) -> next state, from one buffer into the other and back."""

    def __init__(self, function: ca.Function, dt: float) -> None:
        """dt: length of a step [s]. Not for two threads at once."""
        state, *held, _ = (np.zeros(function.numel_in(i)) for i in range(function.n_in()))
        self._function, self._held = function, held
        self._buffers = state, state.copy()
        length = np.array(dt)
        there = bind(function, (self._buffers[0], *held, length), self._buffers[1:])
        back = bind(function, (self._buffers[1], *held, length), self._buffers[:1])
        self._turns = there, back

    def after(self, steps: int, state: Array, *held: Array) -> Array:
        """The state that many steps later, a new array; raises StateError where a step does not converge."""
        np.copyto(self._buffers[0], state)
        for own, given in zip(self._held, held, strict=True):
            np.copyto(own, given)
        try:
            for k in range(steps):
                self._turns[k & 1]()
        except RuntimeError:
            raise not_converged(self._function) from None
        return self._buffers[steps & 1].copy()


class Velocities:
    """Velocities (dq_l, dq_m) (2n,) of states x (4n,) of a robot; not for two threads at once."""

    def __init__(self, robot: Robot) -> None:
        x = ca.SX.sym("x", 4 * robot.n)
        function = dense_function("velocities", {"x": x}, {"dq": ca.vertcat(*robot.velocity_expressions(x))})
        self._x, self._dq = np.zeros(4 * robot.n), np.zeros(2 * robot.n)
        self._evaluate = bind(function, (self._x,), (self._dq,))

    def of(self, x: Array) -> Array:
        """The velocities, a new array."""
        np.copyto(self._x, x)
        self._evaluate()
        return self._dq.copy()
