# SPDX-License-Identifier: Apache-2.0
"""Maximise the likelihood over z and the initial states of all segments, Levenberg-Marquardt with variable projection.

    -log L = sum_i N_i / 2 log s_i^2 + ((z - z_prior) / width)^2 / 2,   s_i: root mean square residual of signal i

The initial states are eliminated segment by segment (Schur complement). G. H. Golub, V. Pereyra, SIAM Journal on
Numerical Analysis 10(2), 1973; H. G. Bock, multiple shooting.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from ..errors import StateError
from ..numerics.checks import Array
from .coordinates import Coordinates
from .segments import Comparison, Segment, compare
from .shooting import Shooting

MOST_ITERATIONS = 30
FEWEST = 25  # samples that are compared of a segment
HORIZONS = (16, 4, 1)  # shares of the segments that are compared first
FEW = 24  # segments of the first descent
NEAR, CONVERGED = 1.0, 0.1  # standard deviations from the minimum that the normal equations predict
NEGLIGIBLE = 1e-5  # of the prior's width; a smaller step is rounding, in records without noise
SOFT = 1e-6  # damping of the first step
SETTLED = 0.02  # decrease of the sum of squares, in units of the noise, that a step of an initial state is worth
SHARE = 1e-4  # of the sum of squares: a smaller decrease is left to the next step of z
MOST_SETTLING = 8
SIMILAR = 0.1  # of the logarithm of noise levels
ROUGH = 1e-4  # rad, N m; noise that is assumed before residuals are known
RIDGE = 1e-10  # of the scaled Hessian of an initial state, so that it can be factored
LEAST_DECREASE = 1e-3  # of -log L, of a step after which others are tried
HARDEST = 1e3  # damping at which no step is found


@dataclass(frozen=True, eq=False)
class Projected:
    """Normal equations without the initial state: H (p, p), g (p,), and its step dx = a - B dz."""

    H: Array
    g: Array
    a: Array
    B: Array


@dataclass(frozen=True, eq=False)
class Problem:
    """Segments and signals with the model that predicts them. floor (signals,): least noise, of the encoder's steps.

    filtered (segments, 4n), state_width (4n,): weak normal prior of the initial states, which keeps states that are not
    measured within reach where the model is wrong.
    """

    segments: Sequence[Segment]
    shooting: Shooting
    coordinates: Coordinates
    signals: tuple[tuple[str, int], ...]
    floor: Array
    filtered: Array
    state_width: Array
    threads: int = 2

    def part(self, stride: int, share: int) -> Problem:
        """Return the problem of the first 1 / share, at least FEWEST samples, of every `stride`-th segment."""
        counts = [max(each.count // share, min(each.count, FEWEST)) for each in self.segments[::stride]]
        segments = [each.shortened(count) for each, count in zip(self.segments[::stride], counts, strict=True)]
        return replace(self, segments=segments, filtered=self.filtered[::stride])

    def evaluate(self, z: Array, x0: Array, noise: Array) -> tuple[Array, list[Comparison]] | None:
        """Return settled initial states and the comparison of each segment, None if one does not stay finite."""
        _ = self.shooting.library, self.shooting.function  # compiled in this thread
        with ThreadPoolExecutor(self.threads) as pool:
            found = list(pool.map(lambda k: self._settle(k, z, x0[k], noise), range(len(self.segments))))
        complete = [each for each in found if each is not None]
        if len(complete) < len(found):
            return None
        return np.array([x for x, _ in complete]), [compared for _, compared in complete]

    def _settle(self, k: int, z: Array, x: Array, noise: Array) -> tuple[Array, Comparison] | None:
        """Return the most likely initial state of a segment at z, by Levenberg-Marquardt, and the comparison there."""
        compared, damping, size = self.compare(k, z, x, noise), SOFT, len(x)
        for _ in range(MOST_SETTLING):
            if compared is None:
                return None
            dx, decrease = state_step(compared, size, damping)
            if decrease < max(SETTLED, SHARE * _weighted(compared, noise)):
                return x, compared
            trial, before = self.compare(k, z, x + dx, noise), _weighted(compared, noise)
            gain = before - _weighted(trial, noise) if trial is not None else -1.0
            if trial is not None and gain >= 0:
                x, compared = x + dx, trial
            damping *= 0.1 if gain > decrease / 2 else 1.0 if gain >= 0 else 100.0
        return None if compared is None else (x, compared)

    def compare(self, k: int, z: Array, x: Array, noise: Array) -> Comparison | None:
        """Return the comparison of segment k at z and the initial state x (4n,)."""
        found = compare(self.segments[k], self.shooting, self.coordinates, z, x, self.signals, noise)
        if found is None:
            return None
        size, away = len(x), (x - self.filtered[k]) / self.state_width
        found.H[range(size), range(size)] += self.state_width**-2
        found.g[:size] -= away / self.state_width
        return replace(found, penalty=float(away @ away))

    def noise(self, compared: Sequence[Comparison]) -> Array:
        """Return the root mean square residual of each signal (signals,)."""
        squares, counts = (sum(getattr(each, name) for each in compared) for name in ("squares", "counts"))
        return np.asarray(np.maximum(np.sqrt(squares / np.maximum(counts, 1)), self.floor))

    def cost(self, compared: Sequence[Comparison], z: Array) -> float:
        """Return -log L."""
        counts = sum(each.counts for each in compared)
        prior = (z - self.coordinates.mean) / self.coordinates.width
        states = sum(each.penalty for each in compared)
        return float(counts @ np.log(self.noise(compared)) + (prior @ prior + states) / 2)


@dataclass(frozen=True, eq=False)
class Optimum:
    """z (p,), initial states (segments, 4n), noise (signals,) and the normal equations there.

    chance (p, p): information about z that initial states seem to give because they fit noise; it tells nothing.
    """

    z: Array
    x0: Array
    noise: Array
    compared: Sequence[Comparison]
    projected: Sequence[Projected]
    chance: Array
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
        stage = _scaled(progress, k, len(HORIZONS))
        z, some, compared, _ = descended(part, z, some, NEAR, stage, noise=noise)
        noise = part.noise(compared)
    x0 = some if stride == 1 else _settled(problem, z, x0, noise)
    return refine(problem, z, x0, noise, _scaled(progress, len(HORIZONS), len(HORIZONS)))


def refine(
    problem: Problem, z: Array, x0: Array, noise: Array, progress: Callable[[float], None] = lambda share: None
) -> Optimum:
    """Return the most likely z and initial states from start values near them; noise (signals,): near theirs."""
    return _final(problem, *descended(problem, z, x0, CONVERGED, progress, noise=noise))


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
    near: float,
    progress: Callable[[float], None] = lambda share: None,
    iterations: int | None = None,
    noise: Array | None = None,
) -> tuple[Array, Array, list[Comparison], bool]:
    """Return z, initial states and comparison, and whether they are at the minimum.

    near: distance at which the descent ends. iterations: at most; None: MOST_ITERATIONS. noise (signals,): expected.
    Raises StateError if the prediction of the start is not finite.
    """
    noise = np.maximum(problem.floor, ROUGH) if noise is None else noise
    start = problem.evaluate(z, x0, noise)
    if start is not None and np.max(np.abs(np.log(problem.noise(start[1]) / noise))) > SIMILAR:
        start = problem.evaluate(z, start[0], problem.noise(start[1]))
    if start is None:
        raise StateError("the predicted motion does not stay finite; expected a prior nearer to the robot")
    (x0, compared), damping = start, SOFT
    for iteration in range(MOST_ITERATIONS if iterations is None else iterations):
        away = distance(problem.coordinates, z, compared)
        progress(iteration / (iteration + np.log1p(away)) if iteration else 0.0)
        step = None if away < near else _search(problem, z, x0, compared, damping)
        if step is None:
            break
        before = problem.cost(compared, z)
        z, x0, compared, damping = step
        if before - problem.cost(compared, z) < LEAST_DECREASE:
            break
    return z, x0, compared, _at_minimum(problem.coordinates, z, compared)


def _search(
    problem: Problem, z: Array, x0: Array, compared: list[Comparison], damping: float
) -> tuple[Array, Array, list[Comparison], float] | None:
    """Return z, initial states and comparison after a step that lowers the cost, and the next damping.

    The first trial moves the initial states to their own minimum, too; a short step of z alone always lowers the cost.
    """
    noise, cost = problem.noise(compared), problem.cost(compared, z)
    parts = [project(each, x0.shape[1]) for each in compared]
    settled = np.array([part.a for part in parts])
    while damping < HARDEST:
        dz = _step(problem.coordinates, z, parts, damping)
        moved = x0 - np.array([part.B @ dz for part in parts])
        trial = problem.evaluate(z + dz, moved + settled, noise)
        if trial is not None and problem.cost(trial[1], z + dz) < cost:
            return z + dz, *trial, max(damping / 100, 1e-12)
        settled, damping = np.zeros_like(settled), max(100 * damping, SOFT)
    return None


def _final(problem: Problem, z: Array, x0: Array, compared: Sequence[Comparison], converged: bool) -> Optimum:
    """Return the optimum with normal equations in units of the noise there, unbiased by the estimated numbers."""
    counts = np.asarray(sum(each.counts for each in compared))
    estimated = x0.size + len(z)
    noise = problem.noise(compared) * np.sqrt(counts.sum() / max(counts.sum() - estimated, 1))
    again = problem.evaluate(z, x0, noise)
    assert again is not None
    x0, compared = again
    projected = [project(each, x0.shape[1]) for each in compared]
    return Optimum(z, x0, noise, compared, projected, _chance(problem, z, x0, noise, compared, projected), converged)


def _chance(
    problem: Problem, z: Array, x0: Array, noise: Array, compared: Sequence[Comparison], projected: Sequence[Projected]
) -> Array:
    """Return by how much the information (p, p) grows when initial states are disturbed by their own uncertainty.

    A spring at rest, for instance, seems to swing with the noise, at a frequency that seems to tell its stiffness.
    Disturbances come with both signs, so that what is linear in them cancels. No segment loses more than it tells.
    """
    random, size = np.random.default_rng(0), x0.shape[1]
    draws, found = max(1, FEW // len(x0)), np.zeros_like(projected[0].H)
    for k, (x, each, own) in enumerate(zip(x0, compared, projected, strict=True)):
        scale, (factor, lower) = _state_factor(each, size, 0.0)
        growth = np.zeros_like(found)
        for normal in random.standard_normal((draws, size)):
            dx = solve_triangular(factor, normal, trans=0 if lower else 1, lower=lower) / scale
            pair = [problem.compare(k, z, x + sign * dx, noise) for sign in (1, -1)]
            complete = [project(each, size).H for each in pair if each is not None]
            if len(complete) == len(pair):
                growth += (sum(complete) / 2 - own.H) / draws
        told, grown = np.maximum(np.diag(own.H), 0.0), np.diag(growth)
        limit = np.sqrt(np.where(grown > told, told / np.where(grown > 0, grown, 1.0), 1.0))
        found += growth * np.outer(limit, limit)
    return found


def project(compared: Comparison, size: int) -> Projected:
    """Eliminate the initial state (size,) from the normal equations of a segment."""
    scale, factor = _state_factor(compared, size, 0.0)
    across, g = compared.H[:size, size:], compared.g
    B = cho_solve(factor, across / scale[:, None]) / scale[:, None]
    a = cho_solve(factor, g[:size] / scale) / scale
    return Projected(compared.H[size:, size:] - across.T @ B, g[size:] - across.T @ a, a, B)


def state_step(compared: Comparison, size: int, damping: float) -> tuple[Array, float]:
    """Return the damped step of the initial state (size,), and by how much it lowers the sum of squares."""
    scale, factor = _state_factor(compared, size, damping)
    dx = cho_solve(factor, compared.g[:size] / scale) / scale
    return dx, float(dx @ compared.g[:size])


def _state_factor(compared: Comparison, size: int, damping: float) -> tuple[Array, Any]:
    scale = np.sqrt(np.diag(compared.H)[:size])
    scale = np.where(scale > 0, scale, 1.0)
    H = compared.H[:size, :size] / np.outer(scale, scale)
    return scale, cho_factor(H + (RIDGE + damping) * np.eye(size))


def _weighted(compared: Comparison, noise: Array) -> float:
    return float(np.sum(compared.squares / noise**2)) + compared.penalty


def _step(coordinates: Coordinates, z: Array, parts: Sequence[Projected], damping: float) -> Array:
    """Return the damped step of z; one beyond twice the prior's width is shortened."""
    H, g = _normal_equations(coordinates, z, parts)
    scale = np.sqrt(np.diag(H))
    dz = np.linalg.solve(H / np.outer(scale, scale) + damping * np.eye(len(z)), g / scale) / scale
    return np.asarray(dz / max(1.0, float(np.max(np.abs(dz) / coordinates.width, initial=0.0)) / 2))


