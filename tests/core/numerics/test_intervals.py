# SPDX-License-Identifier: Apache-2.0
"""Verified numerics contain the exact results (mpmath, 60 digits): operations on intervals, eigenvalues of pencils."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import fjr_core as fjr
from fjr_core.numerics.checks import Array
from fjr_core.numerics.intervals import Interval, cosine, least_eigenvalue, product, sine

finite = st.floats(-1e6, 1e6, allow_nan=False)
radius = st.floats(0.0, 1.0)
side = st.sampled_from([-1, 0, 1])
EXACT = 700  # digits; the product of two doubles, sums with the smallest radius


def contains(interval: Interval, value: Any) -> bool:
    return bool(abs(mpmath.mpf(float(interval.mid)) - value) <= mpmath.mpf(float(interval.rad)))


def member(mid: float, rad: float, at: int) -> Any:
    return mpmath.mpf(mid) + at * mpmath.mpf(rad)


def interval(mid: float, rad: float) -> Interval:
    return Interval(np.float64(mid), np.float64(rad))


@pytest.mark.parametrize("operation", [lambda a, b: a + b, lambda a, b: a - b, lambda a, b: a * b])
@given(finite, radius, side, finite, radius, side)
def test_sums_and_products(
    operation: Callable[[Any, Any], Any], a: float, ra: float, i: int, b: float, rb: float, k: int
) -> None:
    with mpmath.workdps(EXACT):
        found = operation(interval(a, ra), interval(b, rb))
        assert contains(found, operation(member(a, ra, i), member(b, rb, k)))


@given(finite, radius, side, st.floats(0.5, 1e3), st.floats(0.0, 0.3), side)
def test_quotients(a: float, ra: float, i: int, b: float, rb: float, k: int) -> None:
    with mpmath.workdps(EXACT):
        assert contains(interval(a, ra) / interval(b, rb), member(a, ra, i) / member(b, rb, k))


@given(st.floats(-10, 10), radius, side)
def test_cosines_and_sines(a: float, ra: float, i: int) -> None:
    with mpmath.workdps(EXACT):
        assert contains(cosine(interval(a, ra)), mpmath.cos(member(a, ra, i)))
        assert contains(sine(interval(a, ra)), mpmath.sin(member(a, ra, i)))


@given(st.lists(st.tuples(finite, radius, side, finite, radius, side), min_size=1, max_size=6))
def test_inner_products(terms: list[tuple[float, float, int, float, float, int]]) -> None:
    a, ra, i, b, rb, k = (np.array(column) for column in zip(*terms, strict=True))
    with mpmath.workdps(EXACT):
        exact = sum(member(t[0], t[1], t[2]) * member(t[3], t[4], t[5]) for t in terms)
        assert contains(product(Interval(a[None], ra[None]), Interval(b, rb))[0], exact)


def test_a_quotient_by_an_interval_with_zero_is_refused() -> None:
    with pytest.raises(ZeroDivisionError):
        interval(1.0, 0.0) / interval(0.1, 0.2)


def exact(A: Array, B: Array) -> mpmath.mpf:
    """Return the least eigenvalue of A v = lambda B v with 60 digits."""
    with mpmath.workdps(60):
        root = mpmath.cholesky(mpmath.matrix(B.tolist())) ** -1
        return min(mpmath.eigsy(root * mpmath.matrix(A.tolist()) * root.T, eigvals_only=True))


def symmetric(A: Array) -> Array:
    return (A + A.T) / 2


@pytest.mark.parametrize("n", [1, 2, 5])
@pytest.mark.parametrize("condition", [1.0, 1e4, 1e8, 1e10])
def test_bound_is_below_the_exact_eigenvalue_and_close(n: int, condition: float) -> None:
    for seed in range(10):
        rng = np.random.default_rng((n, seed))
        R = np.linalg.qr(rng.normal(size=(n, n)))[0]
        sizes = np.geomspace(1.0, 1 / condition, n)
        A = symmetric(R @ np.diag(rng.uniform(1.0, 9.0, n) * sizes) @ R.T)
        B = symmetric(R @ np.diag(sizes) @ R.T)
        found, least = least_eigenvalue(Interval.exact(A), Interval.exact(B)), exact(A, B)
        assert found <= least
        assert found >= least * (1 - 1e-14 * 1e3 * condition - 1e-11)


def test_nothing_is_proven_for_an_indefinite_or_a_wide_matrix() -> None:
    one = Interval.exact(np.eye(2))
    assert least_eigenvalue(Interval.exact(np.diag([1.0, -1e-3])), one) == -np.inf
    assert least_eigenvalue(Interval(np.eye(2), np.full((2, 2), 0.6)), one) == -np.inf


@pytest.mark.parametrize("condition", [1e8, 1e12])
def test_rate_of_coupled_gains_is_not_above_the_exact_one(condition: float) -> None:
    """Of Pi_l with this condition number, eigenvalues in floating point are up to 1e-5 too large."""
    for angle in np.linspace(0.2, 1.3, 12):
        R = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        sizes = np.array([condition**0.5, condition**-0.5])
        Pi_l = symmetric(R @ np.diag(sizes) @ R.T)
        Lambda_l = np.linalg.solve(Pi_l, R @ np.diag([20.0, 10.0] * sizes) @ R.T)
        law = fjr.TrackingLaw(fjr.planar_two_link(), fjr.Gains(Lambda_l, Pi_l, 2.0, 20.0, 60.0, 0.3))
        with mpmath.workdps(60):
            product = mpmath.matrix(law.gains.Pi_l.tolist()) * mpmath.matrix(law.gains.Lambda_l.tolist())
            half = (product + product.T) / 2
            root = mpmath.cholesky(mpmath.matrix(law.gains.Pi_l.tolist())) ** -1
            least = min(mpmath.eigsy(root * half * root.T, eigvals_only=True))
        for rate in (law.rate(), law.proven_rate(most_boxes=2)):
            assert rate.beta_l <= least * (1 + 1e-9)


@pytest.mark.parametrize("condition", [1e6, 1e12])
def test_rate_of_coupled_damping_is_not_above_the_exact_one_at_any_position(condition: float) -> None:
    """Of K_ld with this condition number, eigenvalues in floating point are up to 1e-4 too large."""
    arm = fjr.planar_two_link()
    with mpmath.workdps(60):
        roots = [mpmath.cholesky(mpmath.matrix(arm.M_l([0.0, q]).tolist())) ** -1 for q in (0.0, np.pi)]
        for angle in np.linspace(0.2, 1.3, 12):
            R = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
            law = fjr.TrackingLaw(
                arm, fjr.Gains(10.0, 20.0, symmetric(R @ np.diag([condition, 1.0]) @ R.T), 15, 60, 0.3)
            )
            damping = mpmath.matrix((arm.D_l + law.gains.K_ld).tolist())
            least = min(min(mpmath.eigsy(root * damping * root.T, eigvals_only=True)) for root in roots)
            assert law.rate().proven
            assert law.rate().beta_sigma_l <= least * (1 + 1e-9)
