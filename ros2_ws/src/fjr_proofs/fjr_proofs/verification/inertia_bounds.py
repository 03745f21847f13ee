# SPDX-License-Identifier: Apache-2.0
"""Proven bounds of the link inertia of a robot, relative to a constant matrix, on a domain of joint positions.

    M_l(q_l) <= bound A    for every q_l of the domain

A domain is a box or a tube: the positions within a radius of a motion. On a box, the largest eigenvalue of the
normalised inertia is a convex function of the matrix, so that the largest one of all control matrices is a bound. The
box with the largest bound is split until the bound is close to a value that a configuration attains.
"""

from __future__ import annotations

import heapq
import pickle
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import count

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fjr_core.errors import RobotError, StateError
from fjr_core.model.robot import Robot
from fjr_core.motions.domain import GOAL, MOST_BOXES, Domain, joint_range
from fjr_core.numerics import checks
from fjr_core.numerics.checks import Array
from fjr_core.numerics.intervals import UP, Interval, U, factorisable, trace_factor

from .control_matrices import ControlMatrices, NormalisedInertia, along, control_matrices, normalised
from .inertia_polynomial import SIZES, inertia_polynomial, number_of_coefficients, pairs

MOST_COEFFICIENTS = 5**7
"""Largest number of control matrices: eight revolute joints."""
CIRCLE = 2 * np.pi + 1e-9
"""Length [rad] of a range that covers the circle in spite of rounding."""
FEW = 50_000
"""Control matrices of a quick proof; a tenth of a second."""
EXCESS = 1e-9
"""Relative distance of a bound from the largest eigenvalue that was found."""
SHORTEST = 1e-6
"""Length of a range [rad, m] that is not split."""
KEPT_NUMBERS = 2e7
"""Numbers in the control matrices that are kept for boxes not yet split; others are computed again."""
Watch = Callable[[int, float, float], bool]
"""Called with the number of boxes, the bound and the largest eigenvalue found; the search ends if it returns False."""


def unwatched(_boxes: int, _bound: float, _attained: float) -> bool:
    """Let the search go on."""
    return True


@dataclass(eq=False)
class ProofBox:
    """A box of the proof and, if it is split, the joint (an axis), the inner ends of its parts, and the parts.

    bound: t I - N(q) >= 0 on the box is proven for t = bound. direction (n,): eigenvector of the worst control matrix.
    worst: its index among the control matrices.
    """

    box: Array
    circles: tuple[bool, ...]
    bound: float = np.inf
    direction: Array = field(default_factory=lambda: np.zeros(0))
    worst: tuple[int, ...] = ()
    axis: int | None = None
    cuts: tuple[float, ...] = ()
    parts: list[ProofBox] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class RelativeInertia:
    """Bounds of M_l relative to A: M_l(q_l) <= bound A on the domain is proven; `attained` is the value at q_l = at.

    lower, upper (n,): the box that contains the domain. root: the parts of the domain.
    """

    bound: float
    attained: float
    at: Array
    lower: Array
    upper: Array
    root: ProofBox


def is_provable(robot: Robot) -> bool:
    """Return whether bounds can be proven: the bodies of the chain are known, and it has few enough joints."""
    bodies = robot.links.bodies
    return bool(bodies) and number_of_coefficients(bodies) <= MOST_COEFFICIENTS


