# SPDX-License-Identifier: Apache-2.0
"""Collect what a check finds, sample random states, and differentiate along a direction."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..errors import FjrError
from ..model.robot import Robot
from ..numerics.checks import Array

STEP = 1e-5
"""Step of central differences, relative to the direction."""
RELATIVE = 1e-6
"""Largest violation of an inequality, relative to its terms, that counts as rounding."""
REACH = 3.0  # rad; positions without limits
SPRING = 0.1  # rad; deflections of the joints


class CheckError(FjrError, AssertionError):
    """A check found faults; `faults` has one sentence for each."""

    def __init__(self, title: str, faults: Sequence[str]) -> None:
        super().__init__("\n".join(f"{title}: {fault}" for fault in faults))
        self.faults = tuple(faults)


class Findings:
    """Sentences of a check: what holds, and the faults."""

    def __init__(self, title: str) -> None:
        self.title = title
        self.holds: list[str] = []
        self.faults: list[str] = []

    def add(self, fault: str, holds: str) -> None:
        """Add the fault, or what holds if it is empty."""
        if fault:
            self.faults.append(fault)
        else:
            self.holds.append(holds)

    def add_repetition(self, once: Sequence[Array], again: Sequence[Array]) -> None:
        """Add whether the results of a second evaluation at the same arguments are those of the first."""
        gap = max(differs(first, second) for first, second in zip(once, again, strict=True))
        fault = f"a second evaluation at the same state differs by {gap:.3g}; expected a pure function, without memory"
        self.add(fault if gap else "", "the result depends on the arguments only")

    def result(self) -> tuple[str, ...]:
        """Return what holds; raise CheckError if there are faults."""
        if self.faults:
            raise CheckError(self.title, self.faults)
        return tuple(self.holds)


def random_states(robot: Robot, count: int, rng: np.random.Generator) -> Array:
    """Return states x (k, 4n): links within their limits, deflections up to SPRING, speeds up to 1 rad/s."""
    n = robot.n
    low, high = np.full(n, -REACH), np.full(n, REACH)
    if robot.limits is not None:
        low, high = np.maximum(low, robot.limits.lower), np.minimum(high, robot.limits.upper)
    q_l = rng.uniform(low, high, (count, n))
    q_m, speeds = q_l + rng.uniform(-SPRING, SPRING, (count, n)), rng.uniform(-1.0, 1.0, (count, 2, n))
    return np.array([robot.state(q, motor, *v) for q, motor, v in zip(q_l, q_m, speeds, strict=True)])


def slope(f: Callable[[float], float]) -> float:
    """Return df/ds at 0 by the central difference of order 4."""
    near, far = (f(h * STEP) - f(-h * STEP) for h in (1, 2))
    return (8 * near - far) / (12 * STEP)


def differs(first: Array, again: Array) -> float:
    """Return the largest difference of two arrays; nan equals nan, and differs infinitely from numbers."""
    same = (first == again) | (np.isnan(first) & np.isnan(again))
    with np.errstate(invalid="ignore"):  # inf - inf
        gap = np.where(same, 0.0, np.nan_to_num(np.abs(first - again), nan=np.inf))
    return float(np.max(gap, initial=0.0))


def rounded(values: Array) -> str:
    """Return an array for a sentence."""
    return str([float(f"{value:.4g}") for value in np.ravel(values)])
