# SPDX-License-Identifier: Apache-2.0
"""What all laws u(x, x, t) without a memory have in common: evaluated, bound to arrays, compiled."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ..numerics.casadi_function import NumericFunction, bind, dense_function
from ..numerics.checks import Array
from ..numerics.jit import compiled
from ..robot.robot import Robot
from ..trajectories.reference import REFERENCE_DERIVATIVES


@dataclass(frozen=True, eq=False)
class BoundCommand:
    """A law's measured command from and into its own arrays: `evaluate` writes u (n,) [N m] and V (1,) [J]."""

    evaluate: Callable[[], None]
    u: Array
    V: Array


class StaticLaw(ABC):
    """A law u(x, x, t) of a robot, a pure function bound once; a sampled_law.MeasuredLaw.

    A law says `measured_expressions`, `gain_values` and `hold_damping`; gains are arguments of its function, so
    that with_gains builds and compiles nothing. Nothing is limited and nothing non-finite is caught here.
    """

    robot: Robot
    compiles: bool

    @abstractmethod
    def with_gains(self, gains: Any) -> StaticLaw:
        """The same law with other gains, whose measured_command is ready at once. Raises GainsError."""

    @abstractmethod
    def measured_expressions(self) -> tuple[dict[str, ca.SX], dict[str, ca.SX]]:
        """The arguments of measured_function, and u (n,), V and what else there is as expressions of them."""

    @property
    @abstractmethod
    def gain_values(self) -> Array:
        """The argument `gains` (g,) of measured_function."""

    @property
    @abstractmethod
    def hold_damping(self) -> Array:
        """Damping (n, n) [N m s/rad] of the motors when the law stops and only the weight is held."""

    def measured_command(self, position: ArrayLike, velocity: ArrayLike, jets: ArrayLike) -> tuple[Array, float]:
        """u(x, x, t) (n,) [N m] and V for positions (q_l, q_m) [rad] and velocities (dq_l, dq_m) [rad/s], (2n,).

        jets (5, n): q_ld .. d4q_ld. V [J], nan where the law has none. Raises StateError for wrong shapes.
        """
        u, V = self._measured_command(position, velocity, jets, self.gain_values)
        return u, float(V[0])

    def bound(self, position: Array, velocity: Array, jets: Array) -> BoundCommand:
        """measured_command of these contiguous arrays, which each evaluation reads; not for two threads at once."""
        u, V = np.zeros(self.robot.n), np.zeros(1)
        return BoundCommand(bind(self.measured_function, (position, velocity, jets, self.gain_values), (u, V)), u, V)

    def command(self, x: ArrayLike, jets: ArrayLike) -> Array:
        """Effort u(x, x, t) (n,) [N m] at a state x (4n,) with momenta."""
        return self._command(x, jets)[0]

    def command_and_storage(self, x: ArrayLike, jets: ArrayLike) -> tuple[Array, float]:
        """The command with the storage V at x_v = x."""
        u, V = self._command(x, jets)
        return u, float(V[0])

    @cached_property
    def command_function(self) -> ca.Function:
        """The CasADi function (x, jets (n, 5)) -> u(x, x, t), V; machine code if that was asked for."""
        n = self.robot.n
        x, jets = ca.SX.sym("x", 4 * n), ca.SX.sym("jets", n, REFERENCE_DERIVATIVES + 1)
        velocity = ca.vertcat(*self.robot.velocity_expressions(x))
        u, V = self.measured_expression(x[: 2 * n], velocity, jets, ca.DM(self.gain_values))
        return self.ready(dense_function("command", {"x": x, "jets": jets}, {"u": u, "V": V}, cse=True))

    @cached_property
    def measured_function(self) -> ca.Function:
        """The CasADi function (position (2n,), velocity (2n,), jets (n, 5), gains) -> u, V; of all gains of a shape."""
        return self.ready(self.measured_expression)

    @cached_property
    def measured_expression(self) -> ca.Function:
        """measured_function, never machine code: it may be part of another function."""
        inputs, outputs = self.measured_expressions()
        return dense_function("measured_command", inputs, {key: outputs[key] for key in ("u", "V")}, cse=True)

    def ready(self, function: ca.Function) -> ca.Function:
        """The function as machine code where this law is."""
        return compiled(function) if self.compiles else function

    @cached_property
    def _measured_command(self) -> NumericFunction:
        n = self.robot.n
        shapes = ((2 * n,), (2 * n,), (REFERENCE_DERIVATIVES + 1, n), self.gain_values.shape)
        return NumericFunction(self.measured_function, shapes)

    @cached_property
    def _command(self) -> NumericFunction:
        return NumericFunction(self.command_function, ((4 * self.robot.n,), (REFERENCE_DERIVATIVES + 1, self.robot.n)))
