# SPDX-License-Identifier: Apache-2.0
"""Fit all parameters to the errors of the filtered equations, by Gauss-Newton: start and fallback of the simulation.

Errors of both sides and of all joints count together, each in units of its deviation, which is estimated with the
parameters. They are coloured; blocks of the record have scores of their own, from which `posterior` widens the
intervals.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from fjr_core.numerics.checks import Array

from .bounded_step import bounded_step
from .equation_error import equation_error
from .estimation_problem import Estimation
from .initial_guess import FilteredMotion, both_sides, decimated, shared
from .judgement import Judgement, judge
from .verdict import not_identifiable

MOST_ITERATIONS = 12
LARGEST_STEP = 1.0  # of the prior's width
CONVERGED = 1e-3  # of the prior's width
LEAST_DEFLECTION = 3.0  # of its noise
NOT_SIMULATED = (
    "unmodelled torques are too large to simulate this joint; the value is from filtered least squares and may be off "
    "by more than the interval"
)


def filtered_fit(
    setup: Estimation,
    motions: Sequence[FilteredMotion],
    z: Array,
    fixed: Collection[int] = (),
    free: Collection[int] = (),
) -> Array:
    """Return z (p,) with the least errors of the equations and the least distance from the prior.

    fixed: entries that keep their prior; so do those that `undetermined` lists, other than `free`.
    """
    fixed = {*fixed, *undetermined(setup, motions)} - {*free}
    z = np.where([k in fixed for k in range(len(z))], setup.coordinates.mean, z)
    mean, width = setup.coordinates.mean, setup.coordinates.width
    bounded = setup.coordinates.nonnegative
    fitted = np.array([k for k in range(len(z)) if k not in fixed], dtype=int)
    for _ in range(MOST_ITERATIONS if len(fitted) else 0):
        parts = equation_error(setup, motions, z)
        H = np.asarray(sum(part.H for part in parts)) + np.diag(width**-2.0)
        g = np.asarray(sum(part.g for part in parts)) - (z - mean) / width**2
        step = np.zeros(len(z))
        step[fitted] = bounded_step(H[np.ix_(fitted, fitted)], g[fitted], z[fitted], bounded[fitted])
        largest = float(np.max(np.abs(step) / width))
        z = z + step / max(1.0, largest / LARGEST_STEP)
        if largest < CONVERGED:
            break
    return z


def filtered_judgement(setup: Estimation, motions: Sequence[FilteredMotion], z: Array) -> Judgement:
    """Return the judgement of a fit z (p,); what is not identifiable keeps its prior. At best weakly identified."""
    nothing = np.zeros((len(z), len(z)))
    parts = equation_error(setup, motions, z)
    fixed = not_identifiable(parts, nothing, setup.coordinates.width, undetermined(setup, motions))
    again = filtered_fit(setup, motions, z, fixed)
    return judge(setup, equation_error(setup, motions, again), nothing, fixed, again, NOT_SIMULATED)


def simulation_start(setup: Estimation, z: Array) -> dict[str, Array]:
    """Return the start values of a simulation from a fit z (p,)."""
    joints = [setup.coordinates.free[k][1] for k in confounded(setup)]
    return shared(setup.coordinates.parameters(z), joints)


def undetermined(setup: Estimation, motions: Sequence[FilteredMotion]) -> tuple[int, ...]:
    """Return the entries that are not fitted: `confounded`, and stiffnesses whose deflection is within its noise."""
    told = [False] * setup.robot.n
    for record, motion in zip(setup.records, motions, strict=True):
        for j in (j for j in range(setup.robot.n) if both_sides(record, j)):
            slow = decimated(motion.q_m[:, j] - motion.q_l[:, j], motion.stride)
            steps = np.diff(record.q_m[:, j] - record.q_l[:, j])
            noise = np.sqrt(np.nanmean(steps**2) / 2 / motion.stride)
            told[j] |= bool(np.std(slow) > LEAST_DEFLECTION * noise)
    names = enumerate(setup.coordinates.free)
    return (*confounded(setup), *(k for k, (name, j) in names if name == "joint_stiffness" and not told[j]))


def confounded(setup: Estimation) -> tuple[int, ...]:
    """Return the entries of link dampings with a free skew: both change a slow deflection alike."""
    free = setup.coordinates.free
    return tuple(k for k, (name, j) in enumerate(free) if name == "link_damping" and ("link_skew", j) in free)
