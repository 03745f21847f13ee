# SPDX-License-Identifier: Apache-2.0
"""Summarise a sweep: success rate, outcomes and first-order sensitivity of each parameter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fjr_core.numerics.checks import Array
from fjr_design.batch.closed_loop import PER_JOINT
from fjr_msgs_py.console.output import number

from ..batch.draws import Distribution
from .sweep import OUTCOMES, Sweep

BINS, FULL_BIN = 20, 25  # largest number of bins, and smallest mean number of runs per bin
Z = 1.959964  # of a 95 % interval
QUANTILES = (0.5, 0.95, 0.99, 1.0)
ReadColumn = Callable[[str], NDArray[Any]]


@dataclass(frozen=True, eq=False)
class Effect:
    """Effect of one drawn parameter, in bins of equal probability.

    edges (bins + 1,): of the bins. share, low, high (bins,): success rate with its 95 % interval. success, error:
    first-order sensitivity index, the share of the variance of success and of log rms of the stable runs that this
    parameter explains alone (A. Saltelli et al., Global Sensitivity Analysis, Wiley 2008, sec. 1.2.6).
    """

    name: str
    edges: Array
    share: Array
    low: Array
    high: Array
    success: float
    error: float


@dataclass(frozen=True, eq=False)
class Summary:
    """Summary of a sweep.

    runs, succeeded, stable: numbers of runs; stopped: of those that a limit stopped. low, high: 95 % interval of the
    success rate. quantiles: of each outcome, of the largest joint, at QUANTILES over the stable runs (NaN if there are
    none). effects: drawn parameters, the most important first. worst: number of the successful run with the largest
    rms; failed: of the first failed run; -1: none.
    """

    runs: int
    succeeded: int
    stable: int
    stopped: int
    low: float
    high: float
    quantiles: dict[str, list[float]]
    effects: tuple[Effect, ...]
    worst: int
    failed: int


def summarised(sweep: Sweep, column: ReadColumn) -> Summary:
    """Summarise a table; `column` reads one column, of which one at a time is in memory."""
    success, stable = column("success"), column("stable")
    rms = _largest(sweep, column, "rms")
    log_rms = np.log10(np.maximum(rms, 1e-300), where=stable, out=np.zeros(len(rms)))
    effects = [
        _effect(each.column, each.distribution, column(each.column), success, log_rms, stable) for each in sweep.drawn
    ]
    low, high = interval(int(success.sum()), len(success))
    good = np.where(success, rms, -1.0)
    return Summary(
        runs=len(success),
        succeeded=int(success.sum()),
        stable=int(stable.sum()),
        stopped=int(np.isfinite(column("stopped")).sum()),
        low=float(low),
        high=float(high),
        quantiles={name: _quantiles(_largest(sweep, column, name)[stable]) for name in OUTCOMES},
        effects=tuple(sorted(effects, key=lambda effect: -max(effect.success, effect.error))),
        worst=int(good.argmax()) if success.any() else -1,
        failed=int(np.argmin(success)) if not success.all() else -1,
    )


def shown(value: float, unit: str, sweep: Sweep) -> str:
    """Return an outcome with its unit, an error in mrad or mm."""
    return number(1e3 * value, sweep.units("mrad")) if unit == "rad" else number(value, sweep.units(unit))


def interval(count: ArrayLike, of: ArrayLike) -> tuple[Array, Array]:
    """Return Wilson's 95 % interval of a share (E. B. Wilson, JASA 22(158), 1927)."""
    k = np.maximum(np.asarray(of, dtype=float), 1e-9)
    share = np.asarray(count, dtype=float) / k
    middle, half = share + Z**2 / (2 * k), Z * np.sqrt(share * (1 - share) / k + Z**2 / (4 * k**2))
    scale = 1 + Z**2 / k
    return np.clip((middle - half) / scale, 0, 1), np.clip((middle + half) / scale, 0, 1)


def _largest(sweep: Sweep, column: ReadColumn, name: str) -> Array:
    """Return an outcome (runs,), the largest over the joints."""
    if name not in PER_JOINT:
        return column(name)
    return np.asarray(reduce(np.maximum, (column(f"{name}.{joint}") for joint in sweep.scenario.joints)))


def _effect(
    name: str, drawn: Distribution, values: Array, success: NDArray[np.bool_], log_rms: Array, stable: NDArray[np.bool_]
) -> Effect:
    bins = min(BINS, max(2, len(values) // FULL_BIN))
    place = np.clip((bins * drawn.share(values)).astype(int), 0, bins - 1)
    count, good = np.bincount(place, minlength=bins), np.bincount(place, success, minlength=bins)
    low, high = interval(good, count)
    share = np.divide(good, count, out=np.full(bins, np.nan), where=count > 0)
    edges = drawn.at(np.arange(bins + 1) / bins)
    return Effect(name, edges, share, low, high, index(place, success), index(place[stable], log_rms[stable]))


def index(place: NDArray[np.int_], values: ArrayLike) -> float:
    """Return the share of the variance of `values` (k,) that the bins `place` (k,) explain, 0 to 1.

    Correlation ratio, corrected for the number of bins (T. L. Kelley, PNAS 21(9), 1935).
    """
    values = np.asarray(values, dtype=float)
    count = np.bincount(place)
    used = np.count_nonzero(count)
    if len(values) <= used or not np.var(values) > 0:
        return 0.0
    means = np.bincount(place, values) / np.maximum(count, 1)
    within = float(np.mean((values - means[place]) ** 2)) * len(values) / (len(values) - used)
    return max(0.0, 1 - within / float(np.var(values, ddof=1)))


def _quantiles(values: Array) -> list[float]:
    if not len(values):
        return [float("nan")] * len(QUANTILES)
    return [float(value) for value in np.quantile(values, QUANTILES, method="higher")]
