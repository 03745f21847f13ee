# SPDX-License-Identifier: Apache-2.0
"""Intervals: the covariance of the estimate from coloured residuals, and what the records alone say of each parameter.

Residuals of a wrong model are correlated over time. Segments have initial states of their own, so their scores
g_s = J_s' r_s are nearly independent, and the sandwich H^-1 (sum g_s g_s') H^-1 measures what the correlation does
(K.-Y. Liang, S. L. Zeger, Biometrika 73(1), 1986). Its standard deviations, where larger, replace those of H^-1; its
correlations do not, because it has the rank of the number of segments. The quantile is Student's.

A record has few segments, so a variance of the sandwich is uncertain by half. What is wrong with a model widens most
parameters: a factor of variance counts as at least the geometric mean of its own and of the median of all (G. K. Smyth,
Stat. Appl. Genet. Mol. Biol. 3(1), 2004: variances moderated by those of the others).

The sandwich takes the errors of segments to be independent. Those of a wrong model (friction of another shape) are not:
they displace the estimate in the same direction in each segment, which scores at the optimum, whose sum is 0, do not
show. The part of their squares that exceeds white residuals counts as correlated between all segments (SYSTEMATIC), so
that it does not average out however long the record is. No record shows this correlation. It is estimated from others
(tests/physics, seed 7001), where errors in standard deviations have mean square 1 at 0.36 with Dahl's friction, 0.06
with LuGre's and 0.02 with Stribeck's; the largest counts.

Part of the information about z in the normal equations is spurious: the records do not determine what it says. Initial
states fit noise: a spring at rest seems to swing, at a frequency that seems to reveal its stiffness. And initial states
have a prior: without a motor encoder the offset of a spring only shifts the motor, away from this prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.stats import norm, t

from fjr_core.numerics.checks import Array

from .multiple_shooting import RIDGE, NormalEquations, PredictedSegments

CONFIDENCE = 0.95
LAGS = 2
"""Segments over which scores are taken to be correlated, with the weights of Bartlett (W. Newey, K. West, 1987)."""
SYSTEMATIC, TWO_SIDED = 0.4, 2.0
"""Correlation of the errors of a model between segments, and standard deviations of what is due to chance."""
LEAST_DRAWS = 24  # of all segments together
CAUTION = 4.0  # factor on spurious information: noise is estimated from few draws, the prior's share to first order


@dataclass(frozen=True, eq=False)
class PosteriorCovariance:
    """Covariance (p, p) of z, and the standard deviations (p,) that the records alone give, inf: none."""

    covariance: Array
    from_records: Array


def posterior(
    parts: Sequence[NormalEquations], spurious: Array, width: Array, fixed: Sequence[int] = ()
) -> PosteriorCovariance:
    """Return the covariance of z from the normal equations of the segments and the prior's width (p,).

    spurious (p, p): information that does not count in from_records. fixed: entries of z that keep their prior; their
    uncertainty is that of the prior and acts on the others, and their own entries in from_records are inf.
    """
    H = np.asarray(sum(part.H for part in parts))
    free = [k for k in range(len(width)) if k not in fixed]
    chosen = H[np.ix_(free, free)]
    information = chosen + np.diag(width[free] ** -2.0)
    scale = np.sqrt(np.diag(information))
    inverse = np.linalg.inv(information / np.outer(scale, scale)) / np.outer(scale, scale)
    factor = inflation(np.array([part.g[free] for part in parts]), inverse)
    covariance = inverse * np.outer(factor, factor)
    if len(fixed):
        by_prior = inverse @ H[np.ix_(free, list(fixed))] * width[list(fixed)]
        covariance = covariance + by_prior @ by_prior.T
    alone = np.full(len(width), np.inf)
    alone[free] = _standard_deviations(chosen - spurious[np.ix_(free, free)], width[free]) * factor
    whole = np.zeros_like(H)
    whole[np.ix_(free, free)] = covariance
    return PosteriorCovariance(whole, alone)


def inflation(scores: Array, inverse: Array) -> Array:
    """Return by what factor (p,) standard deviations exceed those of white residuals, with Student's quantile.

    Errors of the model count as systematic, as above.

    scores (segments, p), inverse (p, p): of the information. The factor is at least that of the quantile.
    """
    count = len(scores)
    if not scores.size:
        return np.ones(scores.shape[1])
    scores = scores - scores.mean(axis=0)
    meat = scores.T @ scores
    for lag in range(1, min(LAGS, count - 1) + 1):
        product = scores[lag:].T @ scores[:-lag]
        meat = meat + (1 - lag / (LAGS + 1)) * (product + product.T)
    sandwich = np.diag(inverse @ meat @ inverse) * count / max(count - 1, 1)
    alone = np.mean((scores @ inverse) ** 2, axis=0) * count / np.diag(inverse)
    by_chance = 1 + TWO_SIDED * np.sqrt(2 / count)
    of_model = max(0.0, 1 - by_chance / max(by_chance, float(np.median(alone))))
    widened = np.maximum(sandwich / np.diag(inverse), 1.0)
    widened = np.maximum(widened, np.sqrt(widened * np.median(widened)))
    ratio = np.sqrt(widened * (1 + SYSTEMATIC * (count - 1) * of_model))
    quantile = (1 + CONFIDENCE) / 2
    return np.asarray(ratio * t.ppf(quantile, max(count - 1, 1)) / norm.ppf(quantile))


def _standard_deviations(H: Array, width: Array) -> Array:
    """Return the standard deviations that the information H gives, large but finite where it is not definite."""
    scale = np.sqrt(np.maximum(np.diag(H), width**-2.0))
    w, v = np.linalg.eigh(H / np.outer(scale, scale))
    least = 1e-12 * (1 + np.max(np.abs(w), initial=0.0))
    return np.asarray(np.sqrt((v**2) @ (1 / np.maximum(w, least))) / scale)


def spurious_information(best: PredictedSegments) -> Array:
    """Return CAUTION times the information (p, p) that is due to noise in initial states, and to their prior.

    Noise: growth of the information under disturbances of the initial states, which have their covariance and come with
    both signs, so that what is linear in them cancels. No segment loses more than it contains, before CAUTION. Prior
    and ridge: initial states follow z by -B dz, away from their prior: sum_s B' diag(1 / width^2 + ridge) B.
    """
    segments, size = best.x0.shape
    draws = max(1, LEAST_DRAWS // segments)
    normals = np.random.default_rng(0).standard_normal((segments, draws, size))
    by_noise = best.problem.of_each(lambda k: _growth(best, k, normals[k]))
    by_prior = []
    for compared, part in zip(best.compared, best.projected, strict=True):
        weight = best.problem.state_width**-2 + RIDGE * np.diag(compared.H)[:size]
        by_prior.append(part.B.T @ (weight[:, None] * part.B))
    return np.asarray(CAUTION * np.asarray(sum(by_noise)) + CAUTION * np.asarray(sum(by_prior)))


def _growth(best: PredictedSegments, k: int, normals: Array) -> Array:
    """Return the growth of the information of segment k by disturbances of its initial state, (draws, 4n) each."""
    x, information = best.x0[k], best.projected[k].H
    scale, (factor, lower) = best.compared[k].state_factor(0.0)
    growth = np.zeros_like(information)
    for normal in normals:
        dx = solve_triangular(factor, normal, trans=1 if lower else 0, lower=lower) / scale
        pair = [best.problem.compare(k, best.z, x + sign * dx, best.noise) for sign in (1, -1)]
        complete = [compared.projected.H for compared in pair if compared is not None]
        if len(complete) == len(pair):
            growth += (sum(complete) / 2 - information) / len(normals)
    contained, grown = np.maximum(np.diag(information), 0.0), np.diag(growth)
    limit = np.sqrt(np.where(grown > contained, contained / np.where(grown > 0, grown, 1.0), 1.0))
    return np.asarray(growth * np.outer(limit, limit))
