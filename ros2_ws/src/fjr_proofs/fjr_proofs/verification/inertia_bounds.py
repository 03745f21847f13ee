# SPDX-License-Identifier: Apache-2.0
"""Proven bounds of the link inertia of a robot, relative to a constant matrix, on a domain of joint positions.

    least A <= M_l(q_l) <= largest A    for every q_l of the domain

A domain is a box or a tube: the positions within a radius of a motion.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fjr_core.errors import RobotError, StateError
from fjr_core.model.robot import Robot
from fjr_core.motions.domain import GOAL, MOST_BOXES, Domain, joint_range
from fjr_core.numerics import checks
from fjr_core.numerics.checks import Array
from fjr_core.numerics.intervals import Interval

from .branch_and_bound import Supremum, Watch, supremum, unwatched
from .control_matrices import normalised
from .inertia_polynomial import InertiaPolynomial, inertia_polynomial, number_of_coefficients

MOST_COEFFICIENTS = 5**7
"""Largest number of control matrices: eight revolute joints."""
CIRCLE = 2 * np.pi + 1e-9
"""Length [rad] of a range that covers the circle in spite of rounding."""
FEW = 50_000
"""Control matrices of a quick proof; a tenth of a second."""


@dataclass(frozen=True, eq=False)
class RelativeInertia:
    """Bounds of M_l relative to A: M_l(q_l) <= bound A on the domain is proven; `attained` is the value at q_l = at.

    For a lower bound, M_l(q_l) >= bound A. lower, upper (n,): the box that contains the domain. boxes: number of boxes
    of the proof.
    """

    bound: float
    attained: float
    at: Array
    lower: Array
    upper: Array
    boxes: int
    proof: Supremum


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
    sign: float = 1.0,
) -> RelativeInertia:
    """Return the least number that is proven to satisfy M_l(q_l) <= bound A on a domain, the joint range by default.

    A (n, n): symmetric positive definite. samples (k, n): configurations at which large values are expected.
    sign: -1 for -M_l(q_l) <= bound A. The search ends if attained >= goal bound (bound >= goal attained if negative),
    or after most_boxes. Raises RobotError unless is_provable(robot), StateError for a domain without positions.
    """
    polynomial, order = _polynomial(robot), list(robot.links.order)
    domain = domain or joint_range(robot)
    in_chain = np.argsort(order)
    A = checks.positive_definite("A", checks.matrix("A", A, robot.n, StateError), StateError)
    inertia = normalised(polynomial, Interval.exact(A[np.ix_(in_chain, in_chain)]), sign)
    lower, upper, whole = _covered(robot, domain)
    first = float(lower[in_chain[0]])

    def complete(q: Array) -> Array:
        return np.concatenate([[first], q])[order]

    def value(q: Array) -> float:
        X = inertia.X
        M_l = robot.M_l(complete(q))[np.ix_(in_chain, in_chain)]
        return float(np.linalg.eigvalsh(sign * X @ M_l @ X.T)[-1])

    tried = np.reshape(np.asarray(samples, dtype=float), (-1, robot.n))
    if domain.near is not None:
        tried = np.vstack([tried, np.mean(domain.near, axis=1)])
    tried = np.clip(tried, lower, upper)[:, in_chain[1:]]
    box = np.column_stack([lower, upper])[in_chain[1:]]
    relevant = _near(domain, whole, in_chain[1:])
    found = supremum(inertia, box, value, tried, goal, most_boxes, relevant, watch)
    return RelativeInertia(found.bound, found.attained, complete(found.at), lower, upper, found.boxes, found)


def least_inertia(robot: Robot, A: ArrayLike, domain: Domain | None = None, goal: float = GOAL) -> RelativeInertia:
    """Return the largest number that is proven to satisfy M_l(q_l) >= bound A; see largest_inertia."""
    found = largest_inertia(robot, A, domain, goal, sign=-1.0)
    return replace(found, bound=-found.bound, attained=-found.attained)


def _covered(robot: Robot, domain: Domain) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return lower and upper (n,) of the domain, and which joints turn by a whole circle: their range is one turn."""
    ends = (domain.lower, domain.upper)
    lower, upper = (checks.vector("an end of the domain", end, robot.n, StateError) for end in ends)
    if not np.all(lower <= upper):
        raise StateError(f"the domain is {lower.tolist()} to {upper.tolist()}; expected lower <= upper")
    if domain.near is not None:
        _check_near(domain.near, lower, upper)
    slides = np.array([robot.links.bodies[joint].prismatic for joint in robot.links.order])
    whole = ~slides & (upper - lower >= 2 * np.pi - 1e-9)
    return lower, np.where(whole, lower + CIRCLE, upper), whole


def _check_near(near: Array, lower: Array, upper: Array) -> None:
    """Raise StateError for boxes (k, 2, n) that are not ordered within lower, upper (n,).

    A search would leave them out: its bound would not hold on them.
    """
    if np.ndim(near) != 3 or not len(near) or near.shape[1:] != (2, len(lower)):
        raise StateError(f"near has shape {np.shape(near)}; expected (k, 2, {len(lower)}) with k > 0")
    inside = (lower <= near[:, 0]) & (near[:, 0] <= near[:, 1]) & (near[:, 1] <= upper)
    if not np.all(inside):
        worst = near[np.argmin(inside.all(axis=1))].tolist()
        raise StateError(f"near contains {worst}; expected lower <= upper, within the domain")


def _near(domain: Domain, whole: NDArray[np.bool_], joints: NDArray[np.intp]) -> Callable[[Array], bool]:
    """Return whether a box (n - 1, 2) of the outer joints of the chain meets the domain.

    A joint that turns by a whole circle meets it at every angle, as its angles in the domain may be a turn away.
    """
    if domain.near is None:
        return lambda box: True
    lower, upper = (np.where(whole, end, domain.near[:, k])[:, joints] for k, end in enumerate((-np.inf, np.inf)))
    return lambda box: bool(np.any(np.all((lower <= box[:, 1]) & (upper >= box[:, 0]), axis=1)))


def _polynomial(robot: Robot) -> InertiaPolynomial:
    if not is_provable(robot):
        known = f"{robot.n} joints" if robot.links.bodies else "an inertia matrix whose bodies are not known"
        raise RobotError(f"the robot has {known}; expected a serial chain of at most 8 revolute joints for a proof")
    return _cached(pickle.dumps(robot.links.bodies))


@lru_cache(maxsize=2)
def _cached(bodies: bytes) -> InertiaPolynomial:
    return inertia_polynomial(pickle.loads(bodies))
