# SPDX-License-Identifier: Apache-2.0
"""Errors of the equations of both sides along a filtered motion, with their derivatives by all free parameters.

    link side    r = q_m - q_l - offset - tau / K
    motor side   r = u(t - delay) - tau - B a_m - D_m v_m - F_m tanh(v_m / v_0)
    torque       tau = M_l a + C v + grad P_l + D_l v_l + F_l tanh(v_l / v_0) + T(q_l)

The motor side counts only while the motor moves, because friction at rest takes any value up to static friction. These
errors need no simulation, so that torques which the model lacks do not add up over time. They are compared within the
bandwidth of the motion, because the noise of an acceleration would bias the stiffness (M. Gautier, ICRA 1997: filtered
and decimated regressors).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fjr_core.numerics.checks import Array

from .coordinates import packed
from .elastic_arm import ElasticArm, position_terms
from .estimation_problem import Estimation
from .initial_guess import FilteredMotion, both_sides, decimated, inner, shifted
from .parameters import OF_LINKS, POSITION_TORQUE
from .variable_projection import Projected

BLOCK = 1.0  # s; longer than the correlation of the errors
FEWEST_BLOCKS = 4
LEAST_ERROR = 1e-3  # of the deflection or the effort; no model is better
MOVING = 2.0  # smoothing velocities; a slower motor may be at rest

Values = Mapping[str, Array]
Columns = dict[tuple[str, int], Array]


@dataclass(frozen=True, eq=False)
class Side:
    """Errors r (k,) of an equation of a joint, and -dr/dp of each column (k,) by (name, index) of p.

    p of positive parameters is the logarithm. used (k,): samples that count. Every `stride`-th one is independent.
    measured: standard deviation of the deflection or the effort.
    """

    errors: Array
    columns: Columns
    used: Array
    stride: int
    measured: float


def equation_error(setup: Estimation, motions: Sequence[FilteredMotion], z: Array) -> list[Projected]:
    """Return the normal equations by z (p,) of each block of the records, in units of the errors' deviation at z."""
    free, blocks = setup.coordinates.free, [_blocks(motion) for motion in motions]
    parts = [[_empty(len(z)) for _ in range(count)] for count in blocks]
    rigid = [rigid_along(setup, motion, z) for motion in motions]
    for j in range(setup.robot.n):
        for side in (link_side, motor_side):
            told = [k for k, record in enumerate(setup.records) if side is motor_side or both_sides(record, j)]
            found = [side(setup, motions[k], rigid[k], z, j) for k in told]
            scale = _deviation(found)
            for k, each in zip(told, found, strict=True):
                entries = [i for i, name in enumerate(free) if name in each.columns]
                for part, (J, r) in zip(parts[k], _split(each, [free[i] for i in entries], blocks[k]), strict=True):
                    part.H[np.ix_(entries, entries)] += J.T @ J / scale**2
                    part.g[entries] += J.T @ r / scale**2
    return [part for record in parts for part in record]


@dataclass(frozen=True, eq=False)
class Rigid:
    """Torque (k, n) of the rigid links along a motion, and its derivatives (k, n) by the free parameters of links."""

    torque: Array
    slopes: Columns


def rigid_along(setup: Estimation, motion: FilteredMotion, z: Array) -> Rigid:
    """Return the torque of the rigid links along a motion at z (p,), with derivatives by the free ones of OF_LINKS."""
    free = [each for each in setup.coordinates.free if each[0] in OF_LINKS]
    if not free:
        return Rigid(motion.rigid, {})
    arm: ElasticArm = setup.arm(setup.coordinates)
    values = packed(arm, setup.coordinates.parameters(z))
    n, arguments = setup.robot.n, (motion.q_l.T, motion.v_l.T, motion.a_l.T)
    torque = np.asarray(arm.link_torque(*arguments, values)).T
    slopes = np.asarray(arm.link_torque_slopes(*arguments, values)).reshape(n * len(free), -1)
    return Rigid(torque, {each: slopes[k * n : (k + 1) * n].T for k, each in enumerate(free)})


