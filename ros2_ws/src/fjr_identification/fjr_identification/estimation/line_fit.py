# SPDX-License-Identifier: Apache-2.0
"""Slopes of one filtered signal over another, with the deviation that their few independent samples leave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fjr_core.numerics.checks import Array

LEAST_SHARE = 1e-6  # of a regressor's variance that the others do not explain


@dataclass(frozen=True)
class Line:
    """Slope of y over x, its standard deviation, and the share of the variance of y that the fit leaves."""

    slope: float
    deviation: float
    unexplained: float


def line(x: Array, y: Array, others: Sequence[Array], independent: float) -> Line:
    """Fit y = slope x + others + constant by least squares; all are (k,), `independent` of the k samples are.

    A regressor that the others explain has the slope 0 with an infinite deviation.
    """
    rest = np.column_stack([*others, np.ones_like(x)])
    x, y = _without(rest, x), _without(rest, y)
    power, total = float(x @ x), float(y @ y)
    if not power > LEAST_SHARE * len(x) * np.finfo(float).tiny or total == 0:
        return Line(0.0, np.inf, 1.0)
    slope = float(x @ y) / power
    residual = y - slope * x
    freedom = max(1.0, independent - rest.shape[1] - 1)
    deviation = np.sqrt(float(residual @ residual) / power / freedom)
    return Line(slope, float(deviation), float(residual @ residual) / total)


def bounded_slope(
    x: Array, y: Array, load: Array, others: Sequence[Array], compliance: tuple[float, float], independent: float
) -> tuple[float, float] | None:
    """Return the range of slopes r of y = r x + c load + others + constant, for c within its bounds, +- 5 deviations.

    None if x does not move enough.
    """
    one = np.ones((len(x), 1))
    free = line(load, y, (x, *others), independent)
    low, high = np.clip([free.slope - 5 * free.deviation, free.slope + 5 * free.deviation], *compliance)
    fits = [line(x, y - c * load, others, independent) for c in (low, high)]
    if any(not max(1.0, abs(each.slope)) > 20 * each.deviation for each in fits) or not np.any(_without(one, x)):
        return None
    return min(each.slope - 5 * each.deviation for each in fits), max(each.slope + 5 * each.deviation for each in fits)


def _without(rest: Array, values: Array) -> Array:
    """Return the values (k,) without their projection on the columns of `rest` (k, m)."""
    return np.asarray(values - rest @ np.linalg.lstsq(rest, values, rcond=None)[0])
