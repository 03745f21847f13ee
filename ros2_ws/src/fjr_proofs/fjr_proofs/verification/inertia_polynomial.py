# SPDX-License-Identifier: Apache-2.0
"""Coefficients of the link inertia M_l(q_l) of a serial chain, a polynomial in the cosines and sines of its joints.

M_l has degree at most 2 in each joint and does not depend on the first one. For a revolute joint the basis is
(1, cos q, sin q, cos 2q, sin 2q), for a prismatic one (1, q, q^2). The composite-body recursion of robot.newton_euler
never multiplies two terms that depend on the same joint, so that each step from a body to its parent adds one axis to
the array of coefficients. No sine or cosine is evaluated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np

from fjr_core.model.rigid_arm import Body, z_aligned
from fjr_core.numerics.intervals import Interval, product, stack

SIZES = {False: 5, True: 3}
"""Number of basis functions of a revolute and of a prismatic joint."""


@dataclass(frozen=True, eq=False)
class InertiaPolynomial:
    """M_l of n joints: coefficients (n (n + 1) / 2, d_2, .., d_n) of the entries i <= j, row by row.

    prismatic (n - 1,): of the joints 2 .. n, which are the axes.
    """

    coefficients: Interval
    prismatic: tuple[bool, ...]

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.prismatic) + 1


def pairs(n: int) -> list[tuple[int, int]]:
    """Return the entries (i, j), i <= j, of a symmetric matrix in the order of the coefficients."""
    return list(combinations_with_replacement(range(n), 2))


def number_of_coefficients(bodies: Sequence[Body]) -> int:
    """Return the number of coefficients of one entry of M_l."""
    return int(np.prod([SIZES[body.prismatic] for body in bodies[1:]], dtype=float))


def inertia_polynomial(bodies: Sequence[Body]) -> InertiaPolynomial:
    """Return M_l of a serial chain from base to tip."""
    chain = z_aligned(bodies)
    n, entries = len(chain), {}
    h, J, mass = _moments(chain[-1])
    for j in reversed(range(n)):
        if j < n - 1:
            h, J = _in_parent(chain[j + 1], h, J, mass)
            h_j, J_j, mass_j = _moments(chain[j])
            h, J, mass = _plus(h, h_j), _plus(J, J_j), mass + mass_j
        for i, entry in _column(chain, j, h, J, mass):
            entries[i, j] = _extended(entry, chain[1 : i + 1])
    return InertiaPolynomial(stack([entries[pair] for pair in pairs(n)]), tuple(body.prismatic for body in chain[1:]))


def _moments(body: Body) -> tuple[Interval, Interval, Interval]:
    """Return first moment h (3,), second moment J = sum m r r' (3, 3) and mass of a body about its frame."""
    mass, com, inertia = Interval.exact(body.mass), Interval.exact(body.com), Interval.exact(body.inertia)
    half = Interval.exact(0.5)
    trace = (inertia[0, 0] + inertia[1, 1] + inertia[2, 2]) * half
    J = [[mass * com[i] * com[k] - (inertia[i, k] + inertia[k, i]) * half for k in range(3)] for i in range(3)]
    for i in range(3):
        J[i][i] += trace
    return stack([mass * com[i] for i in range(3)]), stack([stack(row) for row in J]), mass


def _column(chain: Sequence[Body], j: int, h: Interval, J: Interval, mass: Interval) -> list[tuple[int, Interval]]:
    """Return the entries (i, M_ij), i = j .. 0: the wrench for unit acceleration of composite body j, on joint i."""
    zero = _zeros(h[0])
    if chain[j].prismatic:
        force, moment = stack([zero, zero, _constant(mass, zero)]), stack([h[1], -h[0], zero])
    else:
        force, moment = stack([-h[1], h[0], zero]), stack([-J[0, 2], -J[1, 2], J[0, 0] + J[1, 1]])
    column = []
    for i in reversed(range(j + 1)):
        column.append((i, (force if chain[i].prismatic else moment)[2]))
        if i:
            force, moment = _wrench_in_parent(chain[i], force, moment)
    return column


