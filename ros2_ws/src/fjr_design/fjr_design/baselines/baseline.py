# SPDX-License-Identifier: Apache-2.0
"""Base classes of the baseline laws: symbolic gains and expressions of u and V, of some with an observer of their own.

A law with an observer is u(x, x, t) with exact estimates as a static law, and a SampledLaw as it is run.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np

from fjr_core.errors import GainsError
from fjr_core.law.interfaces import StaticLaw
from fjr_core.law.lie_derivative import Flow, flow
from fjr_core.model.robot import Robot
from fjr_core.numerics import checks
from fjr_core.numerics.checks import Array
from fjr_core.numerics.symbolic import PackedVector, dense_function
from fjr_core.robust.law import RobustLaw
from fjr_core.robust.options import Robust


class Baseline(StaticLaw):
    """A baseline law of a robot: u and V as functions of the measured motion and of q_ld .. d4q_ld.

    compile: compile to machine code if a C compiler is available (numerics.jit); results agree to rounding.
    Raises GainsError (see the gains) on construction and StateError for wrong shapes.
    """

    def __init__(self, robot: Robot, gains: Any, compile: bool = False) -> None:
        if robot.curve:
            raise GainsError(
                f"{type(self).__name__} is given springs with a {robot.curve}, which it does not know; expected the "
                "law v_dpbc, or a robot with straight springs"
            )
        super().__init__(robot, gains, compile)

    @abstractmethod
    def expressions(self, f: Flow, g: SimpleNamespace) -> tuple[ca.SX, ca.SX]:
        """Return u (n,) [N m] and V [J] (nan without a storage) in the symbols of the flow f at x_v = x and gains g."""

    def measured_expressions(self) -> tuple[dict[str, ca.SX], dict[str, ca.SX]]:
        """Return the arguments of `function`, and expressions of u and V."""
        f = flow(self.robot, diagonal=True)
        u, V = self.expressions(f, SimpleNamespace(**self.symbols.by_name))
        return self.at_measured(f, {"u": u, "V": V})


class ObservedBaseline(Baseline):
    """A baseline that estimates torques. As a static law, the estimates are those of the exact model.

    memory_sizes: sizes of the parts of the observer's state by name.
    """

    memory_sizes: Mapping[str, int]

    @abstractmethod
    def observe(
        self, kept: SimpleNamespace, s: SimpleNamespace, g: SimpleNamespace
    ) -> tuple[ca.SX, ca.SX, dict[str, ca.SX]]:
        """Return u (n,) [N m], V [J] and the next memory.

        kept: memory, not yet set at the first sample, where s.dt = 0. s: symbols of interfaces.ARGUMENTS. g: gains.
        """

    @property
    def sampled(self) -> ObservedLaw:
        """The law with its observer."""
        return ObservedLaw(self, Robust())


class ObservedLaw(RobustLaw):
    """A baseline with its observer, as a SampledLaw; the robust action is off."""

    law: ObservedBaseline

    @property
    def memory(self) -> Array:
        """Initial state of the observer: zeros, set by the first sample."""
        return np.zeros(PackedVector(self.law.memory_sizes).size)

    @cached_property
    def step_function(self) -> ca.Function:
        """SampledLaw.step_function."""
        law, packed = self.law, PackedVector(self.law.memory_sizes)
        s = {name: ca.SX.sym(name, *symbol.shape) for name, symbol in self.step_symbols().items()}
        s["gains"] = law.symbols.vector
        given = packed.named(s["memory"]), SimpleNamespace(**s), SimpleNamespace(**law.symbols.by_name)
        u, V, kept = law.observe(*given)
        return dense_function("observed_law", s, {"u": u, "V": V, "next": packed.pack(kept)}, cse=True)


def effort(robot: Robot, torque: ca.SX) -> ca.SX:
    """Return the effort u (n,) [N m] for a motor torque B_m u (n,) [N m]."""
    return ca.DM(np.linalg.inv(robot.B_m)) @ torque


def metric(name: str, value: Any, n: int) -> Array:
    """Return the gain as a matrix (n, n); raise GainsError unless it is symmetric positive definite."""
    return checks.positive_definite(name, checks.matrix(name, value, n, GainsError), GainsError)


def damping(name: str, value: Any, n: int, own: Array) -> Array:
    """Return the gain as a symmetric matrix (n, n).

    Raises GainsError unless gain + own is positive definite; own (n, n): damping of the robot.
    """
    array = checks.symmetric(name, checks.matrix(name, value, n, GainsError), GainsError)
    checks.positive_definite(f"{name} with the robot's own damping", array + own, GainsError)
    return array


def rate(name: str, value: Any) -> Array:
    """Return the gain as (1,); raise GainsError unless it is a positive number."""
    array = checks.finite(name, value, GainsError)
    if array.shape != () or not array > 0:
        raise GainsError(f"{name} is {array.tolist()}; expected a positive number")
    return array.reshape(1)