def _at_minimum(coordinates: Coordinates, z: Array, compared: Sequence[Comparison]) -> bool:
    """Return whether the minimum is within NEAR standard deviations, or a NEGLIGIBLE step away."""
    if distance(coordinates, z, compared) < NEAR:
        return True
    size = len(compared[0].g) - len(z)
    step = _step(coordinates, z, [project(each, size) for each in compared], 0.0)
    return bool(np.max(np.abs(step) / coordinates.width) < NEGLIGIBLE)


def distance(coordinates: Coordinates, z: Array, compared: Sequence[Comparison]) -> float:
    """Return how many standard deviations the minimum of the quadratic model is away from z."""
    if not len(z):
        return 0.0
    size = len(compared[0].g) - len(z)
    H, g = _normal_equations(coordinates, z, [project(each, size) for each in compared])
    scale = np.sqrt(np.diag(H))
    return float(np.sqrt(max(0.0, (g / scale) @ np.linalg.solve(H / np.outer(scale, scale), g / scale))))


def _normal_equations(coordinates: Coordinates, z: Array, parts: Sequence[Projected]) -> tuple[Array, Array]:
    """Return the information about z with the prior, and the gradient of log L."""
    H = np.asarray(sum(part.H for part in parts)) + np.diag(coordinates.width**-2)
    return H, np.asarray(sum(part.g for part in parts)) - (z - coordinates.mean) / coordinates.width**2
