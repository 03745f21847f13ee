# SPDX-License-Identifier: Apache-2.0
"""Maximise the likelihood over z and the initial states of all segments: Levenberg-Marquardt, variable projection.

A step of z maximises the quadratic model of log L without the initial states, with parameters that are not negative
held so (bounded-variable least squares); the initial states follow it and are settled at the trial point.

Where a side of a joint reverses, friction of an unknown shape (bristles, a Stribeck level, a slower turn) differs from
the model for some milliseconds before and after. The momentum that such a torque adds is a jump of the velocity of this
side at each of LAGS from its reversal, random with a normal distribution: with S_x(t) = dx(t) / dx(0),

    r(t) = S_x(t) S_x(t_k)^-1 e iota_k + noise,  t > t_k,   iota_k ~ N(0, width^2)

The mean jumps are eliminated like the initial states (a ridge regression), and the information that they take away is
that of the generalised least squares of r. Their widths, one a side and lag, are estimated by expectation and
maximisation (A. Dempster, N. Laird, D. Rubin, J. R. Stat. Soc. B 39(1), 1977). Records whose residuals are white need
none.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from fjr_core.errors import StateError
from fjr_core.numerics.checks import Array

from .elastic_arm import packed
from .multiple_shooting import SOFT, PredictedSegments, Problem, Segment, Whitening
from .shooting import Shooting

MOST_ITERATIONS = 30  # of Gauss and Newton
HORIZONS = (16, 4, 1)  # shares of the segments that are compared first
FEW = 24  # segments of the first descent
NEAR, CONVERGED = 1.0, 0.1  # standard deviations from the minimum that the normal equations predict
NEGLIGIBLE = 1e-5  # of the prior's width; a smaller step is rounding, in records without noise
SIMILAR = 0.1  # of the logarithm of noise levels
ROUGHLY, LEAST_DECREASE = 0.5, 1e-2  # of -log L; a descent ends with a step that gains less
STALLED, PATIENCE = 0.01, 3  # share of the decrease that the normal equations predict, and steps in a row below it
ROUNDING = 1e-13  # of the largest eigenvalue; information loses as much where initial states take nearly all of it
HARDEST = 1e3  # damping at which no step is found
COLOURED = 0.15
"""Correlation r of a residual with the next one, beyond which friction has another shape.

