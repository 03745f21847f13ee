# SPDX-License-Identifier: Apache-2.0
"""Covariance of the estimate from coloured residuals, with what the records alone say about each parameter.

Residuals of a wrong model are correlated over time. Segments have initial states of their own, so their scores
g_s = J_s' r_s are nearly independent, and the sandwich H^-1 (sum g_s g_s') H^-1 measures what the correlation does
(K.-Y. Liang, S. L. Zeger, Biometrika 73(1), 1986). Its standard deviations, where larger, replace those of H^-1; its
correlations do not, because it has the rank of the number of segments. The quantile is Student's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm, t

from fjr_core.numerics.checks import Array

from .variable_projection import Projected

CONFIDENCE = 0.95
LAGS = 2
"""Segments over which scores are taken to be correlated, with the weights of Bartlett (W. Newey, K. West, 1987)."""


@dataclass(frozen=True, eq=False)
class Spread:
    """Covariance (p, p) of z, and the standard deviations (p,) that the records alone give, inf: none."""

    covariance: Array
    from_records: Array


def spread(parts: Sequence[Projected], chance: Array, width: Array, fixed: Sequence[int] = ()) -> Spread:
    """Return the covariance of z from the normal equations of the segments and the prior's width (p,).

    chance (p, p): information that is due to noise and to the prior of the initial states; it does not count in
    from_records. fixed: entries of z that keep their prior; their uncertainty is that of the prior and acts on the
    others, and their own entries in from_records are inf.
    """
    H = np.asarray(sum(part.H for part in parts))
    free = [k for k in range(len(width)) if k not in fixed]
    chosen = H[np.ix_(free, free)]
    posterior = _inverse(chosen + np.diag(width[free] ** -2.0))
    factor = inflation(np.array([part.g[free] for part in parts]), posterior)
    covariance = posterior * np.outer(factor, factor)
    if len(fixed):
        by_prior = posterior @ H[np.ix_(free, list(fixed))] * width[list(fixed)]
        covariance = covariance + by_prior @ by_prior.T
    alone = np.full(len(width), np.inf)
    alone[free] = _standard_deviations(chosen - chance[np.ix_(free, free)], width[free]) * factor
    whole = np.zeros_like(H)
    whole[np.ix_(free, free)] = covariance
    return Spread(whole, alone)


def inflation(scores: Array, posterior: Array) -> Array:
    """Return by what factor (p,) standard deviations exceed those of white residuals, with Student's quantile.

    scores (segments, p). The factor is at least that of the quantile.
    """
    count = len(scores)
    scores = scores - scores.mean(axis=0)
    meat = scores.T @ scores
    for lag in range(1, min(LAGS, count - 1) + 1):
        product = scores[lag:].T @ scores[:-lag]
        meat = meat + (1 - lag / (LAGS + 1)) * (product + product.T)
    sandwich = np.diag(posterior @ meat @ posterior) * count / max(count - 1, 1)
    ratio = np.sqrt(np.maximum(sandwich / np.diag(posterior), 1.0))
    quantile = (1 + CONFIDENCE) / 2
    return np.asarray(ratio * t.ppf(quantile, max(count - 1, 1)) / norm.ppf(quantile))


def _standard_deviations(H: Array, width: Array) -> Array:
    """Return the standard deviations that the information H gives, large but finite where it is not definite."""
    scale = np.sqrt(np.maximum(np.diag(H), width**-2.0))
    w, v = np.linalg.eigh(H / np.outer(scale, scale))
    least = 1e-12 * (1 + np.max(np.abs(w), initial=0.0))
    return np.asarray(np.sqrt((v**2) @ (1 / np.maximum(w, least))) / scale)


def _inverse(H: Array) -> Array:
    scale = np.sqrt(np.diag(H))
    return np.asarray(np.linalg.inv(H / np.outer(scale, scale)) / np.outer(scale, scale))
