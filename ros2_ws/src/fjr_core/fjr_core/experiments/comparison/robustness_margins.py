# SPDX-License-Identifier: Apache-2.0
"""How far each imperfection may go: levels in steps from the nominal one, then finer about the first that fails."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...numerics.checks import Array
from .perturbations import Direction

STEPS = 16  # levels of the first look, evenly on a logarithmic scale
PARTS = 7  # levels of each finer look
ROUNDS = 2  # of finer looks
Levels = Sequence[tuple[str, float]]
Judge = Callable[[Levels], NDArray[np.bool_]]
"""(axis, level) of k runs -> whether each tracks (k,)."""


@dataclass(frozen=True)
class Edge:
    """Where tracking ends in one direction.

    level: up to which, from the nominal one, every level that was looked at tracks; None where the nominal one does
    not. beyond: the next level, which does not; None where tracking lasts to the end of the search.
    """

    level: float | None
    beyond: float | None


def search(judge: Judge, directions: Sequence[Direction]) -> dict[str, Edge]:
    """The edges in all directions, by their names; `judge` gets all levels of a look at once.

    A level that tracks beyond one that does not does not count: a robot that is 30 % off may pass through all of them.
    """
    ladders = {direction.name: direction.ladder(STEPS) for direction in directions}
    edges = _look(judge, directions, ladders)
    for _ in range(ROUNDS):
        finer = {name: _between(edge) for name, edge in edges.items() if edge.level is not None and edge.beyond}
        edges = {**edges, **_look(judge, [d for d in directions if d.name in finer], finer)}
    return edges


def _look(judge: Judge, directions: Sequence[Direction], ladders: Mapping[str, Array]) -> dict[str, Edge]:
    asked = [(d.axis.name, float(level)) for d in directions for level in ladders[d.name]]
    answers = iter([bool(tracks) for tracks in judge(asked)] if asked else ())
    return {d.name: _edge(ladders[d.name], [next(answers) for _ in ladders[d.name]]) for d in directions}


def _edge(levels: Array, tracks: Sequence[bool]) -> Edge:
    if all(tracks):
        return Edge(float(levels[-1]), None)
    first = tracks.index(False)
    return Edge(float(levels[first - 1]) if first else None, float(levels[first]))


def _between(edge: Edge) -> Array:
    """The two ends, which are judged again with the rest, and PARTS levels between them."""
    low, high = float(edge.level or 0.0), float(edge.beyond or 0.0)
    between = np.linspace if low == 0.0 else np.geomspace
    return np.asarray(between(low, high, PARTS + 2), dtype=float)
