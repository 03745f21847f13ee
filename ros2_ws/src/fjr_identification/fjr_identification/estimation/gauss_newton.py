# SPDX-License-Identifier: Apache-2.0
"""Maximise the likelihood over z and the initial states of all segments: Levenberg-Marquardt, variable projection."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fjr_core.errors import StateError
from fjr_core.numerics.checks import Array

from .coordinates import Coordinates
from .multiple_shooting import ROUGH, SOFT, Problem
from .segments import Comparison
from .variable_projection import Projected, distance, parameter_step, project

MOST_ITERATIONS = 30
HORIZONS = (16, 4, 1)  # shares of the segments that are compared first
FEW = 24  # segments of the first descent
NEAR, CONVERGED = 1.0, 0.1  # standard deviations from the minimum that the normal equations predict
NEGLIGIBLE = 1e-5  # of the prior's width; a smaller step is rounding, in records without noise
SIMILAR = 0.1  # of the logarithm of noise levels
ROUGHLY, LEAST_DECREASE = 0.5, 1e-2  # of -log L; a descent ends with a step that gains less
HARDEST = 1e3  # damping at which no step is found


@dataclass(frozen=True, eq=False)
class Point:
    """z (p,) with settled initial states (segments, 4n), the comparison of each segment, and -log L."""

    z: Array
    x0: Array
    compared: list[Comparison]
    cost: float

    def projected(self) -> list[Projected]:
        """Return the normal equations of each segment without its initial state."""
        return [project(each, self.x0.shape[1]) for each in self.compared]


@dataclass(frozen=True, eq=False)
class Optimum:
    """z (p,), initial states (segments, 4n), noise (signals,) and the normal equations there."""

    z: Array
    x0: Array
    noise: Array
    compared: Sequence[Comparison]
    projected: Sequence[Projected]
    converged: bool


def optimise(problem: Problem, z: Array, x0: Array, progress: Callable[[float], None] = lambda share: None) -> Optimum:
    """Return the most likely z and initial states. Raises StateError if the prediction of the start is not finite.

    First on the beginnings of some segments, which are nearly linear in z and in the initial states, then on longer
    parts of them, at last on all.
    """
    stride = max(1, len(problem.segments) // FEW)
    some, noise = x0[::stride], np.maximum(problem.floor, ROUGH)
    for k, share in enumerate(HORIZONS):
        part = problem.part(stride, share)
        found, _ = descended(part, z, some, noise, NEAR, ROUGHLY, _scaled(progress, k, len(HORIZONS)))
        z, some, noise = found.z, found.x0, part.noise(found.compared)
    x0 = some if stride == 1 else _settled(problem, z, x0, noise)
    return refine(problem, z, x0, noise, _scaled(progress, len(HORIZONS), len(HORIZONS)))


def refine(
    problem: Problem, z: Array, x0: Array, noise: Array, progress: Callable[[float], None] = lambda share: None
) -> Optimum:
    """Return the most likely z and initial states from start values near them; noise (signals,): near theirs."""
    return _final(problem, *descended(problem, z, x0, noise, CONVERGED, LEAST_DECREASE, progress))


def _scaled(progress: Callable[[float], None], stage: int, stages: int) -> Callable[[float], None]:
    """Return the progress of a stage of stages + 1."""
    return lambda share: progress((stage + share) / (stages + 1))


def _settled(problem: Problem, z: Array, x0: Array, noise: Array) -> Array:
    """Return initial states that fit longer and longer parts of their segments."""
    for share in HORIZONS[:-1]:
        part = problem.part(1, share)
        found = part.evaluate(z, x0, noise)
        x0 = x0 if found is None else found[0]
    return x0


def descended(
    problem: Problem,
    z: Array,
    x0: Array,
    noise: Array,
    near: float,
    least: float,
    progress: Callable[[float], None] = lambda share: None,
) -> tuple[Point, bool]:
    """Return the end of the descent, and whether it is at the minimum; noise (signals,): expected.

    It ends within `near` standard deviations of the minimum, or after a step that lowers -log L by less than `least`.
    Raises StateError if the prediction of the start is not finite.
    """
    at, damping = _start(problem, z, x0, noise), SOFT
    for iteration in range(MOST_ITERATIONS):
        parts = at.projected()
        away = distance(problem.coordinates, at.z, parts)
        progress(iteration / (iteration + np.log1p(away)) if iteration else 0.0)
        step = None if away < near else _search(problem, at, parts, damping)
        if step is None:
            break
        before, (at, damping) = at.cost, step
        if before - at.cost < least:
            break
    return at, _at_minimum(problem.coordinates, at)


def _start(problem: Problem, z: Array, x0: Array, noise: Array) -> Point:
    """Return z with settled initial states, in units of the noise there."""
    found = problem.evaluate(z, x0, noise)
    if found is not None and np.max(np.abs(np.log(problem.noise(found[1]) / noise))) > SIMILAR:
        found = problem.evaluate(z, found[0], problem.noise(found[1]))
    if found is None:
        raise StateError("the predicted motion does not stay finite; expected a prior nearer to the robot")
    return Point(z, *found, problem.cost(found[1], z))


def _search(problem: Problem, at: Point, parts: Sequence[Projected], damping: float) -> tuple[Point, float] | None:
    """Return a point of less cost, and the next damping; None if there is none.

    The first trial moves the initial states to their own minimum, too; a short step of z alone always lowers the cost.
    """
    noise, settled = problem.noise(at.compared), np.array([part.a for part in parts])
    while damping < HARDEST:
        dz = parameter_step(problem.coordinates, at.z, parts, damping)
        moved = at.x0 - np.array([part.B @ dz for part in parts])
        trial = problem.evaluate(at.z + dz, moved + settled, noise)
        if trial is not None and (cost := problem.cost(trial[1], at.z + dz)) < at.cost:
            return Point(at.z + dz, *trial, cost), max(damping / 100, 1e-12)
        settled, damping = np.zeros_like(settled), max(100 * damping, SOFT)
    return None


def _at_minimum(coordinates: Coordinates, at: Point) -> bool:
    """Return whether the minimum is within NEAR standard deviations, or a NEGLIGIBLE step away."""
    parts = at.projected()
    if distance(coordinates, at.z, parts) < NEAR:
        return True
    step = parameter_step(coordinates, at.z, parts, 0.0)
    return bool(np.max(np.abs(step) / coordinates.width) < NEGLIGIBLE)


def _final(problem: Problem, at: Point, converged: bool) -> Optimum:
    """Return the optimum with normal equations in units of the noise there, unbiased by the estimated numbers."""
    counts = np.asarray(sum(each.counts for each in at.compared))
    estimated = at.x0.size + len(at.z)
    noise = problem.noise(at.compared) * np.sqrt(counts.sum() / max(counts.sum() - estimated, 1))
    again = problem.evaluate(at.z, at.x0, noise)
    assert again is not None
    x0, compared = again
    projected = [project(each, x0.shape[1]) for each in compared]
    return Optimum(at.z, x0, noise, compared, projected, converged)
