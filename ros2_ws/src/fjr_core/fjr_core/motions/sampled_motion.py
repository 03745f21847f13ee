# SPDX-License-Identifier: Apache-2.0
"""Reference along the samples of a motion: smoothed where they are dense, interpolated where they are waypoints.

Dense samples are smoothed to class C^4 by a least-squares spline of degree 9. The number of pieces minimises the
generalised cross-validation score (Craven and Wahba, 1979), which estimates the error of prediction without knowing the
noise. Rounding of the samples is averaged out instead of being differentiated four times. The largest deviation from
the samples must stay within a tolerance.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..errors import TrajectoryError
from ..numerics.checks import Array, floats, freeze
from ..numerics.one_line import joints, span
from .piecewise_polynomial import DEGREE, PolynomialReference, minimum_jerk
from .reference import JETS
from .spline import Spline

FEWEST_SAMPLES = 3
"""Samples per piece, at least; with fewer the least-squares problem leaves no noise to average."""
REST_COST = 2.0
"""Largest ratio of the scores with and without rest at an end for which the samples are taken to rest there."""
GROWTH, PATIENCE = 1.5, 2
"""Ratio of successive numbers of pieces; the search ends this many numbers after the best one."""
MOST_WAYPOINTS = 20_000
CHECKED = 8  # instants per interval at which the spline is compared with the motion


@dataclass(frozen=True, eq=False)
class SampledMotion(PolynomialReference):
    """Reference of class C^4 from samples: positions (k, n) [rad] at increasing times (k,) [s], the first at 0.

    Dense samples are smoothed by the least-squares spline whose largest deviation is at most `tolerance`, one number
    for all joints or (n,) [rad, m]. If there is none, or with tolerance 0 of a joint, the samples are waypoints: a
    Spline interpolates them, and the velocities (k, n) [rad/s] if given. A motion that starts at speed is at that speed
    at t = 0. A motion that ends at speed is continued until it is at rest, with about the largest acceleration of the
    samples.
    Raises TrajectoryError as Spline does, and for a tolerance that is negative, NaN or of another length.
    """

    times: ArrayLike
    positions: ArrayLike
    tolerance: ArrayLike
    velocities: ArrayLike | None = None
    deviation: Array = field(init=False, repr=False)
    """Largest distance (n,) [rad] of the reference from the samples."""
    smoothed: bool = field(init=False)

    def __repr__(self) -> str:
        kind = f"smoothed within {self.deviation.max():.2g}" if self.smoothed else "interpolated"
        samples = f"{np.size(self.times)} samples {kind}"
        return f"SampledMotion({joints(self.n)}, {samples}, {span(self.knot_times)})"

    def __post_init__(self) -> None:
        waypoints = Spline(self.times, self.positions, self.velocities, moving_end=self.velocities is not None)
        for name in ("times", "positions", "velocities"):
            if getattr(waypoints, name) is not None:
                freeze(self, name, np.array(getattr(waypoints, name)))
        t, q = np.asarray(self.times), np.asarray(self.positions)
        tolerance = _tolerance(self.tolerance, q.shape[1])
        freeze(self, "tolerance", tolerance)
        fit = least_squares_fit(t, q, tolerance) if np.all(tolerance > 0) else None
        if fit is None:
            times, jets = waypoints.knot_times, waypoints.knot_jets
        else:
            times, jets = fit.times, fit.jets
        self.set_knots(*_brought_to_rest(times, jets))
        object.__setattr__(self, "smoothed", fit is not None)
        freeze(self, "deviation", np.zeros(q.shape[1]) if fit is None else fit.deviation)


def _tolerance(given: ArrayLike, n: int) -> Array:
    """Return the tolerance of each joint (n,); raise TrajectoryError."""
    array = floats("tolerance", given, TrajectoryError)
    if array.shape not in ((), (1,), (n,)):
        expected = "1" if n == 1 else f"1 or {n}, one per joint"
        raise TrajectoryError(f"tolerance has length {array.size}; expected {expected}")
    if not np.all(array >= 0):
        raise TrajectoryError(f"tolerance is {array.tolist()}; expected 0 or more")
    return np.array(np.broadcast_to(array, n))


def _brought_to_rest(times: Array, jets: Array) -> tuple[Array, Array]:
    """Append a knot at rest after times (k,) [s] and jets (k, 5, n) that end in motion."""
    last = jets[-1]
    if not last[1:].any():
        return times, jets
    speed, acceleration = np.abs(last[1]), np.abs(jets[:, 2]).max(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        duration = np.nanmax(np.append(3 * speed / acceleration, np.diff(times)[-1]))
    duration = float(np.clip(duration, np.diff(times)[-1], times[-1] - times[0]))
    free = np.zeros((2, JETS), dtype=bool)
    free[1, 0] = np.any(speed**2 > 2e-3 * np.abs(last[2]))  # of least jerk, unless it can stop within 1 mrad or mm
    ends = minimum_jerk(np.array([0.0, duration]), np.stack([last, np.vstack([last[:1], 0 * last[1:]])]), free)
    return np.append(times, times[-1] + duration), np.concatenate([jets, ends[1:]])


class SplineFit(NamedTuple):
    """A least-squares spline: breakpoints (m + 1,) [s], jets (m + 1, 5, n) there, largest deviation (n,) [rad].

    score: the sum over the joints of RSS / (1 - p / k)^2 for p parameters and k samples.
    """

    times: Array
    jets: Array
    deviation: Array
    score: float


def least_squares_fit(times: Array, positions: Array, tolerance: float | Array) -> SplineFit | None:
    """Return the fit of samples (k, n) [rad] at increasing times (k,) [s]; None if none is within the tolerance.

    tolerance: largest deviation [rad, m], one number or (n,).
    At an end where the samples rest, to the resolution of the fit, all derivatives of the fit are exactly zero.
    """
    best, pieces, chosen = None, 1, 1
    while pieces <= len(times) // FEWEST_SAMPLES - DEGREE:
        found = _fitted(times, positions, pieces, (False, False))
        if found is not None and np.all(found.deviation <= tolerance) and (best is None or found.score < best.score):
            best, chosen = found, pieces
        elif found is not None and best is not None and pieces > chosen * GROWTH**PATIENCE:
            break
        pieces = max(pieces + 1, int(pieces * GROWTH))
    if best is None:
        return None
    for rests in ((True, True), (True, False), (False, True)):
        found = _fitted(times, positions, chosen, rests)
        if found is not None and np.all(found.deviation <= tolerance) and found.score <= REST_COST * best.score:
            return found
    return best


def _fitted(times: Array, positions: Array, pieces: int, rests: tuple[bool, bool]) -> SplineFit | None:
    """Return the fit with a number of pieces; None if the least-squares problem is singular.

    rests: at the first and at the last sample, where all derivatives of the fit are then zero.
    """
    from scipy.interpolate import BSpline  # loaded on use: SciPy takes a third of a node's start-up
    from scipy.linalg import solveh_banded

    breaks = times[np.rint(np.linspace(0, len(times) - 1, pieces + 1)).astype(int)]
    knots = np.concatenate([[breaks[0]] * DEGREE, breaks, [breaks[-1]] * DEGREE])
    expansion = _expansion(len(knots) - DEGREE - 1, rests)
    design = BSpline.design_matrix(times, knots, DEGREE) @ expansion
    parameters = design.shape[1]
    if parameters >= len(times):
        return None
    mean, normal = positions.mean(axis=0), (design.T @ design).todia()
    band = np.zeros((DEGREE + 1, parameters))
    for offset in range(min(DEGREE + 1, parameters)):
        band[offset, : parameters - offset] = normal.diagonal(-offset)
    try:
        solution = solveh_banded(band, design.T @ (positions - mean), lower=True, check_finite=False)
    except np.linalg.LinAlgError:
        return None
    spline = BSpline(knots, expansion @ solution, DEGREE)
    jets = np.stack([spline(breaks, order) for order in range(JETS)], axis=1)
    jets[:, 0] += mean
    for end in np.flatnonzero(rests):
        jets[-end, 1:] = 0.0  # exact instead of rounded
    residuals = design @ solution + mean - positions
    score = float(np.sum(residuals**2) / (1 - parameters / len(times)) ** 2)
    return SplineFit(breaks, jets, np.abs(residuals).max(axis=0), score)


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


def waypoints(motion: SampledMotion, tolerance: float) -> tuple[Array, Array]:
    """Return waypoints whose Spline is within `tolerance` [rad] of the motion: its knots, and points between them.

    These are times (k,) [s] and rows (3, k, n) of position, velocity and acceleration, the last at rest. The intervals
    are halved until this holds, or until the next halving would give more than MOST_WAYPOINTS points.
    """
    times = motion.knot_times
    while True:
        jets = motion.jets(times)
        jets[-1, 1:] = 0.0
        rows = jets[:, :3].swapaxes(0, 1)
        spline = Spline(times, *rows)
        between = (times[:-1, None] + np.diff(times)[:, None] * np.arange(1, CHECKED) / CHECKED).ravel()
        error = np.abs(spline.jets(between)[:, 0] - motion.jets(between)[:, 0]).max()
        if error <= tolerance or 2 * len(times) > MOST_WAYPOINTS:
            return times, rows
        times = np.sort(np.concatenate([times, times[:-1] + np.diff(times) / 2]))
