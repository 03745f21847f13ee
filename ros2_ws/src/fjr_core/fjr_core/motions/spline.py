# SPDX-License-Identifier: Apache-2.0
"""References of class C^4 through points, and along the samples of a motion.

Dense samples are smoothed by a least-squares spline of degree 9. The number of pieces minimises the generalised
cross-validation score (Craven and Wahba, 1979), which estimates the error of prediction without knowing the noise.
Rounding of the samples is averaged out instead of being differentiated four times. The largest deviation from the
samples must stay within a tolerance. Other samples are waypoints, and interpolated.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import TrajectoryError
from ..numerics import checks
from ..numerics.checks import Array, freeze
from ..numerics.one_line import joints, span
from .piecewise_polynomial import DEGREE, PolynomialReference, minimum_jerk, without_overshoot
from .reference import JETS

SHORTEST = 1e-6  # s, smallest interval between points
FAR, STANDSTILL = 2.0, 1.0  # s; a motion whose next point is more than FAR ahead comes to a standstill first
FEWEST_SAMPLES = 3
"""Samples per piece, at least; with fewer the least-squares problem leaves no noise to average."""
REST_COST = 2.0
"""Largest ratio of the scores with and without rest at an end for which the samples are taken to rest there."""
GROWTH, PATIENCE = 1.5, 2
"""Ratio of successive numbers of pieces; the search ends this many numbers after the best one."""
MOST_WAYPOINTS = 20_000
CHECKED = 8  # instants per interval at which the spline is compared with the motion


@dataclass(frozen=True, eq=False)
class Spline(PolynomialReference):
    """Reference through positions (k, n) [rad] at increasing times (k,) [s]: polynomials of degree 9, class C^4.

    velocities [rad/s], accelerations [rad/s^2]: (k, n) or None, interpolated at the points. Derivatives that are not
    given minimise the jerk and are reduced where a segment would overshoot (piecewise_polynomial.py); they are zero at
    an end with zero velocity.
    start: jets (5, n) of the active reference at t = 0, from which the spline starts; all times must be > 0. If start
    moves and the first point is more than FAR ahead, the spline comes to a standstill within STANDSTILL, over half the
    distance of constant velocity: a single polynomial would swing out by jets times powers of its duration. Without
    start, the spline starts at the first point with the velocity and acceleration given there; before, it is constant.
    At the last point the spline stops: a velocity given there must be zero, an acceleration is ignored.
    moving_end: interpolate velocity and acceleration of the last point; after it the reference is constant.
    Raises TrajectoryError for inconsistent shapes, non-finite numbers, times that do not increase, or fewer than two
    points (one with start).
    """

    times: ArrayLike
    positions: ArrayLike
    velocities: ArrayLike | None = None
    accelerations: ArrayLike | None = None
    start: ArrayLike | None = None
    moving_end: bool = False

    def __repr__(self) -> str:
        return f"Spline({joints(self.n)}, {np.size(self.times)} points, {span(self.knot_times)})"

    def __post_init__(self) -> None:
        n = _freeze_points(self, self.start is not None)
        if self.start is not None:
            start, shape = checks.finite("start", self.start, TrajectoryError), (JETS, n)
            if start.shape != shape:
                raise TrajectoryError(f"start has shape {start.shape}; expected {shape}, value and four derivatives")
            freeze(self, "start", start)
        if self.velocities is not None and not self.moving_end and np.any(last := np.asarray(self.velocities)[-1]):
            raise TrajectoryError(f"velocities ends with {last.tolist()}; expected zeros at the last point")
        self._interpolate()

    def _interpolate(self) -> None:
        """Set the knots: the points, and those before them, with the free derivatives chosen."""
        times, (jets, free) = np.asarray(self.times), self._given()
        if self.start is not None:
            begin, before = np.asarray(self.start)[None], [0.0]
            if times[0] > FAR and np.any(begin[:, 1:]):
                begin, before = np.concatenate([begin, np.zeros_like(begin)]), [0.0, STANDSTILL]
                begin[1, 0] = begin[0, 0] + begin[0, 1] * STANDSTILL / 2
            times, jets = np.concatenate([before, times]), np.concatenate([begin, jets])
            free = np.concatenate([np.zeros((len(before), JETS), dtype=bool), free])
        try:
            with np.errstate(all="ignore"):
                jets = without_overshoot(times, minimum_jerk(times, jets, free), free) if free.any() else jets
        except np.linalg.LinAlgError:  # the system is not positive definite to rounding
            jets = np.full_like(jets, np.nan)
        self.set_knots(times, jets)
        if not self.finite:
            raise TrajectoryError("positions and times lead to numbers that are not finite; expected smaller ones")

    def _given(self) -> tuple[Array, NDArray[np.bool_]]:
        """Return the jets (k, 5, n) of the points, zero where not given, and the mask (k, 5) of the free ones."""
        rows = (self.positions, self.velocities, self.accelerations)
        k, n = np.shape(self.positions)
        jets, free = np.zeros((k, JETS, n)), np.ones((k, JETS), dtype=bool)
        for order, row in enumerate(rows):
            if row is not None:
                jets[:, order], free[:, order] = row, False
        if not self.moving_end:
            jets[-1, 1:] = 0.0
        for end in (0, -1):
            if not np.any(jets[end, 1:]) and not (end == 0 and self.start is not None):
                free[end] = False
        return jets, free


def _points(name: str, value: ArrayLike, shape: tuple[int, ...] | None = None) -> Array:
    """Return `value` as finite numbers (k, n); raise TrajectoryError."""
    array = checks.floats(name, value, TrajectoryError, " (k, n)")
    if shape is None and (array.ndim != 2 or not array.size):
        raise TrajectoryError(f"{name} has shape {array.shape}; expected (k, n), a row for each point")
    if shape is not None and array.shape != shape:
        raise TrajectoryError(f"{name} has shape {array.shape}; expected that of positions, {shape}")
    wrong = np.argwhere(~np.isfinite(array))
    if len(wrong):
        point, joint = wrong[0]
        raise TrajectoryError(
            f"{name} holds {array[point, joint]} at point {point}, joint {joint}; expected finite numbers"
        )
    return array


def _freeze_points(reference: Spline | SampledMotion, starts: bool = False) -> int:
    """Check times and rows of a reference and store them as arrays; return the number of joints. starts: from jets.

    Raise TrajectoryError.
    """
    positions = _points("positions", reference.positions)
    times = checks.finite("times", reference.times, TrajectoryError)
    if times.shape != positions.shape[:1]:
        raise TrajectoryError(f"times has shape {times.shape}; expected {positions.shape[:1]}, one per point")
    freeze(reference, "times", times)
    freeze(reference, "positions", positions)
    for name in ("velocities", "accelerations"):
        if getattr(reference, name, None) is not None:
            freeze(reference, name, _points(name, getattr(reference, name), positions.shape))
    if len(times) < 2 and not starts:
        raise TrajectoryError("times has 1 point; expected at least 2, or 1 with start")
    if starts and times[0] < SHORTEST:
        raise TrajectoryError(f"times begins with {times[0]} s; expected more than 0, the time of start")
    stalls = np.flatnonzero(np.diff(times) < SHORTEST)
    if len(stalls):
        i = int(stalls[0])
        first, second = (f"{times[j]} s at point {j}" for j in (i, i + 1))
        raise TrajectoryError(f"times goes from {first} to {second}; expected an increase of at least {SHORTEST:g} s")
    return int(positions.shape[1])


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
        n = _freeze_points(self)
        t, q = np.asarray(self.times), np.asarray(self.positions)
        if t[0]:  # before the first sample the reference is constant, which is no C^4 beginning of a moving one
            raise TrajectoryError(f"times begins with {t[0]} s; expected 0")
        given = checks.floats("tolerance", self.tolerance, TrajectoryError)
        if not np.all(given >= 0):
            raise TrajectoryError(f"tolerance is {given.tolist()}; expected 0 or more")
        tolerance = checks.filled("tolerance", given.squeeze(), (n,), TrajectoryError)
        freeze(self, "tolerance", tolerance)
        fit = least_squares_fit(t, q, tolerance) if np.all(tolerance > 0) else None
        if fit is None:
            waypoints = Spline(t, q, self.velocities, moving_end=self.velocities is not None)
            times, jets = waypoints.knot_times, waypoints.knot_jets
        else:
            times, jets = fit.times, fit.jets
        self.set_knots(*_brought_to_rest(times, jets))
        object.__setattr__(self, "smoothed", fit is not None)
        freeze(self, "deviation", np.zeros(n) if fit is None else fit.deviation)


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
