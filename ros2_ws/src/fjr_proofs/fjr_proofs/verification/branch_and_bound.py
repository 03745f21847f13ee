# SPDX-License-Identifier: Apache-2.0
"""Bound the largest eigenvalue of the normalised inertia on a box, or near a motion, by splitting the worst part."""

from __future__ import annotations

import heapq
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import count

import numpy as np

from fjr_core.numerics.checks import Array

from .control_matrices import ControlMatrices, NormalisedInertia, control_matrices, whole_circles
from .inertia_polynomial import SIZES
from .largest_eigenvalue import BoxBound, best_split, box_bound

KEPT_NUMBERS = 2e7
"""Numbers in the control matrices that are kept for boxes not yet split; others are computed again."""
Watch = Callable[[int, float, float], bool]
"""Called with the number of boxes, the bound and the largest eigenvalue found; the search ends if it returns False."""


def unwatched(_boxes: int, _bound: float, _attained: float) -> bool:
    """Let the search go on."""
    return True


@dataclass(eq=False)
class Part:
    """A box and, if it is split, the joint (an axis), the inner ends of its parts, and the parts."""

    box: Array
    circles: tuple[bool, ...]
    axis: int | None = None
    cuts: tuple[float, ...] = ()
    parts: list[Part] = field(default_factory=list)
    found: BoxBound | None = None


@dataclass(frozen=True, eq=False)
class Supremum:
    """The largest eigenvalue of N(q) over a domain: at most bound (proven), at least attained (evaluated at `at`).

    boxes: number of boxes in the proof. root: the parts of the domain.
    """

    bound: float
    attained: float
    at: Array
    boxes: int
    root: Part


def supremum(
    inertia: NormalisedInertia,
    box: Array,
    value: Callable[[Array], float],
    samples: Array,
    goal: float,
    most_boxes: int,
    relevant: Callable[[Array], bool] = lambda box: True,
    watch: Watch = unwatched,
) -> Supremum:
    """Return bounds of the largest eigenvalue of N on a box (n - 1, 2) of the joints 2 .. n.

    value: q (n - 1,) -> largest eigenvalue, in floating point. samples (k, n - 1): first configurations.
    The worst box is split until attained >= goal bound (bound >= goal attained if negative) or there are most_boxes.
    relevant: whether a part (n - 1, 2) meets the domain; others are left out.
    """
    search = _Search(inertia, value, relevant)
    for q in (np.mean(box, axis=1), *samples):
        search.try_at(q)
    root = Part(box, whole_circles(inertia, box))
    search.add(root, control_matrices(inertia, box, root.circles), np.eye(inertia.n)[0])
    while search.boxes < most_boxes and search.gap(goal) and search.split_worst():
        if not watch(search.boxes, search.bound, search.attained):
            break
    return Supremum(search.bound, search.attained, search.at, search.boxes, root)


class _Search:
    """The boxes that are not split, the worst one first."""

    def __init__(
        self, inertia: NormalisedInertia, value: Callable[[Array], float], relevant: Callable[[Array], bool]
    ) -> None:
        self.inertia, self.value, self.relevant = inertia, value, relevant
        self.open: list[tuple[float, int, Part]] = []
        self.kept: OrderedDict[int, ControlMatrices] = OrderedDict()
        self.numbers, self.boxes = count(), 0
        self.attained = -np.inf
        self.at: Array = np.zeros(inertia.n - 1)

    @property
    def bound(self) -> float:
        """Proven bound of the largest eigenvalue."""
        return -self.open[0][0]

    def gap(self, goal: float) -> bool:
        """Return whether the bound is further from the attained value than the goal."""
        larger = max(abs(self.bound), abs(self.attained))
        return not np.isfinite(self.attained) or self.bound - self.attained > (1 - goal) * larger

    def try_at(self, q: Array) -> None:
        """Evaluate the largest eigenvalue at a configuration of the domain."""
        value = self.value(q) if self.relevant(np.column_stack([q, q])) else -np.inf
        if value > self.attained:
            self.attained, self.at = value, q

    def add(self, part: Part, matrices: ControlMatrices, direction: Array) -> None:
        """Bound a part and put it into the queue."""
        part.found = box_bound(matrices, self.inertia, direction)
        number = next(self.numbers)
        heapq.heappush(self.open, (-part.found.bound, number, part))
        self.kept[number] = matrices
        if len(self.kept) * matrices.values.size > KEPT_NUMBERS and len(self.kept) > 1:
            self.kept.popitem(last=False)
        self.boxes += 1

    def split_worst(self) -> bool:
        """Split the box with the largest bound, and return whether it is long enough for that.

        Parts outside the domain are left out.
        """
        _, number, part = self.open[0]
        assert part.found is not None
        matrices = self.kept.pop(number, None) or control_matrices(self.inertia, part.box, part.circles)
        self.try_at(_control_point(part, part.found.worst, self.inertia.prismatic))
        part.axis = best_split(matrices, self.inertia, part.found, self.attained)
        if part.axis is None:
            return False
        heapq.heappop(self.open)
        part.cuts = tuple(float(cut) for cut in matrices.cuts(part.axis)[1:-1])
        for inner in matrices.parts(part.axis, self.inertia):
            child = Part(inner.box, inner.circles)
            part.parts.append(child)
            if self.relevant(inner.box):
                self.add(child, inner, part.found.direction)
        return True


def _control_point(part: Part, index: tuple[int, ...], prismatic: tuple[bool, ...]) -> Array:
    """Return the configuration (n - 1,) that belongs to a control matrix."""
    found = []
    for (a, b), circle, i, slides in zip(part.box, part.circles, index, prismatic, strict=True):
        turned = np.clip((2 * np.pi * i / 5 - a) % (2 * np.pi) + a, a, b)
        found.append(turned if circle else a + (b - a) * i / (SIZES[slides] - 1))
    return np.array(found)
