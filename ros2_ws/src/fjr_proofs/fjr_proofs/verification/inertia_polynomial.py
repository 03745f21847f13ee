# SPDX-License-Identifier: Apache-2.0
"""Coefficients of the link inertia M_l(q_l) of a serial chain, a polynomial in the cosines and sines of its joints.

M_l has degree at most 2 in each joint and does not depend on the first one. For a revolute joint the basis is
(1, cos q, sin q, cos 2q, sin 2q), for a prismatic one (1, q, q^2). So the values of M_l at as many positions of each
joint, its nodes, determine the coefficients: by the discrete Fourier transform from 2 pi k / 5 rad, by differences from
-1, 0 and 1 m. The values are those of the expression that laws and plants evaluate, in interval arithmetic at all nodes
together: each joint has an axis, along which only what depends on it has more than one entry.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import combinations_with_replacement
from math import pi

import casadi as ca
import numpy as np

from fjr_core.model.newton_euler import ChainAt, Mass
from fjr_core.model.rigid_arm import Body, z_aligned
from fjr_core.numerics.intervals import Interval, U, cosine, product, sine, stack

SIZES = {False: 5, True: 3}
"""Number of basis functions, and of nodes, of a revolute and of a prismatic joint."""
SLIDES = (-1.0, 0.0, 1.0)
"""Nodes [m] of a prismatic joint."""
OPERATIONS: dict[int, Callable[[Interval, Interval], Interval]] = {
    ca.OP_ADD: lambda a, b: a + b,
    ca.OP_SUB: lambda a, b: a - b,
    ca.OP_MUL: lambda a, b: a * b,
    ca.OP_SQ: lambda a, _: a * a,
    ca.OP_TWICE: lambda a, _: a + a,
    ca.OP_NEG: lambda a, _: -a,
    ca.OP_SIN: lambda a, _: sine(a),
    ca.OP_COS: lambda a, _: cosine(a),
}
"""Operations of an inertia matrix."""


def pairs(n: int) -> list[tuple[int, int]]:
    """Return the entries (i, j), i <= j, of a symmetric matrix in the order of the coefficients."""
    return list(combinations_with_replacement(range(n), 2))


def number_of_coefficients(bodies: Sequence[Body]) -> int:
    """Return the number of coefficients of one entry of M_l."""
    return int(np.prod([SIZES[body.prismatic] for body in bodies[1:]], dtype=float))


def inertia_polynomial(bodies: Sequence[Body]) -> Interval:
    """Return the coefficients (n (n + 1) / 2, d_2, .., d_n) of M_l of a serial chain from base to tip.

    They are those of the entries i <= j, row by row; the axes are the joints 2 .. n.
    """
    n, prismatic = len(bodies), tuple(body.prismatic for body in bodies[1:])
    q, numbers, chain = ca.SX.sym("q", n), ca.SX.sym("numbers", 13, n), z_aligned(bodies)
    M_l = ChainAt(chain, [_moments(of_body) for of_body in ca.horzsplit(numbers)], np.zeros(3), q).inertia()
    upper = ca.densify(ca.vertcat(*(M_l[pair] for pair in pairs(n))))
    entries = ca.Function("entries", [ca.veccat(q, numbers)], [upper], {"cse": True})
    given = np.concatenate([np.hstack([body.mass, body.com, np.ravel(body.inertia)]) for body in chain])
    at = [nodes(slides).reshape(*np.where(np.arange(n - 1) == axis, -1, 1)) for axis, slides in enumerate(prismatic)]
    base, *constants = (Interval.exact(np.full((1,) * (n - 1), number)) for number in (0.0, *given))
    values = _values(entries, [base, *at, *constants])
    return stack([_coefficients(value, prismatic) for value in values])


def _moments(numbers: ca.SX) -> Mass:
    """Return the moments of a body of mass, centre of mass and inertia (13,), whose rounding is enclosed, too."""
    m, com, inertia = numbers[0], numbers[1:4], ca.reshape(numbers[4:], 3, 3)
    inertia = 0.5 * (inertia + inertia.T)
    return Mass(m, m * com, 0.5 * ca.trace(inertia) * ca.SX.eye(3) - inertia + m * com @ com.T)


def nodes(prismatic: bool) -> Interval:
    """Return the positions of a joint [rad, m] whose values determine a polynomial."""
    angles = 2 * pi * np.array([0.0, 1.0, 2.0, -2.0, -1.0]) / 5
    return Interval.exact(SLIDES) if prismatic else Interval(angles, 4 * U * np.abs(angles))


@lru_cache
def from_nodes(prismatic: bool) -> Interval:
    """Return the matrix from the values of a polynomial at its nodes to its coefficients."""
    if prismatic:
        return Interval.exact([[0.0, 1.0, 0.0], [-0.5, 0.0, 0.5], [0.5, -1.0, 0.5]])
    return (Interval.exact([1.0, 2.0, 2.0, 2.0, 2.0]) / Interval.exact(5.0))[:, None] * waves()


@lru_cache
def waves() -> Interval:
    """Return the basis (1, cos q, sin q, cos 2q, sin 2q) at the five nodes of a revolute joint, a column for each."""
    q = nodes(False)
    return stack([Interval.exact(np.ones(5)), cosine(q), sine(q), cosine(q + q), sine(q + q)])


def _values(function: ca.Function, arguments: Sequence[Interval]) -> list[Interval]:
    """Return the results of an SX function of one vector; arguments: its entries, whose shapes broadcast."""
    memory: dict[int, Interval] = {}
    results = [Interval.exact(0.0)] * function.nnz_out(0)
    for k in range(function.n_instructions()):
        operation, operands = function.instruction_id(k), function.instruction_input(k)
        result = function.instruction_output(k)
        if operation == ca.OP_INPUT:
            memory[result[0]] = arguments[operands[1]]
        elif operation == ca.OP_OUTPUT:
            results[result[1]] = memory[operands[0]]
        elif operation == ca.OP_CONST:
            memory[result[0]] = Interval.exact(np.full(arguments[0].mid.shape, function.instruction_constant(k)))
        else:
            memory[result[0]] = OPERATIONS[operation](memory[operands[0]], memory[operands[-1]])
    return results


def _coefficients(values: Interval, prismatic: Sequence[bool]) -> Interval:
    """Return the coefficients (d_2, .., d_n) of a polynomial with these values; one value: of every node."""
    for axis, slides in enumerate(prismatic):
        if values.mid.shape[axis] > 1:
            values = product(from_nodes(slides), values, axis)
    mid, rad = (np.zeros([SIZES[slides] for slides in prismatic]) for _ in range(2))
    known = tuple(slice(size) for size in values.mid.shape)
    mid[known], rad[known] = values.mid, values.rad
    return Interval(mid, rad)
