# SPDX-License-Identifier: Apache-2.0
"""The likelihood of z over all segments, each simulated from its own initial state (H. G. Bock, multiple shooting).

-log L = sum_i (N_i log s_i^2 + sum r_i^2 / s_i^2) / 2 + ((z - z_prior) / width)^2 / 2
         + sum_k ((x_k - filtered_k) / state_width)^2 / 2

s_i: root mean square of the residuals r_i of signal i, but at least the noise of its steps. x_k: initial state of
segment k.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from fjr_core.numerics.checks import Array

from .coordinates import Coordinates
from .segments import Comparison, Segment, compare
from .shooting import Shooting
from .variable_projection import state_step

FEWEST = 25  # samples that are compared of a segment
SOFT = 1e-6  # damping of the first step
SETTLED = 0.02  # decrease of the sum of squares, in units of the noise, that a step of an initial state is worth
SHARE = 1e-4  # of the sum of squares: a smaller decrease is left to the next step of z
MOST_SETTLING = 8
ROUGH = 1e-4  # rad, N m; noise that is assumed before residuals are known

Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class Problem:
    """Segments and signals with the model that predicts them. floor (signals,): least noise, of the encoder's steps.

    filtered (segments, 4n), state_width (4n,): weak normal prior of the initial states, which keeps states that are not
    measured within reach where the model is wrong.
    """

    segments: Sequence[Segment]
    shooting: Shooting
    coordinates: Coordinates
    signals: tuple[tuple[str, int], ...]
    floor: Array
    filtered: Array
    state_width: Array
    threads: int = 2

    def part(self, stride: int, share: int) -> Problem:
        """Return the problem of the first 1 / share, at least FEWEST samples, of every `stride`-th segment."""
        counts = [max(each.count // share, min(each.count, FEWEST)) for each in self.segments[::stride]]
        segments = [each.shortened(count) for each, count in zip(self.segments[::stride], counts, strict=True)]
        return replace(self, segments=segments, filtered=self.filtered[::stride])

    def of_each(self, work: Callable[[int], Result]) -> list[Result]:
        """Return the results of work(k) for each segment k, some of which are computed at the same time."""
        _ = self.shooting.library, self.shooting.function  # compiled in this thread
        with ThreadPoolExecutor(self.threads) as pool:
            return list(pool.map(work, range(len(self.segments))))

    def evaluate(self, z: Array, x0: Array, noise: Array) -> tuple[Array, list[Comparison]] | None:
        """Return settled initial states and the comparison of each segment, None if one does not stay finite."""
        found = self.of_each(lambda k: self._settle(k, z, x0[k], noise))
        complete = [each for each in found if each is not None]
        if len(complete) < len(found):
            return None
        return np.array([x for x, _ in complete]), [compared for _, compared in complete]

    def _settle(self, k: int, z: Array, x: Array, noise: Array) -> tuple[Array, Comparison] | None:
        """Return the most likely initial state of a segment at z, by Levenberg-Marquardt, and the comparison there."""
        compared, damping, size = self.compare(k, z, x, noise), SOFT, len(x)
        for _ in range(MOST_SETTLING):
            if compared is None:
                return None
            dx, decrease = state_step(compared, size, damping)
            if decrease < max(SETTLED, SHARE * _weighted(compared, noise)):
                return x, replace(compared, unsettled=decrease)
            trial, before = self.compare(k, z, x + dx, noise), _weighted(compared, noise)
            gain = before - _weighted(trial, noise) if trial is not None else -1.0
            if trial is not None and gain >= 0:
                x, compared = x + dx, trial
            damping *= 0.1 if gain > decrease / 2 else 1.0 if gain >= 0 else 100.0
        return None if compared is None else (x, compared)

    def compare(self, k: int, z: Array, x: Array, noise: Array) -> Comparison | None:
        """Return the comparison of segment k at z and the initial state x (4n,)."""
        found = compare(self.segments[k], self.shooting, self.coordinates, z, x, self.signals, noise)
        if found is None or not np.isfinite(found.H).all():
            return None
        size, away = len(x), (x - self.filtered[k]) / self.state_width
        found.H[range(size), range(size)] += self.state_width**-2
        found.g[:size] -= away / self.state_width
        return replace(found, penalty=float(away @ away))

    def noise(self, compared: Sequence[Comparison]) -> Array:
        """Return the root mean square residual of each signal (signals,)."""
        squares, counts = (sum(getattr(each, name) for each in compared) for name in ("squares", "counts"))
        return np.asarray(np.maximum(np.sqrt(squares / np.maximum(counts, 1)), self.floor))

    def cost(self, compared: Sequence[Comparison], z: Array) -> float:
        """Return -log L at the most likely initial states: less what those of the comparisons are short of."""
        counts, squares = (sum(getattr(each, name) for each in compared) for name in ("counts", "squares"))
        noise = self.noise(compared)
        prior = (z - self.coordinates.mean) / self.coordinates.width
        states = sum(each.penalty - each.unsettled for each in compared)
        return float(counts @ np.log(noise) + (np.sum(squares / noise**2) + prior @ prior + states) / 2)


def _weighted(compared: Comparison, noise: Array) -> float:
    return float(np.sum(compared.squares / noise**2)) + compared.penalty
