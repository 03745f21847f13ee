# SPDX-License-Identifier: Apache-2.0
"""Maximise the likelihood over z and the initial states of all segments: Levenberg-Marquardt, variable projection.

A step of z maximises the quadratic model of log L without the initial states, with parameters that are not negative
held so (bounded-variable least squares); the initial states follow it and are settled at the trial point.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.optimize import lsq_linear

from fjr_core.errors import StateError
from fjr_core.numerics.checks import Array

from .multiple_shooting import SOFT, PredictedSegments, Problem

MOST_ITERATIONS = 30
HORIZONS = (16, 4, 1)  # shares of the segments that are compared first
FEW = 24  # segments of the first descent
NEAR, CONVERGED = 1.0, 0.1  # standard deviations from the minimum that the normal equations predict
NEGLIGIBLE = 1e-5  # of the prior's width; a smaller step is rounding, in records without noise
SIMILAR = 0.1  # of the logarithm of noise levels
ROUGHLY, LEAST_DECREASE = 0.5, 1e-2  # of -log L; a descent ends with a step that gains less
STALLED, PATIENCE = 0.01, 3  # share of the decrease that the normal equations predict, and steps in a row below it
ROUNDING = 1e-13  # of the largest eigenvalue; information loses as much where initial states take nearly all of it
HARDEST = 1e3  # damping at which no step is found

Progress = Callable[[float], None]


def optimise(problem: Problem, z: Array, x0: Array, progress: Progress = lambda share: None) -> PredictedSegments:
    """Return the prediction at the most likely z and initial states.

    First on the beginnings of some segments, which are nearly linear in z and in the initial states, then on longer
    parts of them, at last on all. Raises StateError if the prediction of the start is not finite.
    """
    stride = max(1, len(problem.segments) // FEW)
    some, noise = x0[::stride], problem.rough_noise
    for k, share in enumerate(HORIZONS):
        at, _ = descended(problem.part(stride, share), z, some, noise, NEAR, ROUGHLY, _of_stage(progress, k))
        z, some, noise = at.z, at.x0, at.residual
    x0 = some if stride == 1 else x0
    for share in HORIZONS[:-1] if stride > 1 else ():
        part = problem.part(1, share).evaluate(z, x0, noise)
        x0 = x0 if part is None else part.x0
    return refine(problem, z, x0, noise, _of_stage(progress, len(HORIZONS)))


def _of_stage(progress: Progress, stage: int) -> Progress:
    """Return the progress of one of the stages of `optimise`."""
    return lambda share: progress((stage + share) / (len(HORIZONS) + 1))


def refine(
    problem: Problem, z: Array, x0: Array, noise: Array, progress: Progress = lambda share: None
) -> PredictedSegments:
    """Return the prediction at the most likely z and initial states, from start values near them; see `optimise`.

    noise (signals,): near theirs. The prediction is in units of the noise there, unbiased by the estimated numbers.
    """
    at, converged = descended(problem, z, x0, noise, CONVERGED, LEAST_DECREASE, progress)
    count = np.asarray(sum(segment.counts for segment in at.compared)).sum()
    unbiased = at.residual * np.sqrt(count / max(count - at.x0.size - len(at.z), 1))
    best = problem.evaluate(at.z, at.x0, unbiased)
    assert best is not None
    return replace(best, converged=converged)


def descended(
    problem: Problem,
    z: Array,
    x0: Array,
    noise: Array,
    near: float,
    least: float,
    progress: Progress = lambda share: None,
) -> tuple[PredictedSegments, bool]:
    """Return the end of the descent, and whether it is at the minimum; noise (signals,): expected.

    It ends within `near` standard deviations of the minimum, or after a step that lowers -log L by less than `least`,
    or after some that gain next to nothing of what the normal equations predict: the model has a kink there.
    Raises StateError if the prediction of the start is not finite.
    """
    at, damping, stalled = _start(problem, z, x0, noise), SOFT, 0
    for iteration in range(MOST_ITERATIONS):
        away = distance(at)
        progress(iteration / (iteration + np.log1p(away)) if iteration else 0.0)
        step = None if away < near else _search(at, damping)
        if step is None:
            break
        before, (at, damping) = at.cost, step
        stalled = stalled + 1 if before - at.cost < STALLED * away**2 / 2 else 0
        if before - at.cost < least or stalled == PATIENCE:
            break
    negligible = np.max(np.abs(parameter_step(at, 0.0)) / problem.coordinates.width) < NEGLIGIBLE
    return at, bool(distance(at) < NEAR or negligible)


def _start(problem: Problem, z: Array, x0: Array, noise: Array) -> PredictedSegments:
    """Return the prediction at z, in units of the noise there."""
    at = problem.evaluate(z, x0, noise)
    if at is not None and np.max(np.abs(np.log(at.residual / noise))) > SIMILAR:
        at = problem.evaluate(z, at.x0, at.residual)
    if at is None:
        raise StateError("the predicted motion does not stay finite; expected a prior nearer to the robot")
    return at


def _search(at: PredictedSegments, damping: float) -> tuple[PredictedSegments, float] | None:
    """Return a prediction of less cost, and the next damping; None if there is none.

    The first trial moves the initial states to their own minimum, too; a short step of z alone always lowers the cost.
    """
    settled = np.array([part.a for part in at.projected])
    while damping < HARDEST:
        dz = parameter_step(at, damping)
        moved = at.x0 - np.array([part.B @ dz for part in at.projected])
        trial = at.problem.evaluate(at.z + dz, moved + settled, at.residual)
        if trial is not None and trial.cost < at.cost:
            return trial, max(damping / 100, 1e-12)
        settled, damping = np.zeros_like(settled), max(100 * damping, SOFT)
    return None


def parameter_step(at: PredictedSegments, damping: float) -> Array:
    """Return the damped step of z; one beyond twice the prior's width is shortened.

    Friction and damping do not become negative: a motor with negative friction does not stay at rest.
    """
    coordinates = at.problem.coordinates
    dz = bounded_step(*at.normal_equations, at.z, coordinates.nonnegative, damping)
    return np.asarray(dz / max(1.0, float(np.max(np.abs(dz) / coordinates.width, initial=0.0)) / 2))


def distance(at: PredictedSegments) -> float:
    """Return how many standard deviations the minimum of the quadratic model is away from z."""
    H, g = at.normal_equations
    dz = bounded_step(H, g, at.z, at.problem.coordinates.nonnegative)
    return float(np.sqrt(np.maximum(0.0, 2 * float(g @ dz) - float(dz @ H @ dz))))


def bounded_step(H: Array, g: Array, z: Array, bounded: Array, damping: float = 0.0) -> Array:
    """Return the step (p,) that maximises g' step - step' (H + damping diag H) step / 2.

    H (p, p): positive definite but for rounding. z + step is not negative where bounded (p,).
    """
    if not len(z):
        return np.zeros(0)
    scale = np.sqrt(np.diag(H))
    w, V = np.linalg.eigh(H / np.outer(scale, scale) + damping * np.eye(len(z)))
    root, least = np.sqrt(np.maximum(w, ROUNDING * w[-1])), np.where(bounded, -z * scale, -np.inf)
    return np.asarray(lsq_linear((V * root).T, V.T @ (g / scale) / root, (least, np.inf), method="bvls").x / scale)
