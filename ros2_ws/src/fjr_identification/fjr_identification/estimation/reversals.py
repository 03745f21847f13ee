# SPDX-License-Identifier: Apache-2.0
"""Friction of another shape at reversals: unknown jumps of position and velocity, which the likelihood averages out.

Where a side of a joint reverses, friction of an unknown shape (bristles, a Stribeck level, a slower turn) differs from
the model for some milliseconds only. What remains of such a torque is a jump of the position and of the velocity of
this side, and another one shortly after, random with a normal distribution: with S_x(t) = dx(t) / dx(0),

    r(t) = S_x(t) S_x(t_k)^-1 e iota_k + noise,  t > t_k,   iota_k ~ N(0, width^2)

The mean jumps are eliminated like the initial states (a ridge regression), and the information that they take away is
that of the generalised least squares of r. Their widths are estimated by expectation and maximisation (A. Dempster, N.
Laird, D. Rubin, J. R. Stat. Soc. B 39(1), 1977). Records whose residuals are white need none.
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
"""Share of the square of a residual that changes slowly, beyond which friction has another shape."""
LATER = 0.01  # s; of the second jump: bristles bend until the side has moved by some of their length
FIRST = (1e-4, 1e-2)  # rad, rad/s; widths of jumps before they are estimated
ROUNDS = 2
LEAST = 1e-9  # of the first width


@dataclass(frozen=True, eq=False)
class Reversals:
    """Jumps of the states (4n,) at reversals of their side, with standard deviations width (4n,).

    found: responses of each segment to the jumps of its first prediction. They stay, so that the likelihood is a smooth
    function of the parameters, whose derivative is that of the normal equations.
    """

    shooting: Shooting
    width: Array
    found: dict[tuple[int, int, int], tuple[Array, NDArray[np.intp]]] = field(default_factory=dict)

    def responses(
        self, segment: Segment, X: Array, S: Array, p: Mapping[str, Array], J: Array
    ) -> tuple[Array, NDArray[np.intp]]:
        """Return what jumps of one width change of the signals (signals, count, m), and their states (m,).

        X, S: states and sensitivities of the segment; J (signals, count, columns): derivatives, first by the initial
        state. A jump of a link moves the others as an impulse does.
        """
        n = len(segment.record.joints)
        velocity = X[segment.pad : segment.pad + segment.count + 1, 2 * n :]
        at, sides = np.nonzero(np.diff(np.sign(velocity), axis=0))
        later = at + max(1, round(LATER / segment.record.dt))
        at, sides = np.concatenate([at, later]), np.tile(sides, 2)
        at, sides = at[at < segment.count], sides[at < segment.count]
        moved = np.eye(2 * n)
        if len(at):
            q = X[segment.pad + segment.count // 2, :n]
            mobility = np.linalg.inv(self.shooting.arm.link_inertia(q, packed(self.shooting.arm, p)).full())
            moved[:n, :n] = mobility / np.diag(mobility)
        parts = [np.zeros((*J.shape[:2], 0))]
        for k, side in zip(at, sides, strict=True):
            jump = np.kron(np.eye(2), moved[:, [side]]) * self.width[[side, 2 * n + side]]
            start = np.linalg.lstsq(S[segment.pad + k + 1][:, : 4 * n], jump, rcond=1e-13)[0]
            part = J[:, :, : 4 * n] @ start
            part[:, : k + 1] = 0.0
            parts.append(part)
        return np.concatenate(parts, axis=2), np.stack([sides, 2 * n + sides], axis=1).ravel()

    def whitened(
        self, segment: Segment, X: Array, S: Array, p: Mapping[str, Array], J: Array, r: Array, noise: Array
    ) -> tuple[Array, Array, Whitening]:
        """Return (1 + N N')^-1/2 times J and r, which jumps of a segment correlate, and what they explain of r.

        J (signals, count, columns), r (signals, count), as above, in units of the noise (signals,).
        """
        key = id(segment.record), segment.first, segment.count
        if key not in self.found:
            N, states = self.responses(segment, X, S, p, J)
            self.found[key] = N * noise[:, None, None], states
        N, states = self.found[key]
        U, s, Vt = np.linalg.svd((N / noise[:, None, None]).reshape(r.size, -1), full_matrices=False)
        J_and_r = np.concatenate([J, r[..., None]], axis=2).reshape(r.size, -1)
        on_jumps = U.T @ J_and_r
        white = (J_and_r - U @ ((1 - 1 / np.sqrt(1 + s**2))[:, None] * on_jumps)).reshape(*r.shape, -1)
        on_r = on_jumps[:, -1]
        iota, kept = Vt.T @ (s / (1 + s**2) * on_r), np.sum(Vt**2 * (s**2 / (1 + s**2))[:, None], axis=0)
        expected = (iota**2 + 1 - kept) * self.width[states] ** 2
        squares, counts = (
            np.bincount(states, weight, len(self.width)).astype(float) for weight in (expected, np.ones(len(states)))
        )
        explained = (U @ (s**2 / (1 + s**2) * on_r)).reshape(r.shape)
        return (
            np.ascontiguousarray(white[..., :-1]),
            white[..., -1],
            Whitening(explained, float(iota @ iota), squares, counts),
        )


def coloured(best: PredictedSegments) -> float:
    """Return the largest share of the square of a signal's residuals that changes slowly: 0 for white ones."""
    shares = []
    for k, signal in enumerate(best.problem.signals):
        pairs = zip(best.problem.segments, best.compared, strict=True)
        residuals = [segment.measured(*signal) - compared.predicted[k] for segment, compared in pairs]
        steps = np.concatenate([np.diff(residual) for residual in residuals])
        shares.append(1 - np.nanmean(steps**2) / 2 / np.nanmean(np.concatenate(residuals) ** 2))
    return float(np.max(shares))


def with_reversals(best: PredictedSegments, converged: bool, progress: Progress) -> tuple[PredictedSegments, bool]:
    """Return the most likely parameters with jumps at reversals, if residuals at `best` are coloured; else `best`."""
    if coloured(best) < COLOURED:
        return best, converged
    n = best.x0.shape[1] // 4
    first = np.repeat(FIRST, 2 * n)
    width = first
    for _ in range(ROUNDS):
        problem = replace(best.problem, reversals=Reversals(best.problem.shooting, width))
        best, converged = refine(problem, best.z, best.x0, best.noise, progress)
        jumps = [segment.whitening for segment in best.compared if segment.whitening is not None]
        squares, counts = (np.asarray(sum(getattr(jump, name) for jump in jumps)) for name in ("squares", "counts"))
        width = np.maximum(np.sqrt(squares / np.maximum(counts, 1)), LEAST * first)
    return best, converged
