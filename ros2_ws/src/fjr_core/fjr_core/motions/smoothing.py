# SPDX-License-Identifier: Apache-2.0
"""Smooth dense samples of a motion to class C^4 by a least-squares spline of degree 9.

The number of pieces minimises the generalised cross-validation score (Craven and Wahba, 1979), which estimates the
error of prediction without knowing the noise. Rounding of the samples is averaged out instead of being differentiated
four times. The largest deviation from the samples must stay within a tolerance.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..numerics.checks import Array
from .piecewise_polynomial import DEGREE
from .reference import JETS

FEWEST_SAMPLES = 3
"""Samples per piece, at least; with fewer the least-squares problem leaves no noise to average."""
REST_COST = 2.0
"""Largest ratio of the scores with and without rest at an end for which the samples are taken to rest there."""
GROWTH, PATIENCE = 1.5, 2
"""Ratio of successive numbers of pieces; the search ends this many numbers after the best one."""


class Fit(NamedTuple):
    """A least-squares spline: breakpoints (m + 1,) [s], jets (m + 1, 5, n) there, largest deviation (n,) [rad].

    rests: True for the first and the last point if all derivatives of the fit are zero there.
    """

    times: Array
    jets: Array
    deviation: Array
    rests: tuple[bool, bool]

    @property
    def pieces(self) -> int:
        """Number of polynomials."""
        return len(self.times) - 1


def least_squares_fit(times: Array, positions: Array, tolerance: float | Array) -> Fit | None:
    """Return the fit of samples (k, n) [rad] at increasing times (k,) [s]; None if none is within the tolerance.

    tolerance: largest deviation [rad, m], one number or (n,).
    At an end where the samples rest, to the resolution of the fit, all derivatives of the fit are exactly zero.
    """
    best = None
    for fit, score in _candidates(times, positions):
        accepted = bool(np.all(fit.deviation <= tolerance))
        if accepted and (best is None or score < best[1]):
            best = fit, score, fit.pieces
        elif best is not None and fit.pieces > best[2] * GROWTH**PATIENCE:
            break
    if best is None:
        return None
    wishes = ((True, True), (True, False), (False, True))
    for rests in wishes:
        found = _fitted(times, positions, best[2], rests)
        if found is not None and np.all(found[0].deviation <= tolerance) and found[1] <= REST_COST * best[1]:
            return found[0]
    return best[0]


def _candidates(times: Array, positions: Array) -> Iterator[tuple[Fit, float]]:
    """Yield fits with an increasing number of pieces, and their scores."""
    pieces, most = 1, len(times) // FEWEST_SAMPLES - DEGREE
    while pieces <= most:
        found = _fitted(times, positions, pieces, (False, False))
        if found is not None:
            yield found
        pieces = max(pieces + 1, int(pieces * GROWTH))


def _fitted(times: Array, positions: Array, pieces: int, rests: tuple[bool, bool]) -> tuple[Fit, float] | None:
    """Return the fit with a number of pieces and its score; None if the least-squares problem is singular.

    The score is the sum over the joints of RSS / (1 - p / k)^2 for p parameters and k samples.
    """
    from scipy.interpolate import BSpline  # loaded on use: see law/vdpbc/gains.py
    from scipy.linalg import solveh_banded

    breaks = times[np.rint(np.linspace(0, len(times) - 1, pieces + 1)).astype(int)]
    knots = np.concatenate([[breaks[0]] * DEGREE, breaks, [breaks[-1]] * DEGREE])
    expansion = _expansion(len(knots) - DEGREE - 1, rests)
    design = BSpline.design_matrix(times, knots, DEGREE) @ expansion
    parameters = design.shape[1]
    if parameters >= len(times):
        return None
    mean = positions.mean(axis=0)
    try:
        solution = solveh_banded(_band(design), design.T @ (positions - mean), lower=True, check_finite=False)
    except np.linalg.LinAlgError:
        return None
    spline = BSpline(knots, expansion @ solution, DEGREE)
    jets = np.stack([spline(breaks, order) for order in range(JETS)], axis=1)
    jets[:, 0] += mean
    for end in np.flatnonzero(rests):
        jets[-end, 1:] = 0.0  # exact instead of rounded
    residuals = design @ solution + mean - positions
    score = float(np.sum(residuals**2) / (1 - parameters / len(times)) ** 2)
    return Fit(breaks, jets, np.abs(residuals).max(axis=0), rests), score


def _expansion(coefficients: int, rests: tuple[bool, bool]) -> Any:
    """Return the sparse map from the parameters to the B-spline coefficients.

    At a clamped end the spline has the value of the outermost coefficient, and four zero derivatives if the outermost
    five coefficients are equal.
    """
    from scipy.sparse import csr_array

    first = JETS - 1 if rests[0] else 0
    last = JETS - 1 if rests[1] else 0
    parameters = coefficients - first - last
    column = np.clip(np.arange(coefficients) - first, 0, parameters - 1)
    entries = (np.ones(coefficients), (np.arange(coefficients), column))
    return csr_array(entries, shape=(coefficients, parameters))


def _band(design: Any) -> NDArray[np.float64]:
    """Return the lower band (10, p) of the normal equations."""
    normal = (design.T @ design).todia()
    band = np.zeros((DEGREE + 1, design.shape[1]))
    for offset in range(min(DEGREE + 1, design.shape[1])):
        band[offset, : design.shape[1] - offset] = normal.diagonal(-offset)
    return band
