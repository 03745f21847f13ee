# SPDX-License-Identifier: Apache-2.0
"""Bounds of the inertia hold at every configuration, equal the closed forms, and are tight.

The coefficients are those of M_l, and M_l is a convex combination of its control matrices on every box.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.optimize import nnls

import fjr_core as fjr
from core.oracles.cases import Array
from core.oracles.chains import Chain, random_chain, random_urdf
from fjr_core.model.configuration_sampling import bounds_of
from fjr_core.model.robot import JointLimits
from fjr_core.motions.domain import Domain
from fjr_core.numerics.intervals import Interval, factorisable
from fjr_proofs.verification.control_matrices import (
    NormalisedInertia,
    control_matrices,
    from_arc,
    from_circle,
    normalised,
)
from fjr_proofs.verification.inertia_bounds import is_provable, largest_inertia
from fjr_proofs.verification.inertia_polynomial import inertia_polynomial, pairs

CHAINS = [(n, seed) for n in (1, 2, 3, 5) for seed in range(2)]
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
    bodies = chain.links.bodies
    prismatic = tuple(body.prismatic for body in bodies[1:])
    return normalised(inertia_polynomial(bodies), prismatic, Interval.exact(np.eye(chain.n)))


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
        matrices = control_matrices(inertia, box).matrices
        v = rng.normal(size=made.n)
        controls = np.einsum("i,ijk,j->k", v, matrices, v)
        for q in rng.uniform(box[:, 0], box[:, 1], (20, made.n - 1)):
            value = v @ made.pinocchio.M(np.array([0.0, *q])) @ v
            rounding = 1e-11 * np.max(np.abs(controls))
            assert controls.min() - rounding <= value <= controls.max() + rounding


@pytest.mark.parametrize("ends", [(-1.0, 0.5), (2.0, 4.4), (0.3, 0.3 + 1e-3), None])
def test_every_angle_is_a_convex_combination_of_the_control_values(ends: tuple[float, float] | None) -> None:
    A = (from_arc(*ends) if ends else from_circle()).mid
    for q in np.linspace(*(ends or (-np.pi, np.pi)), 40):
        weights, residual = nnls(A.T, basis(q, False))
        assert residual < 1e-7
        assert abs(weights.sum() - 1) < 1e-7


@all_chains
def test_parts_have_the_control_matrices_of_their_box_within_both_bounds(chain: tuple[int, int]) -> None:
    made, rng = random_chain(*chain), np.random.default_rng(chain)
    inertia = plain(made)
    for axis in range(made.n - 1):
        box = random_box(rng, made.n)
        for part in control_matrices(inertia, box).parts(axis):
            other = control_matrices(inertia, part.box, part.circles)  # from the coefficients
            shape = (-1,) + (1,) * (part.values.ndim - 1)
            assert np.all(np.abs(part.values - other.values) <= (part.rad + other.rad).reshape(shape))
            assert part.error < 1e-8 * np.max(np.abs(part.values))


def robot_of(n: int, seed: int) -> fjr.Robot:
    """Return a random chain; its prismatic joints have a range of 1 m, the others up to the whole circle."""
    links, rng = random_chain(n, seed).links, np.random.default_rng((n, seed, 1))
    half = np.array([0.5 if body.prismatic else rng.uniform(0.2, np.pi) for body in links.bodies])
    middle, free = rng.uniform(-1, 1, n), np.full(n, np.inf)
    limits = JointLimits(middle - half, middle + half, free, free)
    one = np.eye(n)
    return fjr.Robot(links, one, one, 0 * one, 0 * one, one, limits, tuple(body.prismatic for body in links.bodies))


def definite(n: int, seed: int) -> Array:
    root = np.random.default_rng((n, seed, 2)).normal(size=(n, n))
    return root @ root.T + 0.1 * np.eye(n)


def largest_eigenvalue(robot: fjr.Robot, A: Array, configurations: Array) -> float:
    return max(float(eigh(robot.M_l(q), A, eigvals_only=True)[-1]) for q in configurations)


@pytest.mark.parametrize("n", [1, 2, 3, 4])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_no_configuration_exceeds_the_bounds_and_one_nearly_attains_them(n: int, seed: int) -> None:
    robot, A = robot_of(n, seed), definite(n, seed)
    assert robot.limits is not None
    q = np.random.default_rng(seed).uniform(robot.limits.lower, robot.limits.upper, (500, n))
    largest = largest_inertia(robot, A, goal=0.9)
    assert largest_eigenvalue(robot, A, q) <= largest.bound
    assert np.isclose(largest_eigenvalue(robot, A, largest.at[None]), largest.attained)
    assert np.all((robot.limits.lower <= largest.at) & (largest.at <= robot.limits.upper))
    assert largest.bound <= largest.attained / 0.9


def test_a_smaller_box_and_a_tube_have_smaller_bounds() -> None:
    robot, A = robot_of(3, 5), definite(3, 5)
    times = np.linspace(0.0, 1.0, 9)
    path = np.array([np.sin(2 * times), times, times**2 - times]).T
    near = np.stack([np.minimum(path[:-1], path[1:]) - 0.02, np.maximum(path[:-1], path[1:]) + 0.02], axis=1)
    lower, upper = near[:, 0].min(axis=0), near[:, 1].max(axis=0)
    box, tube = (
        largest_inertia(robot, A, domain, 0.99) for domain in (Domain(lower, upper), Domain(lower, upper, near))
    )
    whole = largest_inertia(robot, A, Domain(lower - 1, upper + 1), 0.99)
    inside = np.concatenate([np.random.default_rng(0).uniform(*ends, (100, 3)) for ends in near])
    assert largest_eigenvalue(robot, A, inside) <= tube.bound <= box.bound * (1 + 1e-6)
    assert box.bound <= whole.bound * (1 + 1e-6)
    assert tube.bound < 1.02 * tube.attained


@pytest.mark.parametrize(
    "near",
    [
        [[[-1.0, 0.9], [1.0, 1.0]], [[np.nan, -0.1], [1.0, 0.1]]],  # left out, this part would make the bound too small
        [[[-1.0, 0.9], [1.0, 1.0]], [[-1.0, 0.1], [1.0, -0.1]]],
        [[[-1.0, 0.9], [1.0, 1.0]], [[-1.0, 3.0], [1.0, 3.1]]],
        [[[-1.0, 3.0], [1.0, np.inf]]],
        np.zeros((0, 2, 2)),
        np.zeros((3, 2)),
    ],
)
def test_parts_of_a_domain_that_a_search_would_leave_out_are_refused(near: object) -> None:
    domain = Domain(np.array([-1.0, -1.0]), np.array([1.0, 1.0]), np.asarray(near, dtype=float))
    with pytest.raises(fjr.StateError, match="near .*; expected"):
        largest_inertia(fjr.planar_two_link(), np.eye(2), domain)


def slider(turns: int) -> fjr.Robot:
    """Return a robot whose last link slides radially; it does not say which joints are prismatic, the bodies do."""
    slide = fjr.Body(np.eye(3), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 1.0, (0.0, 0.0, 0.0), 0.01 * np.eye(3), True)
    turn = fjr.Body(np.eye(3), (0.2, 0.0, 0.0), (0.0, 0.0, 1.0), 1.0, (0.1, 0.0, 0.0), 0.01 * np.eye(3))
    one = np.eye(turns + 1)
    return fjr.Robot(fjr.serial_chain([turn] * turns + [slide]), one, one, 0 * one, 0 * one, one)


def test_a_motion_over_several_turns_is_covered_in_each() -> None:
    """The slide is out in the second turn only."""
    robot, times = slider(2), np.linspace(0.0, 1.0, 41)
    path = np.column_stack([0 * times, 12 * times, times])
    near = np.stack([path[:-1] - 0.01, path[1:] + 0.01], axis=1)
    found = largest_inertia(robot, 1.0, Domain(near[:, 0].min(axis=0), near[:, 1].max(axis=0), near))
    assert largest_eigenvalue(robot, np.eye(3), path) <= found.bound


def test_a_long_slide_is_no_circle() -> None:
    domain = Domain(np.array([-1.0, -1.0]), np.array([1.0, 20.0]))
    found = largest_inertia(slider(1), 1.0, domain)
    assert largest_eigenvalue(slider(1), np.eye(2), np.array([[0.0, 20.0]])) <= found.bound


def test_joints_in_another_order_have_the_same_bounds() -> None:
    """The random URDF names its joints in an order other than that of the chain."""
    case = random_urdf(3, 1)
    robot = fjr.robot_from_urdf(case.xml, list(case.joints), 1.0, 1.0, locked=case.locked)
    A = definite(3, 1)
    q = np.random.default_rng(0).uniform(*bounds_of(robot), (500, 3))
    found = largest_inertia(robot, A, goal=0.95)
    assert (
        largest_eigenvalue(robot, A, q)
        <= found.bound
        <= largest_eigenvalue(robot, A, found.at[None]) / 0.95 * (1 + 1e-9)
    )


def test_too_many_joints_are_refused() -> None:
    body = fjr.Body(np.eye(3), (0.2, 0.0, 0.1), (0.0, 1.0, 0.0), 1.0, (0.1, 0.0, 0.0), 0.01 * np.eye(3))
    one = np.eye(9)
    robot = fjr.Robot(fjr.serial_chain([body] * 9), one, one, 0 * one, 0 * one, one)
    assert not is_provable(robot)
    with pytest.raises(fjr.RobotError, match="the robot has 9 joints; expected .* at most 8 revolute joints"):
        largest_inertia(robot, 1.0)


def test_a_matrix_that_is_not_positive_definite_is_not_factorised() -> None:
    rng = np.random.default_rng(0)
    roots = rng.normal(size=(4, 4, 3000))
    N = np.einsum("ijk,ljk->ilk", roots, roots)
    largest = np.linalg.eigvalsh(np.moveaxis(N, -1, 0))[:, -1]
    for diagonal in (5.0, 10.0, 20.0):
        assert np.array_equal(factorisable(N, diagonal), largest < diagonal)
