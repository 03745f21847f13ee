# SPDX-License-Identifier: Apache-2.0
"""Friction of another shape at reversals: unknown jumps of velocity, which the likelihood averages out.

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

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fjr_core.numerics.checks import Array

from .elastic_arm import packed
from .multiple_shooting import PredictedSegments, Segment, Whitening
from .optimise import Progress, refine
from .shooting import Shooting

COLOURED = 0.15
"""Correlation r of a residual with the next one, beyond which friction has another shape.

Residuals of less, as of an autoregression, widen standard deviations by sqrt((1 + r) / (1 - r)) < 1.17, which the
scores of segments show without jumps.
"""
LAGS = np.array([-0.04, -0.02, -0.01, 0.0, 0.005, 0.01, 0.02, 0.04])  # s; from a reversal to the jumps
SHAPE = 0.2  # of the residuals of a signal, left by jumps at reversals where friction has another shape
FIRST = 1e-2  # rad/s; width of jumps before it is estimated
ROUNDS = 2
LEAST = 1e-9  # of the first width


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


def coloured(best: PredictedSegments) -> float:
    """Return the largest share of the square of a signal's residuals that changes slowly: 0 for white ones."""
    shares = []
    for k, signal in enumerate(best.problem.signals):
        pairs = zip(best.problem.segments, best.compared, strict=True)
        residuals = [segment.measured(*signal) - compared.predicted[k] for segment, compared in pairs]
        steps = np.concatenate([np.diff(residual) for residual in residuals])
        shares.append(1 - np.nanmean(steps**2) / 2 / np.nanmean(np.concatenate(residuals) ** 2))
    return float(np.max(shares))


def with_reversals(best: PredictedSegments, progress: Progress) -> PredictedSegments:
    """Return the most likely parameters with jumps at reversals, if residuals at `best` are coloured; else `best`."""
    if coloured(best) < COLOURED:
        return best
    width = first = np.full(len(LAGS) * best.x0.shape[1] // 2, FIRST)
    for _ in range(ROUNDS):
        problem = replace(best.problem, reversals=Reversals(best.problem.shooting, width))
        best = refine(problem, best.z, best.x0, best.noise, progress)
        jumps = [segment.whitening for segment in best.compared if segment.whitening is not None]
        squares, counts = (np.asarray(sum(getattr(jump, name) for jump in jumps)) for name in ("squares", "counts"))
        width = np.maximum(np.sqrt(squares / np.maximum(counts, 1)), LEAST * first)
    return best


def joints_with_jumps(smooth: PredictedSegments, best: PredictedSegments) -> set[int]:
    """Return the joints whose friction has another shape: jumps at reversals explain most of what is left without."""
    pairs = zip(best.problem.signals, best.residual < SHAPE * smooth.residual, strict=True)
    return {joint for (_, joint), explained in pairs if explained}