Residuals of less, as of an autoregression, widen standard deviations by sqrt((1 + r) / (1 - r)) < 1.17, which the
scores of segments show without jumps.
"""
LAGS = np.array([-0.04, -0.02, -0.01, 0.0, 0.005, 0.01, 0.02, 0.04])  # s; from a reversal to the jumps
SHAPE = 0.2  # of the residuals of a signal, left by jumps at reversals where friction has another shape
SLOWLY = 0.5  # of the squares of what model and jumps leave of a signal, where the model lacks something else
FIRST = 1e-2  # rad/s; width of jumps before it is estimated
ROUNDS, LEAST_WIDTH = 2, 1e-9  # of the estimates of widths; of the first width

Progress = Callable[[float], None]


def optimise(problem: Problem, z: Array, x0: Array, progress: Progress = lambda share: None) -> PredictedSegments:
    """Return the prediction at the most likely z and initial states.

    First on the beginnings of some segments, which are nearly linear in z and in the initial states, then on longer
    parts of them, at last on all. Raises StateError if the prediction of the start is not finite.
    """
    stride = max(1, len(problem.segments) // FEW)
    some, noise = x0[::stride], problem.rough_noise
    for k, share in enumerate(HORIZONS):
        at, _ = descended(problem.part(stride, share), z, some, noise, NEAR, ROUGHLY, _of_stage(progress, k))
        z, some, noise = at.z, at.x0, at.residual
    x0 = some if stride == 1 else x0
    for share in HORIZONS[:-1] if stride > 1 else ():
        part = problem.part(1, share).evaluate(z, x0, noise)
        x0 = x0 if part is None else part.x0
    return refine(problem, z, x0, noise, _of_stage(progress, len(HORIZONS)))


def _of_stage(progress: Progress, stage: int) -> Progress:
    """Return the progress of one of the stages of `optimise`."""
    return lambda share: progress((stage + share) / (len(HORIZONS) + 1))


def refine(
    problem: Problem, z: Array, x0: Array, noise: Array, progress: Progress = lambda share: None
) -> PredictedSegments:
    """Return the prediction at the most likely z and initial states, from start values near them; see `optimise`.

    noise (signals,): near theirs. The prediction is in units of the noise there, unbiased by the estimated numbers.
    """
    at, converged = descended(problem, z, x0, noise, CONVERGED, LEAST_DECREASE, progress)
    count = np.asarray(sum(segment.counts for segment in at.compared)).sum()
    unbiased = at.residual * np.sqrt(count / max(count - at.x0.size - len(at.z), 1))
    best = problem.evaluate(at.z, at.x0, unbiased)
    assert best is not None
    return replace(best, converged=converged)


def descended(
    problem: Problem,
    z: Array,
    x0: Array,
    noise: Array,
    near: float,
    least: float,
    progress: Progress = lambda share: None,
) -> tuple[PredictedSegments, bool]:
    """Return the end of the descent, and whether it is at the minimum; noise (signals,): expected.

    It ends within `near` standard deviations of the minimum, or after a step that lowers -log L by less than `least`,
    or after some that gain next to nothing of what the normal equations predict: the model has a kink there.
    Raises StateError if the prediction of the start is not finite.
    """
    at, damping, stalled = problem.evaluate(z, x0, noise), SOFT, 0
    if at is not None and np.max(np.abs(np.log(at.residual / noise))) > SIMILAR:
        at = problem.evaluate(z, at.x0, at.residual)  # in units of the noise there
    if at is None:
        raise StateError("the predicted motion does not stay finite; expected a prior nearer to the robot")
    for iteration in range(MOST_ITERATIONS):
        away = distance(at)
        progress(iteration / (iteration + np.log1p(away)) if iteration else 0.0)
        step = None if away < near else _search(at, damping)
        if step is None:
            break
        before, (at, damping) = at.cost, step
        stalled = stalled + 1 if before - at.cost < STALLED * away**2 / 2 else 0
        if before - at.cost < least or stalled == PATIENCE:
            break
    negligible = np.max(np.abs(parameter_step(at, 0.0)) / problem.coordinates.width) < NEGLIGIBLE
    return at, bool(distance(at) < NEAR or negligible)


def _search(at: PredictedSegments, damping: float) -> tuple[PredictedSegments, float] | None:
    """Return a prediction of less cost, and the next damping; None if there is none.

    The first trial moves the initial states to their own minimum, too; a short step of z alone always lowers the cost.
    """
    settled = np.array([part.a for part in at.projected])
    while damping < HARDEST:
        dz = parameter_step(at, damping)
        moved = at.x0 - np.array([part.B @ dz for part in at.projected])
        trial = at.problem.evaluate(at.z + dz, moved + settled, at.residual)
        if trial is not None and trial.cost < at.cost:
            return trial, max(damping / 100, 1e-12)
        settled, damping = np.zeros_like(settled), max(100 * damping, SOFT)
    return None


def parameter_step(at: PredictedSegments, damping: float) -> Array:
    """Return the damped step of z; one beyond twice the prior's width is shortened.

    Friction and damping do not become negative: a motor with negative friction does not stay at rest.
    """
    coordinates = at.problem.coordinates
    dz = bounded_step(*at.normal_equations, at.z, coordinates.nonnegative, damping)
    return np.asarray(dz / max(1.0, float(np.max(np.abs(dz) / coordinates.width, initial=0.0)) / 2))


def distance(at: PredictedSegments) -> float:
    """Return how many standard deviations the minimum of the quadratic model is away from z."""
    H, g = at.normal_equations
    dz = bounded_step(H, g, at.z, at.problem.coordinates.nonnegative)
    return float(np.sqrt(np.maximum(0.0, 2 * float(g @ dz) - float(dz @ H @ dz))))


def bounded_step(H: Array, g: Array, z: Array, bounded: Array, damping: float = 0.0) -> Array:
    """Return the step (p,) that maximises g' step - step' (H + damping diag H) step / 2.

    H (p, p): positive definite but for rounding. z + step is not negative where bounded (p,).
    """
    if not len(z):
        return np.zeros(0)
    scale = np.sqrt(np.diag(H))
    w, V = np.linalg.eigh(H / np.outer(scale, scale) + damping * np.eye(len(z)))
    root, least = np.sqrt(np.maximum(w, ROUNDING * w[-1])), np.where(bounded, -z * scale, -np.inf)
    return np.asarray(lsq_linear((V * root).T, V.T @ (g / scale) / root, (least, np.inf), method="bvls").x / scale)


@dataclass(frozen=True, eq=False)
class Reversals:
    """Jumps of the velocities of both sides at LAGS from their reversals, with standard deviations width (8 * 2n,).

    found: responses of each segment to the jumps of its first prediction. They stay, so that the likelihood is a smooth
    function of the parameters, whose derivative is that of the normal equations.
    """

    shooting: Shooting
    width: Array
    found: dict[tuple[int, int, int], tuple[Array, NDArray[np.intp]]] = field(default_factory=dict)

    def responses(
        self, segment: Segment, X: Array, S: Array, p: Mapping[str, Array], J: Array
    ) -> tuple[Array, NDArray[np.intp]]:
        """Return what jumps of one width change of the signals (signals, count, m), and their widths' places (m,).

        X, S: states and sensitivities of the segment; J (signals, count, columns): derivatives, first by the initial
        state. A jump of a link moves the others as an impulse does.
        """
        n = len(segment.record.joints)
        reversal, sides = np.nonzero(np.diff(np.sign(X[:, 2 * n :]), axis=0))
        lags = np.round(LAGS / segment.record.dt).astype(int)[:, None]
        at = reversal - segment.pad + lags
        places = 2 * n * np.arange(len(LAGS))[:, None] + sides
        inside = (at >= 0) & (at < segment.count)
        moved = np.eye(4 * n)[:, 2 * n :]
        if inside.any():
            q = X[segment.pad + segment.count // 2, :n]
            mobility = np.linalg.inv(self.shooting.arm.link_inertia(q, packed(self.shooting.arm, p)).full())
            moved[2 * n : 3 * n, :n] = mobility / np.diag(mobility)
        N = np.zeros((*J.shape[:2], int(inside.sum())))
        for column, (k, place) in enumerate(zip(at[inside], places[inside], strict=True)):
            jump = moved[:, place % (2 * n)] * self.width[place]
            start = np.linalg.lstsq(S[segment.pad + k + 1][:, : 4 * n], jump, rcond=1e-13)[0]
            N[:, k + 1 :, column] = J[:, k + 1 :, : 4 * n] @ start
        return N, places[inside]

    def whitened(
        self, segment: Segment, X: Array, S: Array, p: Mapping[str, Array], J: Array, r: Array, noise: Array
    ) -> tuple[Array, Array, Whitening]:
        """Return (1 + N N')^-1/2 times J and r, which jumps of a segment correlate, and what they explain of r.

        J (signals, count, columns), r (signals, count), as above, in units of the noise (signals,).
        """
        key = id(segment.record), segment.first, segment.count
        if key not in self.found:
            N, places = self.responses(segment, X, S, p, J)
            self.found[key] = N * noise[:, None, None], places
        N, places = self.found[key]
        N = (N / noise[:, None, None]).reshape(r.size, -1)
        w, V = np.linalg.eigh(N.T @ N)
        root = np.sqrt(1 + np.maximum(w, 0.0))[:, None]
        J_and_r = np.concatenate([J, r[..., None]], axis=2).reshape(r.size, -1)
        on_jumps = V.T @ (N.T @ J_and_r)
        white = (J_and_r - N @ (V @ (on_jumps / (root * (root + 1))))).reshape(*r.shape, -1)
        iota, left = V @ (on_jumps[:, -1] / root[:, 0] ** 2), V**2 @ root[:, 0] ** -2
        expected = (iota**2 + left) * self.width[places] ** 2
        squares, counts = (
            np.bincount(places, weight, len(self.width)).astype(float) for weight in (expected, np.ones(len(places)))
        )
        whitening = Whitening((N @ iota).reshape(r.shape), float(iota @ iota), squares, counts)
        return np.ascontiguousarray(white[..., :-1]), white[..., -1], whitening


def coloured(best: PredictedSegments) -> Array:
    """Return the share (signals,) of the squares that model and jumps leave which changes slowly: 0 for white ones."""
    shares = []
    for k, signal in enumerate(best.problem.signals):
        pairs = zip(best.problem.segments, best.compared, strict=True)
        jumps = [each.whitening.explained[k] * best.noise[k] if each.whitening else 0.0 for each in best.compared]
        smooth = [segment.measured(*signal) - compared.predicted[k] for segment, compared in pairs]
        residuals = [left - jump for left, jump in zip(smooth, jumps, strict=True)]
        steps = np.concatenate([np.diff(residual) for residual in residuals])
        shares.append(1 - np.nanmean(steps**2) / 2 / np.nanmean(np.concatenate(residuals) ** 2))
    return np.array(shares)


def with_reversals(best: PredictedSegments, progress: Progress) -> PredictedSegments:
    """Return the most likely parameters with jumps at reversals, if residuals at `best` are coloured; else `best`."""
    if np.max(coloured(best)) < COLOURED:
        return best
    width = first = np.full(len(LAGS) * best.x0.shape[1] // 2, FIRST)
    for _ in range(ROUNDS):
        problem = replace(best.problem, reversals=Reversals(best.problem.shooting, width))
        best = refine(problem, best.z, best.x0, best.noise, progress)
        jumps = [segment.whitening for segment in best.compared if segment.whitening is not None]
        squares, counts = (np.asarray(sum(getattr(jump, name) for jump in jumps)) for name in ("squares", "counts"))
        width = np.maximum(np.sqrt(squares / np.maximum(counts, 1)), LEAST_WIDTH * first)
    return best


def joints_lacking(smooth: PredictedSegments, best: PredictedSegments) -> tuple[set[int], set[int]]:
    """Return the joints whose friction has another shape, and those whose model lacks something else.

    Jumps at reversals explain most of what is left without them, or neither explains what changes slowly.
    """
    of = np.array([joint for _, joint in best.problem.signals])
    return {*of[best.residual < SHAPE * smooth.residual].tolist()}, {*of[coloured(best) > SLOWLY].tolist()}
