# SPDX-License-Identifier: Apache-2.0
"""Maximise the likelihood over z and the initial states of all segments, Levenberg-Marquardt with variable projection.

    -log L = sum_i N_i / 2 log s_i^2 + ((z - z_prior) / width)^2 / 2,   s_i: root mean square residual of signal i

The initial states are eliminated segment by segment (Schur complement). G. H. Golub, V. Pereyra, SIAM Journal on
Numerical Analysis 10(2), 1973; H. G. Bock, multiple shooting.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from ..errors import StateError
from ..numerics.checks import Array
from .coordinates import Coordinates
from .segments import Comparison, Segment, compare
from .shooting import Shooting

MOST_ITERATIONS = 60
CONVERGED = 0.03  # standard deviations from the minimum that the normal equations predict
RIDGE = 1e-10  # of the scaled Hessian of an initial state, so that it can be factored
HARDEST = 1e8  # damping at which no step is found


@dataclass(frozen=True, eq=False)
class Projected:
    """Normal equations without the initial state: H (p, p), g (p,), and its step dx = a - B dz."""

    H: Array
    g: Array
    a: Array
    B: Array


@dataclass(frozen=True, eq=False)
class Problem:
    """Segments and signals with the model that predicts them. floor (signals,): least noise, of the encoder's steps."""

    segments: Sequence[Segment]
    shooting: Shooting
    coordinates: Coordinates
    signals: tuple[tuple[str, int], ...]
    floor: Array
    threads: int = 2

    def evaluate(self, z: Array, x0: Array, noise: Array) -> list[Comparison] | None:
        """Return the comparison of each segment, None if one does not stay finite."""

        def one(k: int) -> Comparison | None:
            return compare(self.segments[k], self.shooting, self.coordinates, z, x0[k], self.signals, noise)

        _ = self.shooting.library, self.shooting.function  # compiled in this thread
        with ThreadPoolExecutor(self.threads) as pool:
            found = list(pool.map(one, range(len(self.segments))))
        complete = [each for each in found if each is not None]
        return complete if len(complete) == len(found) else None

    def noise(self, compared: Sequence[Comparison]) -> Array:
        """Return the root mean square residual of each signal (signals,)."""
        squares, counts = (sum(getattr(each, name) for each in compared) for name in ("squares", "counts"))
        return np.asarray(np.maximum(np.sqrt(squares / np.maximum(counts, 1)), self.floor))

    def cost(self, compared: Sequence[Comparison], z: Array) -> float:
        """Return -log L."""
        counts = sum(each.counts for each in compared)
        prior = (z - self.coordinates.mean) / self.coordinates.width
        return float(counts @ np.log(self.noise(compared)) + prior @ prior / 2)


@dataclass(frozen=True, eq=False)
class Optimum:
    """z (p,), initial states (segments, 4n), noise (signals,) and the normal equations there."""

    z: Array
    x0: Array
    noise: Array
    compared: Sequence[Comparison]
    projected: Sequence[Projected]
    converged: bool

    @property
    def information(self) -> Array:
        """Return the information (p, p) of the records about z, without the prior."""
        return np.asarray(sum(each.H for each in self.projected))


def optimise(problem: Problem, z: Array, x0: Array, progress: Callable[[float], None] = lambda share: None) -> Optimum:
    """Return the most likely z and initial states. Raises StateError if the prediction of the start is not finite."""
    compared = problem.evaluate(z, x0, np.ones(len(problem.signals)))
    if compared is None:
        raise StateError("the predicted motion does not stay finite; expected a prior nearer to the robot")
    noise = problem.noise(compared)
    compared = problem.evaluate(z, x0, noise)
    assert compared is not None
    damping, converged = 1e-3, False
    for iteration in range(MOST_ITERATIONS):
        step = _search(problem, z, x0, compared, damping)
        progress(min(1.0, (iteration + 1) / 8))
        if step is None:
            break
        z, x0, compared, damping = step
        if distance(problem.coordinates, z, compared) < CONVERGED:
            converged = True
            break
    return _final(problem, z, x0, compared, converged)


def _search(
    problem: Problem, z: Array, x0: Array, compared: list[Comparison], damping: float
) -> tuple[Array, Array, list[Comparison], float] | None:
    """Return z, initial states and comparison after a step that lowers the cost, and the next damping."""
    noise, cost = problem.noise(compared), problem.cost(compared, z)
    while damping < HARDEST:
        parts = [project(each, x0.shape[1], damping) for each in compared]
        dz = _step(problem.coordinates, z, parts, damping)
        x_new = x0 + np.array([part.a - part.B @ dz for part in parts])
        trial = problem.evaluate(z + dz, x_new, noise)
        if trial is not None and problem.cost(trial, z + dz) < cost + 1e-6:
            return z + dz, x_new, trial, max(damping / 10, 1e-12)
        damping *= 10
    return None


def _final(problem: Problem, z: Array, x0: Array, compared: Sequence[Comparison], converged: bool) -> Optimum:
    """Return the optimum with normal equations in units of the noise there, unbiased by the estimated numbers."""
    counts = np.asarray(sum(each.counts for each in compared))
    estimated = x0.size + len(z)
    noise = problem.noise(compared) * np.sqrt(counts.sum() / max(counts.sum() - estimated, 1))
    again = problem.evaluate(z, x0, noise)
    assert again is not None
    return Optimum(z, x0, noise, again, [project(each, x0.shape[1]) for each in again], converged)


def project(compared: Comparison, size: int, damping: float = 0.0) -> Projected:
    """Eliminate the initial state (size,), whose step is damped, from the normal equations of a segment."""
    scale = np.sqrt(np.diag(compared.H)[:size])
    scale = np.where(scale > 0, scale, 1.0)
    factor = cho_factor(compared.H[:size, :size] / np.outer(scale, scale) + (RIDGE + damping) * np.eye(size))
    across, g = compared.H[:size, size:], compared.g
    B = cho_solve(factor, across / scale[:, None]) / scale[:, None]
    a = cho_solve(factor, g[:size] / scale) / scale
    return Projected(compared.H[size:, size:] - across.T @ B, g[size:] - across.T @ a, a, B)


def _step(coordinates: Coordinates, z: Array, parts: Sequence[Projected], damping: float) -> Array:
    """Return the damped step of z; one beyond twice the prior's width is shortened."""
    H, g = _normal_equations(coordinates, z, parts)
    scale = np.sqrt(np.diag(H))
    dz = np.linalg.solve(H / np.outer(scale, scale) + damping * np.eye(len(z)), g / scale) / scale
    return np.asarray(dz / max(1.0, float(np.max(np.abs(dz) / coordinates.width, initial=0.0)) / 2))


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
