# SPDX-License-Identifier: Apache-2.0
"""Maximise the likelihood over z and the initial states of all segments: Levenberg-Marquardt, variable projection.

A step of z maximises the quadratic model of log L without the initial states, with parameters that are not negative
held so (bounded-variable least squares); the initial states follow it and are settled at the trial point.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from fjr_core.errors import StateError
from fjr_core.numerics.checks import Array

from .multiple_shooting import SOFT, Comparison, NormalEquations, Problem
from .parameters import Coordinates

MOST_ITERATIONS = 30
HORIZONS = (16, 4, 1)  # shares of the segments that are compared first
FEW = 24  # segments of the first descent
NEAR, CONVERGED = 1.0, 0.1  # standard deviations from the minimum that the normal equations predict
NEGLIGIBLE = 1e-5  # of the prior's width; a smaller step is rounding, in records without noise
SIMILAR = 0.1  # of the logarithm of noise levels
ROUGHLY, LEAST_DECREASE = 0.5, 1e-2  # of -log L; a descent ends with a step that gains less
HARDEST = 1e3  # damping at which no step is found

Progress = Callable[[float], None]


@dataclass(frozen=True, eq=False)
class Trial:
    """z (p,) with settled initial states (segments, 4n), the comparison of each segment, and -log L."""

    z: Array
    x0: Array
    compared: list[Comparison]
    cost: float

    def projected(self) -> list[NormalEquations]:
        """Return the normal equations of each segment without its initial state."""
        return [segment.projected(self.x0.shape[1]) for segment in self.compared]


@dataclass(frozen=True, eq=False)
class MostLikely:
    """z (p,), initial states (segments, 4n), noise (signals,) and the normal equations there."""

    z: Array
    x0: Array
    noise: Array
    compared: Sequence[Comparison]
    projected: Sequence[NormalEquations]
    converged: bool


def optimise(problem: Problem, z: Array, x0: Array, progress: Progress = lambda share: None) -> MostLikely:
    """Return the most likely z and initial states. Raises StateError if the prediction of the start is not finite.

    First on the beginnings of some segments, which are nearly linear in z and in the initial states, then on longer
    parts of them, at last on all.
    """
    stride = max(1, len(problem.segments) // FEW)
    some, noise = x0[::stride], problem.rough_noise
    for k, share in enumerate(HORIZONS):
        part = problem.part(stride, share)
        trial, _ = descended(part, z, some, noise, NEAR, ROUGHLY, _of_stage(progress, k))
        z, some, noise = trial.z, trial.x0, part.noise(trial.compared)
    x0 = some if stride == 1 else _settled(problem, z, x0, noise)
    return refine(problem, z, x0, noise, _of_stage(progress, len(HORIZONS)))


def _of_stage(progress: Progress, stage: int) -> Progress:
    """Return the progress of one of the stages of `optimise`."""
    return lambda share: progress((stage + share) / (len(HORIZONS) + 1))


def refine(problem: Problem, z: Array, x0: Array, noise: Array, progress: Progress = lambda share: None) -> MostLikely:
    """Return the most likely z and initial states from start values near them; noise (signals,): near theirs.

    Its normal equations are in units of the noise there, unbiased by the estimated numbers.
    """
    at, converged = descended(problem, z, x0, noise, CONVERGED, LEAST_DECREASE, progress)
    count = np.asarray(sum(segment.counts for segment in at.compared)).sum()
    estimated = at.x0.size + len(at.z)
    noise = problem.noise(at.compared) * np.sqrt(count / max(count - estimated, 1))
    again = problem.evaluate(at.z, at.x0, noise)
    assert again is not None
    x0, compared = again
    projected = [segment.projected(x0.shape[1]) for segment in compared]
    return MostLikely(at.z, x0, noise, compared, projected, converged)


def _settled(problem: Problem, z: Array, x0: Array, noise: Array) -> Array:
    """Return initial states that fit longer and longer parts of their segments."""
    for share in HORIZONS[:-1]:
        evaluated = problem.part(1, share).evaluate(z, x0, noise)
        x0 = x0 if evaluated is None else evaluated[0]
    return x0


def descended(
    problem: Problem,
    z: Array,
    x0: Array,
    noise: Array,
    near: float,
    least: float,
    progress: Progress = lambda share: None,
) -> tuple[Trial, bool]:
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


def _start(problem: Problem, z: Array, x0: Array, noise: Array) -> Trial:
    """Return z with settled initial states, in units of the noise there."""
    evaluated = problem.evaluate(z, x0, noise)
    if evaluated is not None and np.max(np.abs(np.log(problem.noise(evaluated[1]) / noise))) > SIMILAR:
        evaluated = problem.evaluate(z, evaluated[0], problem.noise(evaluated[1]))
    if evaluated is None:
        raise StateError("the predicted motion does not stay finite; expected a prior nearer to the robot")
    return Trial(z, *evaluated, problem.cost(evaluated[1], z))


def _search(
    problem: Problem, at: Trial, parts: Sequence[NormalEquations], damping: float
) -> tuple[Trial, float] | None:
    """Return a point of less cost, and the next damping; None if there is none.

    The first trial moves the initial states to their own minimum, too; a short step of z alone always lowers the cost.
    """
    noise, settled = problem.noise(at.compared), np.array([part.a for part in parts])
    while damping < HARDEST:
        dz = parameter_step(problem.coordinates, at.z, parts, damping)
        moved = at.x0 - np.array([part.B @ dz for part in parts])
        trial = problem.evaluate(at.z + dz, moved + settled, noise)
        if trial is not None and (cost := problem.cost(trial[1], at.z + dz)) < at.cost:
            return Trial(at.z + dz, *trial, cost), max(damping / 100, 1e-12)
        settled, damping = np.zeros_like(settled), max(100 * damping, SOFT)
    return None


def _at_minimum(coordinates: Coordinates, at: Trial) -> bool:
    """Return whether the minimum is within NEAR standard deviations, or a NEGLIGIBLE step away."""
    parts = at.projected()
    if distance(coordinates, at.z, parts) < NEAR:
        return True
    step = parameter_step(coordinates, at.z, parts, 0.0)
    return bool(np.max(np.abs(step) / coordinates.width) < NEGLIGIBLE)


def parameter_step(coordinates: Coordinates, z: Array, parts: Sequence[NormalEquations], damping: float) -> Array:
    """Return the damped step of z; one beyond twice the prior's width is shortened.

    Friction and damping do not become negative: a motor with negative friction does not stay at rest.
    """
    H, g = with_prior(coordinates, z, parts)
    dz = bounded_step(H, g, z, coordinates.nonnegative, damping)
    return np.asarray(dz / max(1.0, float(np.max(np.abs(dz) / coordinates.width, initial=0.0)) / 2))


def distance(coordinates: Coordinates, z: Array, parts: Sequence[NormalEquations]) -> float:
    """Return how many standard deviations the minimum of the quadratic model is away from z."""
    H, g = with_prior(coordinates, z, parts)
    dz = bounded_step(H, g, z, coordinates.nonnegative)
    return float(np.sqrt(np.maximum(0.0, 2 * float(g @ dz) - float(dz @ H @ dz))))


def with_prior(coordinates: Coordinates, z: Array, parts: Sequence[NormalEquations]) -> tuple[Array, Array]:
    """Return the information about z with the prior, and the gradient of log L."""
    H = np.asarray(sum(part.H for part in parts)) + np.diag(coordinates.width**-2)
    return H, np.asarray(sum(part.g for part in parts)) - (z - coordinates.mean) / coordinates.width**2


def bounded_step(H: Array, g: Array, z: Array, bounded: Array, damping: float = 0.0) -> Array:
    """Return the step (p,) that maximises g' step - step' (H + damping diag H) step / 2.

    H (p, p): positive definite. z + step is not negative where bounded (p,).
    """
    if not len(z):
        return np.zeros(0)
    scale = np.sqrt(np.diag(H))
    R = np.linalg.cholesky(H / np.outer(scale, scale) + damping * np.eye(len(z))).T
    least = np.where(bounded, -z * scale, -np.inf)
    return np.asarray(lsq_linear(R, np.linalg.solve(R.T, g / scale), (least, np.inf), method="bvls").x / scale)
