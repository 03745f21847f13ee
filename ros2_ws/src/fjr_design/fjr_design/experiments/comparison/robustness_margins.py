# SPDX-License-Identifier: Apache-2.0
"""Search robustness margins: increase a perturbation until tracking fails, then refine around that level."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fjr_core.numerics.checks import Array

from .perturbations import Direction

STEPS = 16  # levels of the first scan, evenly spaced on a logarithmic scale
PARTS = 7  # levels of each refinement
ROUNDS = 2  # of refinement
Levels = Sequence[tuple[str, float]]
Evaluation = Callable[[Levels], NDArray[np.bool_]]
"""(perturbation, level) of k runs -> whether each run tracks (k,)."""


@dataclass(frozen=True)
class RobustnessMargin:
    """Margin in one direction.

    level: largest level such that it and all tested levels below track; None if the nominal one does not. beyond: the
    next tested level, which does not track; None if all levels track.
    """

    level: float | None
    beyond: float | None


def search(tracks: Evaluation, directions: Sequence[Direction]) -> dict[str, RobustnessMargin]:
    """Return the margins in all directions by name.

    tracks: evaluates all levels of a scan at once. The search stops at the first level that fails; larger levels that
    track again are ignored, because a robot may have any level in between.
    """
    ladders = {direction.name: direction.ladder(STEPS) for direction in directions}
    margins = _scan(tracks, directions, ladders)
    for _ in range(ROUNDS):
        finer = {name: _between(found) for name, found in margins.items() if found.level is not None and found.beyond}
        margins = {**margins, **_scan(tracks, [d for d in directions if d.name in finer], finer)}
    return margins


def _scan(
    tracks: Evaluation, directions: Sequence[Direction], ladders: Mapping[str, Array]
) -> dict[str, RobustnessMargin]:
    levels = [(d.perturbation.name, float(level)) for d in directions for level in ladders[d.name]]
    results = iter([bool(each) for each in tracks(levels)] if levels else ())
    return {d.name: _margin(ladders[d.name], [next(results) for _ in ladders[d.name]]) for d in directions}


def _margin(levels: Array, tracks: Sequence[bool]) -> RobustnessMargin:
    if all(tracks):
        return RobustnessMargin(float(levels[-1]), None)
    first = tracks.index(False)
    return RobustnessMargin(float(levels[first - 1]) if first else None, float(levels[first]))


def _between(margin: RobustnessMargin) -> Array:
    """Return the two ends of a margin and PARTS levels between them."""
    low, high = float(margin.level or 0.0), float(margin.beyond or 0.0)
    between = np.linspace if low == 0.0 else np.geomspace
    return np.asarray(between(low, high, PARTS + 2), dtype=float)
