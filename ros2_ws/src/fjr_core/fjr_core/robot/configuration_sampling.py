# SPDX-License-Identifier: Apache-2.0
"""The sampled configurations: where rates, gains and sampled loops are looked at when none are given."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..errors import StateError
from ..numerics import checks
from ..numerics.checks import Array
from .robot import Robot

RATE_CONFIGURATIONS = 512  # for rates, which cost little
ALIGNED_CONFIGURATIONS = 512  # as many again for sampled loops, with axes in line


def sample_configurations(robot: Robot, k: int) -> Array:
    """k configurations (k, n) [rad] within the robot's limits (where none are given, within +-pi).

    The first is zero (or what the limits leave nearest to it), the others are the Halton sequence, so that a
    larger set contains every smaller one.
    """
    lower, upper = _bounds(robot)
    halton = np.column_stack([_van_der_corput(k - 1, base) for base in _primes(robot.n)])
    return np.vstack([np.clip(0.0, lower, upper), lower + (upper - lower) * halton])


def loop_configurations(robot: Robot) -> Array:
    """Where a sampled loop is looked at (1024, n) [rad]: the sampled set of rates, and as many with axes in line.

    Axes come into line where joints are at zero, and there links are lightest: in the second half each point of the
    sequence has a random half of its joints put to zero (or what the limits leave nearest to it).
    """
    spread = sample_configurations(robot, RATE_CONFIGURATIONS + ALIGNED_CONFIGURATIONS)
    in_line = np.random.default_rng(0).random((ALIGNED_CONFIGURATIONS, robot.n)) < 0.5
    aligned = np.where(in_line, spread[0], spread[RATE_CONFIGURATIONS:])
    return np.vstack([spread[:RATE_CONFIGURATIONS], aligned])


def checked_configurations(robot: Robot, configurations: ArrayLike | None, k: int | None = None) -> Array:
    """The given configurations as (k, n), or the sampled set of size k (None: of loops); StateError: wrong shape."""
    if configurations is None:
        return sample_configurations(robot, k) if k else loop_configurations(robot)
    samples = checks.finite("configurations", configurations, StateError)
    if samples.ndim != 2 or samples.shape[1] != robot.n or not len(samples):
        raise StateError(f"configurations has shape {samples.shape}; expected (k, {robot.n}) with k at least 1")
    return samples


def _bounds(robot: Robot) -> tuple[Array, Array]:
    limits = getattr(robot, "limits", None)
    if limits is None:
        return np.full(robot.n, -np.pi), np.full(robot.n, np.pi)
    lower = np.where(np.isfinite(limits.lower), limits.lower, np.minimum(-np.pi, limits.upper - np.pi))
    upper = np.where(np.isfinite(limits.upper), limits.upper, np.maximum(np.pi, lower + np.pi))
    return np.where(np.isfinite(lower), lower, -np.pi), np.where(np.isfinite(upper), upper, np.pi)


def _van_der_corput(k: int, base: int) -> Array:
    """The integers 1 .. k with their digits mirrored at the point: k numbers within (0, 1)."""
    rest, weight, values = np.arange(1, k + 1), 1.0, np.zeros(k)
    while rest.any():
        weight /= base
        values += weight * (rest % base)
        rest = rest // base
    return values


def _primes(n: int) -> list[int]:
    primes: list[int] = []
    candidate = 2
    while len(primes) < n:
        if all(candidate % prime for prime in primes):
            primes.append(candidate)
        candidate += 1
    return primes