def few_boxes(robot: Robot) -> int:
    """Return a number of boxes for a quick proof: 1 for eight revolute joints, 4 for seven, 500 at most."""
    return min(500, 1 + FEW // number_of_coefficients(robot.links.bodies))


def largest_inertia(
    robot: Robot,
    A: ArrayLike,
    domain: Domain | None = None,
    goal: float = GOAL,
    most_boxes: int = MOST_BOXES,
    samples: ArrayLike = (),
    watch: Watch = unwatched,
) -> RelativeInertia:
    """Return the least number that is proven to satisfy M_l(q_l) <= bound A on a domain.

    domain: by default the joint range. A (n, n): symmetric positive definite. samples (k, n): configurations at which
    large values are expected. The search ends if attained >= goal bound, or after most_boxes. Raises RobotError unless
    is_provable(robot), StateError for a domain without positions.
    """
    links, domain = robot.links, domain or joint_range(robot)
    if not is_provable(robot):
        known = f"{robot.n} joints" if links.bodies else "an inertia matrix whose bodies are not known"
        raise RobotError(f"the robot has {known}; expected a serial chain of at most 8 revolute joints for a proof")
    order = list(links.order)  # joint k of the robot is joint order[k] of the chain
    base, *outer = in_chain = np.argsort(order)
    A = checks.positive_definite("A", checks.matrix("A", A, robot.n, StateError), StateError)
    prismatic = tuple(body.prismatic for body in links.bodies[1:])
    M_l = _polynomial(pickle.dumps(links.bodies))
    inertia = normalised(M_l, prismatic, Interval.exact(A[np.ix_(in_chain, in_chain)]))
    lower, upper, whole = _covered(robot, domain)

    def complete(q: Array) -> Array:
        return np.concatenate([[float(lower[base])], q])[order]

    def value(q: Array) -> float:
        M_l = robot.M_l(complete(q))[np.ix_(in_chain, in_chain)]
        return float(np.linalg.eigvalsh(inertia.X @ M_l @ inertia.X.T)[-1])

    tried = np.reshape(np.asarray(samples, dtype=float), (-1, robot.n))
    if domain.near is not None:
        tried = np.vstack([tried, np.mean(domain.near, axis=1)])
    box = np.column_stack([lower, upper])[outer]
    search = _Search(inertia, value, _meets(domain, whole, outer))
    for q in (np.mean(box, axis=1), *np.clip(tried, lower, upper)[:, outer]):
        search.try_at(q)
    root = search.run(box, goal, most_boxes, watch)
    return RelativeInertia(search.bound, search.attained, complete(search.at), lower, upper, root)


def _covered(robot: Robot, domain: Domain) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return lower and upper (n,) of the domain, and which joints turn by a whole circle: their range is one turn.

    Raises StateError for boxes (k, 2, n) that are not ordered within lower, upper. A search would leave them out: its
    bound would not hold on them.
    """
    n, near = robot.n, domain.near
    ends = (domain.lower, domain.upper)
    lower, upper = (checks.vector("an end of the domain", end, n, StateError) for end in ends)
    if not np.all(lower <= upper):
        raise StateError(f"the domain is {lower.tolist()} to {upper.tolist()}; expected lower <= upper")
    if near is not None:
        if np.ndim(near) != 3 or not len(near) or near.shape[1:] != (2, n):
            raise StateError(f"near has shape {np.shape(near)}; expected (k, 2, {n}) with k > 0")
        inside = np.all((lower <= near[:, 0]) & (near[:, 0] <= near[:, 1]) & (near[:, 1] <= upper), axis=1)
        if not np.all(inside):
            worst = near[np.argmin(inside)].tolist()
            raise StateError(f"near contains {worst}; expected lower <= upper, within the domain")
    turns = ~np.array([robot.links.bodies[joint].prismatic for joint in robot.links.order])
    whole = turns & (upper - lower >= 2 * np.pi - 1e-9)
    return lower, np.where(whole, lower + CIRCLE, upper), whole


@lru_cache(maxsize=2)
def _polynomial(bodies: bytes) -> Interval:
    return inertia_polynomial(pickle.loads(bodies))


def _meets(domain: Domain, whole: NDArray[np.bool_], joints: list[int]) -> Callable[[Array], bool]:
    """Return whether a box (n - 1, 2) of the outer joints of the chain meets the domain.

    A joint that turns by a whole circle meets it at every angle, as its angles in the domain may be a turn away.
    """
    if domain.near is None:
        return lambda box: True
    lower, upper = (np.where(whole, end, domain.near[:, k])[:, joints] for k, end in enumerate((-np.inf, np.inf)))
    return lambda box: bool(np.any(np.all((lower <= box[:, 1]) & (upper >= box[:, 0]), axis=1)))


class _Search:
    """Branch and bound of the largest eigenvalue of N(q): the boxes that are not split, the worst one first.

    value: q (n - 1,) of the outer joints -> largest eigenvalue, in floating point. meets: whether a part (n - 1, 2)
    meets the domain; others are left out.
    """

    def __init__(
        self, inertia: NormalisedInertia, value: Callable[[Array], float], meets: Callable[[Array], bool]
    ) -> None:
        self.inertia, self.value, self.meets = inertia, value, meets
        self.open: list[tuple[float, int, ProofBox]] = []
        self.kept: OrderedDict[int, ControlMatrices] = OrderedDict()
        self.numbers, self.boxes = count(), 0
        self.attained = -np.inf
        self.at: Array = np.zeros(inertia.n - 1)

    def run(self, box: Array, goal: float, most_boxes: int, watch: Watch) -> ProofBox:
        """Split the worst box until attained >= goal bound; return the parts."""
        matrices = control_matrices(self.inertia, box)
        root = ProofBox(box, matrices.circles)
        self.add(root, matrices, np.eye(self.inertia.n)[0])
        while self.boxes < most_boxes and not self.attained >= goal * self.bound and self.split_worst():
            if not watch(self.boxes, self.bound, self.attained):
                break
        return root

    @property
    def bound(self) -> float:
        """Proven bound of the largest eigenvalue."""
        return -self.open[0][0]

    def try_at(self, q: Array) -> None:
        """Evaluate the largest eigenvalue at a configuration of the domain."""
        value = self.value(q) if self.meets(np.column_stack([q, q])) else -np.inf
        if value > self.attained:
            self.attained, self.at = value, q

    def add(self, part: ProofBox, matrices: ControlMatrices, direction: Array) -> None:
        """Bound a part and put it into the queue."""
        part.bound, part.direction, part.worst = eigenvalue_bound(matrices, direction)
        number = next(self.numbers)
        heapq.heappush(self.open, (-part.bound, number, part))
        self.kept[number] = matrices
        if len(self.kept) * matrices.values.size > KEPT_NUMBERS and len(self.kept) > 1:
            self.kept.popitem(last=False)
        self.boxes += 1

    def split_worst(self) -> bool:
        """Split the box with the largest bound, and return whether it is long enough for that.

        Parts outside the domain are left out.
        """
        _, number, worst = self.open[0]
        matrices = self.kept.pop(number, None) or control_matrices(self.inertia, worst.box, worst.circles)
        self.try_at(self._control_point(worst))
        worst.axis = best_split(matrices, worst.direction, self.attained)
        if worst.axis is None:
            return False
        heapq.heappop(self.open)
        worst.cuts = tuple(float(cut) for cut in matrices.cuts(worst.axis)[1:-1])
        for inner in matrices.parts(worst.axis):
            part = ProofBox(inner.box, inner.circles)
            worst.parts.append(part)
            if self.meets(inner.box):
                self.add(part, inner, worst.direction)
        return True

    def _control_point(self, part: ProofBox) -> Array:
        """Return the configuration (n - 1,) that belongs to the worst control matrix of a box."""
        q = []
        for (a, b), circle, i, slides in zip(part.box, part.circles, part.worst, self.inertia.prismatic, strict=True):
            turned = np.clip((2 * np.pi * i / 5 - a) % (2 * np.pi) + a, a, b)
            q.append(turned if circle else a + (b - a) * i / (SIZES[slides] - 1))
        return np.array(q)


def eigenvalue_bound(matrices: ControlMatrices, direction: Array) -> tuple[float, Array, tuple[int, ...]]:
    """Return bound, direction and worst of a ProofBox; direction (n,): a guess of the worst eigenvector.

    One Cholesky factorisation of t I - C decides each control matrix C; t grows until all have one. The bound exceeds t
    by all errors: of the factorisation (the trace of a factorised matrix is at most 2 n times the largest size of an
    eigenvalue), of X A X' and of the control matrices.
    """
    entries, inertia = matrices.matrices, matrices.inertia
    for _ in range(2):
        worst = int(np.argmax(_quadratic_form(matrices, direction)))
        largest, direction = _leading(entries[..., worst])
    size = inertia.n * float(np.max(np.abs(matrices.values)))  # no eigenvalue is larger
    left: NDArray[np.intp] = np.arange(entries.shape[-1])
    while True:
        t = largest + EXCESS * max(abs(largest), 1e-3 * size)
        left = left[~factorisable(entries[..., left], t)]
        if not len(left):
            break
        eigenvalues = np.linalg.eigvalsh(np.moveaxis(entries[..., left], -1, 0))[:, -1]
        worst = int(left[np.argmax(eigenvalues)])
        largest, direction = _leading(entries[..., worst])
    index = np.unravel_index(worst, matrices.values.shape[1:])
    rounding = 2 * inertia.n * trace_factor(inertia.n) + 4 * U + 2 * inertia.identity_error
    bound = t + float(1.01 * UP * (rounding * size + matrices.error))
    return bound, direction, tuple(int(i) for i in index)


def best_split(matrices: ControlMatrices, direction: Array, target: float) -> int | None:
    """Return the joint whose split reduces v' N v of the worst direction v most, as a mean over its parts.

    Values below the target count as the target. None: all ranges are too short to be split.
    """
    form = _quadratic_form(matrices, direction)
    excess = np.full(matrices.inertia.n - 1, np.inf)
    for axis in np.flatnonzero(np.ptp(matrices.box, axis=1) > SHORTEST):
        largest = [np.max(along(part.mid, form, axis)) for part in matrices.maps(axis)]
        excess[axis] = np.mean(np.maximum(largest, target))
    return int(np.argmin(excess)) if np.isfinite(excess).any() else None


def _leading(matrix: Array) -> tuple[float, Array]:
    """Return the largest eigenvalue and its eigenvector."""
    eigenvalues, vectors = np.linalg.eigh(matrix)
    return float(eigenvalues[-1]), vectors[:, -1]


def _quadratic_form(matrices: ControlMatrices, direction: Array) -> Array:
    """Return v' N v (d_2, .., d_n) of all control matrices N for v = direction (n,)."""
    weights = [direction[i] * direction[j] * (1 if i == j else 2) for i, j in pairs(len(direction))]
    return np.asarray(np.tensordot(weights, matrices.values, axes=(0, 0)))
