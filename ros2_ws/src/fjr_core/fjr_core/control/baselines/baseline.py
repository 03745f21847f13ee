# SPDX-License-Identifier: Apache-2.0
"""What the baseline laws share: gains as symbols, one expression of u and V along the flow of (x, t)."""

from __future__ import annotations

from abc import abstractmethod
from functools import cached_property
from types import SimpleNamespace
from typing import Any, Protocol

import casadi as ca
import numpy as np

from ...errors import GainsError
from ...numerics import checks
from ...numerics.checks import Array
from ...robot.robot import Robot
from ..lie_derivative import Flow, flow
from ..static_law import StaticLaw
from ..vdpbc.symbolic_gains import ArraySymbols


class BaselineGains(Protocol):
    """Gains of a baseline as its paper has them."""

    def arrays(self, robot: Robot) -> dict[str, Array]:
        """All numbers that the law's equations take, by name; raises GainsError where the paper's condition fails."""


class Baseline(StaticLaw):
    """A law of a robot with given gains: u and V of what is measured, and of q_ld .. d4q_ld.

    compile: as machine code where the machine has a C compiler (numerics.jit); the same numbers to rounding.
    Raises GainsError (see the gains) at birth, StateError for wrong shapes.
    """

    def __init__(self, robot: Robot, gains: Any, compile: bool = False) -> None:
        self.robot = robot
        self.gains = gains
        self.arrays: dict[str, Array] = gains.arrays(robot)
        self.compiles = compile

    @abstractmethod
    def expressions(self, f: Flow, g: SimpleNamespace) -> tuple[ca.SX, ca.SX]:
        """u (n,) [N m] and V, nan where the law has none, of the flow's symbols at x_v = x and the gains g by name."""

    def with_gains(self, gains: Any) -> Baseline:
        """The same law with other gains, whose measured_command is ready at once: nothing is built or compiled.

        Raises GainsError as at birth, and for a matrix with entries off the diagonal where this law's is diagonal.
        """
        other = type(self)(self.robot, gains, self.compiles)
        other._symbols = self._symbols
        other.measured_expression, other.measured_function = self.measured_expression, self.measured_function
        other._gain_values = self._symbols.values(other.arrays)
        return other

    @property
    def gain_values(self) -> Array:
        """The argument `gains` of measured_function."""
        return self._gain_values

    def measured_expressions(self) -> tuple[dict[str, ca.SX], dict[str, ca.SX]]:
        """The arguments of measured_function, and u and V as expressions of them."""
        n = self.robot.n
        f, symbols = flow(self.robot, diagonal=True), self._symbols
        u, V = self.expressions(f, SimpleNamespace(**symbols.symbols))
        position, velocity = ca.SX.sym("position", 2 * n), ca.SX.sym("velocity", 2 * n)
        u, V = f.at_velocities(ca.vertcat(position, velocity), u, V)
        inputs = {"position": position, "velocity": velocity, "jets": f.jets, "gains": symbols.vector}
        return inputs, {"u": u, "V": V}

    @cached_property
    def _symbols(self) -> ArraySymbols:
        return ArraySymbols(self.arrays)

    @cached_property
    def _gain_values(self) -> Array:
        return self._symbols.values(self.arrays)


def effort(robot: Robot, torque: ca.SX) -> ca.SX:
    """u (n,) whose torque on the motors is B_m u."""
    return ca.DM(np.linalg.inv(robot.B_m)) @ torque


def metric(name: str, value: Any, n: int) -> Array:
    """A gain that must be a symmetric positive definite matrix (n, n)."""
    return checks.positive_definite(name, checks.matrix(name, value, n, GainsError), GainsError)


def damping(name: str, value: Any, n: int, own: Array) -> Array:
    """A gain (n, n) that must be symmetric and, with the robot's own damping, positive definite."""
    array = checks.symmetric(name, checks.matrix(name, value, n, GainsError), GainsError)
    checks.positive_definite(f"{name} with the robot's own damping", array + own, GainsError)
    return array


def rate(name: str, value: Any) -> Array:
    """A gain that must be a positive number, as (1,)."""
    array = checks.finite(name, value, GainsError)
    if array.shape != () or not array > 0:
        raise GainsError(f"{name} is {array.tolist()}; expected a positive number")
    return array.reshape(1)