def link_side(setup: Estimation, m: FilteredMotion, rigid: Rigid, z: Array, j: int) -> Side:
    """Return the errors [rad] of the equation of link j."""
    p = setup.coordinates.parameters(z)
    tau, columns, q = _spring_torque(m, rigid, p, j)
    K = p["joint_stiffness"][j]
    columns = {name: column / K for name, column in columns.items()}
    columns[("joint_stiffness", j)] = -tau / K
    columns[("offset", j)] = np.ones(len(q))
    columns[("link_skew", j)] -= np.gradient(q, m.dt)
    z = m.q_m[:, j] - q
    return _side(m, z, z - p["offset"][j] - tau / K, columns, np.ones(len(q), dtype=bool))


def motor_side(setup: Estimation, m: FilteredMotion, rigid: Rigid, z: Array, j: int) -> Side:
    """Return the errors [N m] of the equation of motor j."""
    p = setup.coordinates.parameters(z)
    tau, columns, _ = _spring_torque(m, rigid, p, j)
    u = shifted((m.u @ setup.robot.B_m.T)[:, j], m.dt, p["effort_delay"][j] + m.dt / 2)
    B, v, friction = p["motor_inertia"][j], m.v_m[:, j], np.tanh(m.v_m[:, j] / p["smoothing"][j])
    columns[("motor_inertia", j)] = B * m.a_m[:, j]
    columns[("motor_damping", j)] = v
    columns[("motor_coulomb_friction", j)] = friction
    columns[("effort_delay", j)] = np.gradient(u, m.dt)
    known = tau + B * m.a_m[:, j] + p["motor_damping"][j] * v + p["motor_coulomb_friction"][j] * friction
    return _side(m, u, u - known, columns, np.abs(v) > MOVING * p["smoothing"][j])


def _spring_torque(m: FilteredMotion, rigid: Rigid, p: Values, j: int) -> tuple[Array, Columns, Array]:
    """Return tau (k,) of joint j, its derivatives, and the position of the link, at the link's skew."""
    skew = p["link_skew"][j]
    q, v, tau = (shifted(each[:, j], m.dt, skew) for each in (m.q_l, m.v_l, rigid.torque))
    friction, terms = np.tanh(v / p["smoothing"][j]), position_terms(q, np)
    columns = {(name, j): term for name, term in zip(POSITION_TORQUE, terms, strict=True)}
    columns |= {("link_damping", j): v, ("link_coulomb_friction", j): friction}
    tau = tau + sum(p[name][i] * column for (name, i), column in columns.items())
    columns |= {name: shifted(slope[:, j], m.dt, skew) for name, slope in rigid.slopes.items()}
    columns[("link_skew", j)] = -np.gradient(tau, m.dt)
    return tau, columns, q


def _side(m: FilteredMotion, measured: Array, errors: Array, columns: Columns, used: Array) -> Side:
    inside = {name: inner(each, m.dt) for name, each in columns.items()}
    return Side(inner(errors, m.dt), inside, inner(used, m.dt), m.stride, float(np.std(measured)))


def _split(side: Side, names: Sequence[tuple[str, int]], blocks: int) -> Iterator[tuple[Array, Array]]:
    """Yield derivatives (k, names) and errors (k,) of each block; samples that do not count are 0."""
    J = np.column_stack([side.columns[name] for name in names]) if names else np.zeros((len(side.errors), 0))
    slow = decimated(np.column_stack([J, side.errors]) * side.used[:, None], side.stride)
    yield from ((each[:, :-1], each[:, -1]) for each in np.array_split(slow, blocks))


def _deviation(sides: Sequence[Side]) -> float:
    """Return the root mean square error of the samples that count, at least a part of what is measured."""
    squares = sum(float(np.sum(decimated(side.errors * side.used, side.stride) ** 2)) for side in sides)
    shares = sum(float(np.sum(decimated(side.used.astype(float), side.stride) ** 2)) for side in sides)
    least = LEAST_ERROR * max((side.measured for side in sides), default=0.0)
    return max(float(np.sqrt(squares / shares)) if shares > 0 else 0.0, least) or 1.0


def _blocks(motion: FilteredMotion) -> int:
    return max(FEWEST_BLOCKS, round(len(motion.u) * motion.dt / BLOCK))


def _empty(size: int) -> Projected:
    return Projected(np.zeros((size, size)), np.zeros(size), np.zeros(0), np.zeros(0))
