# SPDX-License-Identifier: Apache-2.0
"""The coefficients are those of M_l, and M_l is a convex combination of its control matrices on every box."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import nnls

from core.oracles.cases import Array
from core.oracles.chains import Chain, random_chain
from fjr_core.numerics.intervals import Interval
from fjr_proofs.verification import bernstein
from fjr_proofs.verification.control_matrices import (
    ControlMatrices,
    NormalisedInertia,
    control_matrices,
    normalised,
    whole_circles,
)
from fjr_proofs.verification.inertia_polynomial import inertia_polynomial, pairs

CHAINS = [(n, seed) for n in (1, 2, 3, 5) for seed in range(4)]
all_chains = pytest.mark.parametrize("chain", [pytest.param(c, id=f"{c[0]}-joints-{c[1]}") for c in CHAINS])


def basis(q: float, prismatic: bool) -> Array:
    waves = [1.0, np.cos(q), np.sin(q), np.cos(2 * q), np.sin(2 * q)]
    return np.array([1.0, q, q * q] if prismatic else waves)


def matrix(values: Array, n: int) -> Array:
    found = np.zeros((n, n))
    for value, (i, j) in zip(values, pairs(n), strict=True):
        found[i, j] = found[j, i] = value
    return found


def evaluated(inertia: NormalisedInertia, q: Array) -> Array:
    values = inertia.coefficients
    for angle, prismatic in zip(q[1:], inertia.prismatic, strict=True):
        values = np.tensordot(values, basis(angle, prismatic), axes=(1, 0))
    return matrix(values, inertia.n)


def plain(chain: Chain) -> NormalisedInertia:
    return normalised(inertia_polynomial(chain.links.bodies), Interval.exact(np.eye(chain.n)))


def random_box(rng: np.random.Generator, n: int) -> Array:
    lower = rng.uniform(-3, 3, n - 1)
    return np.column_stack([lower, lower + rng.choice([0.1, 1.0, 2.4, 5.0], n - 1)])


@all_chains
def test_polynomial_equals_the_inertia_of_pinocchio(chain: tuple[int, int]) -> None:
    made = random_chain(*chain)
    inertia = plain(made)
    for q in np.random.default_rng(chain).uniform(-3, 3, (20, made.n)):
        M = made.pinocchio.M(q)
        assert np.max(np.abs(evaluated(inertia, q) - M)) < 1e-12 * np.max(np.abs(M))
    assert np.max(inertia.rad) < 1e-12 * np.max(np.abs(inertia.coefficients))


@all_chains
def test_no_quadratic_form_of_the_inertia_exceeds_its_control_values(chain: tuple[int, int]) -> None:
    made, rng = random_chain(*chain), np.random.default_rng(chain)
    inertia = plain(made)
    for _ in range(10):
        box = random_box(rng, made.n)
        matrices = control_matrices(inertia, box, whole_circles(inertia, box)).matrices
        v = rng.normal(size=made.n)
        controls = np.einsum("i,ijk,j->k", v, matrices, v)
        for q in rng.uniform(box[:, 0], box[:, 1], (20, made.n - 1)):
            value = v @ made.pinocchio.M(np.array([0.0, *q])) @ v
            rounding = 1e-11 * np.max(np.abs(controls))
            assert controls.min() - rounding <= value <= controls.max() + rounding


@pytest.mark.parametrize("ends", [(-1.0, 0.5), (2.0, 4.4), (0.3, 0.3 + 1e-3), None])
def test_every_angle_is_a_convex_combination_of_the_control_values(ends: tuple[float, float] | None) -> None:
    A = (bernstein.from_arc(*ends) if ends else bernstein.from_circle()).mid
    for q in np.linspace(*(ends or (-np.pi, np.pi)), 40):
        weights, residual = nnls(A.T, basis(q, False))
        assert residual < 1e-7
        assert abs(weights.sum() - 1) < 1e-7


def restricted(first: ControlMatrices, axis: int, inertia: NormalisedInertia) -> list[ControlMatrices]:
    """Return the parts of a box, computed from the coefficients."""
    return [control_matrices(inertia, part.box, part.circles) for part in first.parts(axis, inertia)]


@all_chains
def test_parts_have_the_control_matrices_of_their_box_within_both_bounds(chain: tuple[int, int]) -> None:
    made, rng = random_chain(*chain), np.random.default_rng(chain)
    inertia = plain(made)
    for axis in range(made.n - 1):
        box = random_box(rng, made.n)
        whole = control_matrices(inertia, box, whole_circles(inertia, box))
        for part, other in zip(whole.parts(axis, inertia), restricted(whole, axis, inertia), strict=True):
            shape = (-1,) + (1,) * (part.values.ndim - 1)
            assert np.all(np.abs(part.values - other.values) <= (part.rad + other.rad).reshape(shape))
            assert part.error < 1e-8 * np.max(np.abs(part.values))
