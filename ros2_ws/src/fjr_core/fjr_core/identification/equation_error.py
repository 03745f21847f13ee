# SPDX-License-Identifier: Apache-2.0
"""Intervals of filtered least squares, for joints whose simulated motion does not fit the records.

    link side    r = q_m - q_l - offset - (tau_rigid + D_l v_l + F_l tanh(v_l / v_0)) / K
    motor side   r = u(t - delay) - tau - B a_m - D_m v_m - F_m tanh(v_m / v_0)

The errors r of the equations need no simulation, so a slow torque that the model lacks does not add up. They are
coloured; blocks of the record have scores of their own, from which `posterior` widens the intervals.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from ..numerics.checks import Array
from .estimation_problem import Estimation
from .gauss_newton import Projected
from .initial_guess import FilteredMotion, both_sides, link_rows, motor_rows
from .judgement import Judgement, judge
from .verdict import not_identifiable

LINK = ("joint_stiffness", "link_damping", "link_coulomb_friction", "offset", "link_skew")
MOTOR = ("motor_inertia", "motor_damping", "motor_coulomb_friction", "effort_delay", "link_damping")
BLOCK = 1.0  # s; longer than the correlation of the errors
FEWEST_BLOCKS = 4
STEP = 1e-2  # of the prior's width, of the differences
NOT_SIMULATED = (
    "the simulated motion does not fit the records, so that filtered least squares give this value; errors of the "
    "model may exceed the interval"
)
PRIOR = ("joint_stiffness", "motor_inertia", "link_damping")  # the start may keep their prior, which tells nothing

Errors = Callable[[Mapping[str, Array]], Array]


def filtered_judgement(setup: Estimation, motions: Sequence[FilteredMotion], z: Array) -> Judgement:
    """Return the judgement of the start values z (p,) by filtered least squares, at best weakly identified."""
    free, mean, nothing = setup.coordinates.free, setup.coordinates.mean, np.zeros((len(z), len(z)))
    as_before = [k for k, (name, _) in enumerate(free) if name in PRIOR and np.isclose(z[k], mean[k], rtol=1e-9)]
    parts = equation_error(setup, motions, z)
    fixed = not_identifiable(parts, nothing, setup.coordinates.width, as_before)
    return judge(setup, parts, nothing, fixed, z, NOT_SIMULATED)


def equation_error(setup: Estimation, motions: Sequence[FilteredMotion], z: Array) -> list[Projected]:
    """Return the normal equations by z (p,) of each block of the records, in units of the errors' deviation at z."""
    sides = [_side(setup, motions, z, j, names) for j in range(setup.robot.n) for names in (LINK, MOTOR)]
    parts = []
    for number, motion in enumerate(motions):
        blocks = max(FEWEST_BLOCKS, round(len(motion.u) * motion.dt / BLOCK))
        found = [
            Projected(np.zeros((len(z), len(z))), np.zeros(len(z)), np.zeros(0), np.zeros(0)) for _ in range(blocks)
        ]
        for entries, errors in sides:
            for part, (J, r) in zip(found, _blocks(errors, number, blocks), strict=False):
                part.H[np.ix_(entries, entries)] += J.T @ J
                part.g[entries] += J.T @ r
        parts += found
    return parts


def _blocks(errors: Mapping[int, tuple[Array, Array]], number: int, blocks: int) -> Iterator[tuple[Array, Array]]:
    """Yield Jacobian and errors of each block of a record; nothing if the record does not tell the side."""
    if number in errors:
        yield from zip(*(np.array_split(each, blocks) for each in errors[number]), strict=True)


def _side(
    setup: Estimation, motions: Sequence[FilteredMotion], z: Array, j: int, names: tuple[str, ...]
) -> tuple[list[int], dict[int, tuple[Array, Array]]]:
    """Return the entries of z on a side of joint j, and for each record that tells it -dr/dz and r, in units of rms."""
    entries = [k for k, (name, i) in enumerate(setup.coordinates.free) if i == j and name in names]
    found = {}
    for number, (record, motion) in enumerate(zip(setup.records, motions, strict=True)):
        if names is MOTOR or both_sides(record, j):
            found[number] = _linearised(setup, z, entries, _errors(setup, motion, j, names))
    whole = np.concatenate([np.zeros(1), *(r for _, r in found.values())])
    scale = np.sqrt(np.mean(whole**2)) or 1.0
    return entries, {number: (J / scale, r / scale) for number, (J, r) in found.items()}


def _linearised(setup: Estimation, z: Array, entries: Sequence[int], errors: Errors) -> tuple[Array, Array]:
    """Return -dr/dz (k, entries) by central differences, and r (k,)."""
    coordinates = setup.coordinates
    r = errors(coordinates.parameters(z))
    J = np.empty((len(r), len(entries)))
    for column, entry in enumerate(entries):
        step = np.zeros(len(z))
        step[entry] = STEP * coordinates.width[entry]
        before, after = (errors(coordinates.parameters(each)) for each in (z - step, z + step))
        J[:, column] = (before - after) / (2 * step[entry])
    return J, r


def _errors(setup: Estimation, motion: FilteredMotion, j: int, names: tuple[str, ...]) -> Errors:
    """Return the errors (k,) of the equation of a side of joint j as a function of the parameters by name."""

    def link(p: Mapping[str, Array]) -> Array:
        A, y = link_rows(motion, j, p["link_skew"][j], p["link_damping"][j], p["smoothing"][j])
        compliance = 1 / p["joint_stiffness"][j]
        return np.asarray(y - A @ [compliance, compliance * p["link_coulomb_friction"][j], p["offset"][j]])

    def motor(p: Mapping[str, Array]) -> Array:
        A, y = motor_rows(p, motion, j, p["effort_delay"][j], p["smoothing"][j], setup.robot.B_m)
        return np.asarray(y - A @ [p[name][j] for name in MOTOR[:3]])

    return link if names is LINK else motor