def _wrench_in_parent(body: Body, force: Interval, moment: Interval) -> tuple[Interval, Interval]:
    """Return a wrench (3, ..) on a body in the frame of its parent, as a polynomial in the joint of the body, too."""
    if body.prismatic:
        slid = stack([-force[1], force[0], _zeros(force[0])])  # z x force
        force, moment = _series([force], body), _series([moment, slid], body)
    else:
        force, moment = _turned(force, body), _turned(moment, body)
    x, y, z = np.asarray(body.translation)
    R, cross = Interval.exact(body.rotation), Interval.exact([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    force = product(R, force)
    return force, product(R, moment) + product(cross, force)


def _in_parent(body: Body, h: Interval, J: Interval, mass: Interval) -> tuple[Interval, Interval]:
    """Return the moments h (3, ..), J (3, 3, ..) of a composite body about its parent's frame.

    They are polynomials in the joint of the body, too.
    """
    if body.prismatic:  # h + m q z, J + q (z h' + h z') + m q^2 z z'
        zero, m = _zeros(h[0]), _constant(mass, h[0])
        linear = _symmetric(zero, zero, h[0], zero, h[1], h[2] + h[2])
        square = _symmetric(zero, zero, zero, zero, zero, m)
        h, J = _series([h, stack([zero, zero, m])], body), _series([J, linear, square], body)
    else:
        h, J = _turned(h, body), _turned_second_moment(J, body)
    R, r = Interval.exact(body.rotation), Interval.exact(body.translation)
    h, J = product(R, h), product(R, product(R, J), axis=1)
    shift = stack([stack([r[i] * h[k] + h[i] * r[k] for k in range(3)]) for i in range(3)])
    corner = stack([stack([mass * r[i] * r[k] for k in range(3)]) for i in range(3)])
    return _plus(h, stack([mass * r[i] for i in range(3)])), _plus(J + shift, corner)


def _turned(vector: Interval, body: Body) -> Interval:
    """Return R_z(q) vector: x cos q - y sin q, x sin q + y cos q, z."""
    x, y, z = (vector[i] for i in range(3))
    zero = _zeros(x)
    return _series([stack([zero, zero, z]), stack([x, y, zero]), stack([-y, x, zero])], body)


def _turned_second_moment(J: Interval, body: Body) -> Interval:
    """Return R_z(q) J R_z(q)': the mean of J_xx and J_yy stays, their deviator and J_xy turn by 2q (Mohr's circle)."""
    half, zero = Interval.exact(0.5), _zeros(J[0, 0])
    mean, deviator, shear = (J[0, 0] + J[1, 1]) * half, (J[0, 0] - J[1, 1]) * half, J[0, 1]
    xz, yz, zz = J[0, 2], J[1, 2], J[2, 2]
    parts = [
        _symmetric(mean, zero, zero, mean, zero, zz),
        _symmetric(zero, zero, xz, zero, yz, zero),
        _symmetric(zero, zero, -yz, zero, xz, zero),
        _symmetric(deviator, shear, zero, -deviator, zero, zero),
        _symmetric(-shear, deviator, zero, shear, zero, zero),
    ]
    return _series(parts, body)


def _symmetric(xx: Interval, xy: Interval, xz: Interval, yy: Interval, yz: Interval, zz: Interval) -> Interval:
    return stack([stack([xx, xy, xz]), stack([xy, yy, yz]), stack([xz, yz, zz])])


def _series(parts: list[Interval], body: Body) -> Interval:
    """Return the polynomial in the joint of a body with these leading coefficients; the joint's axis is the last."""
    return stack([*parts, *[_zeros(parts[0])] * (SIZES[body.prismatic] - len(parts))], -1)


def _zeros(like: Interval) -> Interval:
    return Interval.exact(np.zeros_like(like.mid))


def _constant(value: Interval, like: Interval) -> Interval:
    """Return a constant () as a polynomial of the shape of another."""
    mid, rad = np.zeros_like(like.mid), np.zeros_like(like.mid)
    mid.flat[0], rad.flat[0] = value.mid, value.rad
    return Interval(mid, rad)


def _plus(polynomials: Interval, constants: Interval) -> Interval:
    """Return polynomials (3, ..) or (3, 3, ..) plus constants (3,) or (3, 3)."""
    flat = polynomials.reshape(*constants.mid.shape, -1)
    mid, rad = np.zeros_like(flat.mid), np.zeros_like(flat.mid)
    mid[..., 0], rad[..., 0] = constants.mid, constants.rad
    return (flat + Interval(mid, rad)).reshape(*polynomials.mid.shape)


def _extended(entry: Interval, bodies: Sequence[Body]) -> Interval:
    """Return a polynomial in the outer joints as one in the joints of more bodies, on which it does not depend.

    The axes are in the order of the chain.
    """
    sizes = [SIZES[body.prismatic] for body in bodies]
    mid, rad = (np.zeros((*sizes, *entry.mid.T.shape)) for _ in range(2))
    first = (0,) * len(sizes)
    mid[first], rad[first] = entry.mid.T, entry.rad.T
    return Interval(mid, rad)
