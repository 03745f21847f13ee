# SPDX-License-Identifier: Apache-2.0
"""Bounds of matrix exponentials, of fundamental matrices and of spectral norms, against mpmath and products."""

from __future__ import annotations

import mpmath
import numpy as np
from scipy.linalg import expm

from fjr_proofs.verification.interval_matrices import (
    excess,
    exponential,
    exponential_integral,
    growth,
    magnitude_norm,
    spectral_norm,
)

RNG = np.random.default_rng(3)
SCALES = np.diag([1.0, 1e3, 1e-2, 10.0])
C = np.linalg.inv(SCALES) @ RNG.uniform(-100, 100, (6, 4, 4)) @ SCALES
T = 1e-3


def test_exponentials_lie_in_their_enclosures() -> None:
    found, integral = exponential(C, T), exponential_integral(C, T)
    with mpmath.workdps(40):
        for k, matrix in enumerate(C):
            A = mpmath.matrix(matrix.tolist()) * mpmath.mpf(T)
            exact = mpmath.expm(A)
            expected = mpmath.inverse(mpmath.matrix(matrix.tolist())) * (exact - mpmath.eye(4))
            for enclosed, value in ((found, exact), (integral, expected)):
                for i in range(4):
                    for j in range(4):
                        assert abs(value[i, j] - mpmath.mpf(enclosed.mid[k, i, j])) <= enclosed.rad[k, i, j]
    assert np.all(found.rad <= 1e-11 * (np.linalg.inv(SCALES) @ np.ones((4, 4)) @ SCALES))


def test_fundamental_matrices_deviate_by_no_more_than_the_excess() -> None:
    R = 0.1 * np.abs(C)
    bound, largest = excess(np.abs(C), R, R, T), np.eye(4) + growth(np.abs(C) + R, T)
    second_order = excess(np.abs(C), R, 0 * R, T)
    for _ in range(20):
        found, mean = np.broadcast_to(np.eye(4), C.shape), np.zeros_like(C)
        for _ in range(10):
            deviation = RNG.choice([-1.0, 1.0], C.shape) * R
            found = np.array([expm((c + d) * T / 10) for c, d in zip(C, deviation, strict=True)]) @ found
            mean = mean + deviation * T / 10
        change = found - np.array([expm(c * T) for c in C])
        assert np.all(np.abs(change) <= bound + 1e-13 * largest)
        assert np.all(np.abs(change - mean) <= second_order + 1e-13 * largest)
        assert np.all(np.abs(found) <= largest)


def test_spectral_norms_are_bounded_closely() -> None:
    for shape in ((5, 4, 4), (5, 3, 12), (5, 12, 3)):
        Y = RNG.standard_normal(shape)
        exact = np.linalg.norm(Y, 2, axis=(1, 2))
        assert np.all((exact <= spectral_norm(Y)) & (spectral_norm(Y) <= exact * (1 + 1e-5)))
        assert np.all(spectral_norm(np.sign(Y) * np.abs(Y)) <= magnitude_norm(np.abs(Y)))
