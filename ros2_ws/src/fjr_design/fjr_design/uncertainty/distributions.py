# SPDX-License-Identifier: Apache-2.0
"""Distributions of the varied parameters: read, checked, and drawn by the number of the run."""

from __future__ import annotations

import sys
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from fjr_core.errors import ParameterError
from fjr_core.numerics.checks import Array
from fjr_design.batch import draws

UNIFORM, NORMAL, LOG_UNIFORM, FIXED = "uniform", "normal", "log_uniform", "fixed"
LOG_NORMAL = "log_normal"
WIDEST = 4.0
"""Standard deviations at which a normal distribution is truncated."""
EACH_JOINT = "each_joint"
COUNTED_AS = {"link_torque": "external"}
"""Names that determine the random numbers of a deviation, where they differ from its own: its former ones."""
FORM = (
    "{uniform: [low, high]}, {log_uniform: [low, high]}, {normal: [mean, deviation]}, "
    "{log_normal: [median, deviation of the logarithm]}, or a number"
)


@dataclass(frozen=True)
class Distribution:
    """Distribution of a kind with its numbers: low and high, mean and standard deviation, or fixed values.

    Those of a log-normal distribution are the median and the standard deviation of the natural logarithm. each_joint:
    drawn separately for every joint, else once for all. Normal distributions are truncated at WIDEST standard
    deviations.
    """

    kind: str
    numbers: tuple[float, ...]
    each_joint: bool = False

    @property
    def range(self) -> tuple[float, float]:
        """Return the smallest and the largest value that can be drawn."""
        if self.kind == NORMAL:
            mean, deviation = self.numbers
            return mean - WIDEST * deviation, mean + WIDEST * deviation
        if self.kind == LOG_NORMAL:
            median, deviation = self.numbers
            return median * float(np.exp(-WIDEST * deviation)), median * float(np.exp(WIDEST * deviation))
        return min(self.numbers), max(self.numbers)

    def at(self, share: Array) -> Array:
        """Return the quantile of a share in [0, 1), elementwise."""
        low, high = self.numbers[0], self.numbers[-1]
        if self.kind == UNIFORM:
            return np.asarray(low + (high - low) * share)
        if self.kind == LOG_UNIFORM:
            return np.asarray(low * (high / low) ** share)
        normal = standard_normal(share)
        return np.asarray(low * np.exp(high * normal) if self.kind == LOG_NORMAL else low + high * normal)

    def share(self, value: Array) -> Array:
        """Return the cumulative probability of a value, the inverse of `at`."""
        low, high = self.numbers[0], self.numbers[-1]
        if self.kind == UNIFORM:
            return np.asarray((value - low) / (high - low))
        if self.kind == LOG_UNIFORM:
            return np.asarray(np.log(value / low) / np.log(high / low))
        from scipy.special import ndtr  # loaded on use: see law/gains.py

        outside = ndtr(-WIDEST)
        normal = np.log(value / low) / high if self.kind == LOG_NORMAL else (value - low) / high
        return np.asarray((ndtr(normal) - outside) / (1 - 2 * outside))

    def drawn(self, name: str, seed: int, first: int, count: int, n: int) -> Array:
        """Return the values of the runs from `first` on: (count, n) with each_joint, else (count, 1); or fixed ones."""
        if self.kind == FIXED:
            return np.tile(self.numbers, (count, 1))
        words = draws.rows((seed, stream(name)), first, count, n if self.each_joint else 1)
        return self.at(draws.unit(words))

    @property
    def as_yaml(self) -> Any:
        """Return the plain value from which `read` makes this distribution."""
        if self.kind == FIXED:
            return list(self.numbers) if len(self.numbers) > 1 else self.numbers[0]
        return {self.kind: list(self.numbers)} | ({EACH_JOINT: True} if self.each_joint else {})


class DrawnColumn(NamedTuple):
    """A drawn number of each run: its column in the table, the field of Draws and entry in it, its distribution."""

    column: str
    name: str
    entry: int
    distribution: Distribution


def standard_normal(share: Array, widest: float = WIDEST) -> Array:
    """Return standard normal numbers at a share in [0, 1), truncated at +-widest."""
    from scipy.special import ndtr, ndtri  # loaded on use: see law/gains.py

    outside = ndtr(-widest)
    return np.asarray(ndtri(outside + (1 - 2 * outside) * share))


def stream(name: str) -> int:
    """Return the second word of the random key of a parameter name; it is never 0, which the noise uses."""
    return zlib.crc32(COUNTED_AS.get(name, name).encode()) | 1 << 32


def varied(given: Mapping[str, object]) -> dict[str, Distribution]:
    """Return the distributions under `vary` by deviation; raises ParameterError. A former name is reported."""
    former = {old: name for name, old in COUNTED_AS.items()}
    for old in given.keys() & former:
        if former[old] in given:
            raise ParameterError(f"'vary' has '{old}' beside its new name '{former[old]}'; expected the latter alone")
        print(f"fjr: '{old}' under 'vary' is deprecated; use '{former[old]}'", file=sys.stderr)
    return {former.get(str(name), str(name)): read(str(name), one) for name, one in given.items()}


def read(name: str, given: object) -> Distribution:
    """Return the distribution given in a sweep file; raises ParameterError."""
    if isinstance(given, (int, float)) and not isinstance(given, bool):
        return Distribution(FIXED, _numbers(name, [given]))
    if isinstance(given, Sequence) and not isinstance(given, str):
        return Distribution(FIXED, _numbers(name, given))
    if not isinstance(given, Mapping):
        raise ParameterError(f"'{name}' is {given!r}; expected {FORM}")
    kinds = [key for key in given if key in (UNIFORM, NORMAL, LOG_UNIFORM, LOG_NORMAL)]
    unknown = [key for key in given if key not in (*kinds, EACH_JOINT)]
    if len(kinds) != 1 or unknown or not isinstance(given.get(EACH_JOINT, False), bool):
        raise ParameterError(f"'{name}' is {dict(given)}; expected {FORM}, optionally with each_joint: true")
    return _checked(name, Distribution(kinds[0], _numbers(name, given[kinds[0]]), given.get(EACH_JOINT, False)))


def _checked(name: str, one: Distribution) -> Distribution:
    """Return a distribution of two numbers; raises ParameterError unless they fit its kind."""
    if len(one.numbers) != 2:
        raise ParameterError(f"'{name}' has {len(one.numbers)} numbers; expected two for {one.kind}")
    low, high = one.numbers
    if one.kind in (NORMAL, LOG_NORMAL) and not high > 0:
        raise ParameterError(f"'{name}' has the standard deviation {high:g}; expected more than 0")
    if one.kind in (UNIFORM, LOG_UNIFORM) and not low < high:
        raise ParameterError(f"'{name}' goes from {low:g} to {high:g}; expected the smaller number first")
    if one.kind in (LOG_UNIFORM, LOG_NORMAL) and not low > 0:
        raise ParameterError(f"'{name}' starts at {low:g}; expected more than 0 for {one.kind}")
    return one


def _numbers(name: str, given: object) -> tuple[float, ...]:
    try:
        numbers = np.array(given, dtype=float)
    except (TypeError, ValueError, OverflowError):
        numbers = np.array(np.nan)
    if numbers.ndim != 1 or not len(numbers) or not np.all(np.isfinite(numbers)):
        raise ParameterError(f"'{name}' has {given!r}; expected a list of finite numbers")
    return tuple(numbers.tolist())
