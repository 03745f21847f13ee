# SPDX-License-Identifier: Apache-2.0
"""Sample configurations for the evaluation of rates, gains and sampled loops."""

from __future__ import annotations

from itertools import count, islice

import numpy as np
from numpy.typing import ArrayLike

from ..errors import StateError
from ..numerics import checks
from ..numerics.checks import Array
from .robot import Robot, check_robot

RATE_CONFIGURATIONS = 512  # for convergence rates
ALIGNED_CONFIGURATIONS = 512  # additional ones for sampled loops, with aligned axes


def sample_configurations(robot: Robot, k: int) -> Array:
    """Return k configurations (k, n) [rad] within the joint limits, or within +-pi without limits.

    The first is zero, clipped to the limits. The others are a Halton sequence, so that a larger set contains every
    smaller one.
    """
    lower, upper = bounds_of(robot)
    primes = islice((p for p in count(2) if all(p % divisor for divisor in range(2, p))), robot.n)
    halton = np.column_stack([_van_der_corput(k - 1, base) for base in primes])
    return np.vstack([np.clip(0.0, lower, upper), lower + (upper - lower) * halton])


def loop_configurations(robot: Robot) -> Array:
    """Return the configurations (1024, n) [rad] for sampled loops: the set for rates, and as many with aligned axes.

    Axes align where joints are at zero, and the link inertia is smallest there. In the second half each point of the
    sequence has a random half of its joints at zero, clipped to the limits.
    """
    sampled = sample_configurations(robot, RATE_CONFIGURATIONS + ALIGNED_CONFIGURATIONS)
    aligns = np.random.default_rng(0).random((ALIGNED_CONFIGURATIONS, robot.n)) < 0.5
    return np.vstack([sampled[:RATE_CONFIGURATIONS], np.where(aligns, sampled[0], sampled[RATE_CONFIGURATIONS:])])


def checked_configurations(robot: Robot, configurations: ArrayLike | None, k: int | None = None) -> Array:
    """Return the given configurations as (k, n), or a sampled set of size k (None: the set for loops).

    Raises StateError for a wrong shape, RobotError for something else than a robot.
    """
    check_robot(robot)
    if configurations is None:
        return sample_configurations(robot, k) if k else loop_configurations(robot)
    samples = checks.finite("configurations", configurations, StateError)
    if samples.ndim != 2 or samples.shape[1] != robot.n or not len(samples):
        raise StateError(f"configurations has shape {samples.shape}; expected (k, {robot.n}) with k at least 1")
    return samples


def bounds_of(robot: Robot) -> tuple[Array, Array]:
    """Return the lower and upper position limits (n,) [rad]; a side without a limit is +-pi, or pi beyond the other."""
    if (limits := robot.limits) is None:
        return np.full(robot.n, -np.pi), np.full(robot.n, np.pi)
    lower = np.where(np.isfinite(limits.lower), limits.lower, np.minimum(-np.pi, limits.upper - np.pi))
    upper = np.where(np.isfinite(limits.upper), limits.upper, np.maximum(np.pi, lower + np.pi))
    return np.where(np.isfinite(lower), lower, -np.pi), np.where(np.isfinite(upper), upper, np.pi)


def _van_der_corput(k: int, base: int) -> Array:
    """Return the first k numbers of the van der Corput sequence in (0, 1)."""
    remainder, weight, values = np.arange(1, k + 1), 1.0, np.zeros(k)
    while remainder.any():
        weight /= base
        values += weight * (remainder % base)
        remainder = remainder // base
    return values
