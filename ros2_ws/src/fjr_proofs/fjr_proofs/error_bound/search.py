# SPDX-License-Identifier: Apache-2.0
"""Bound the tracking error of a sampled loop along a reference, for model errors, hold and delay (docs/method.md).

The box of the robot's factors is divided until each part has an invariant tube about its own steady motion; the bound
is the largest of the parts. With sines as the reference every constant is enclosed by Taylor models, and the bound is
proven. Otherwise the ranges are those of random points of the same boxes: sampled.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from fjr_core.errors import ParameterError, StateError
from fjr_core.law.interfaces import StaticLaw
from fjr_core.motions.reference import Reference
from fjr_core.numerics.checks import Array, floats
from fjr_core.numerics.one_line import one_line
from fjr_core.stability.linearization import checked_times, split

from ..verification.taylor_models import taylor_function
from .cells import Cells, cells_of
from .deviation_model import CentreMotion, DeviationModel
from .enclosures import Ranges
from .linear_loop import LinearLoop, linear_loop, peak_gains
from .tube import TubeProblem, steady_motion
from .uncertain_robot import PARAMETERS, UncertainRobot

TORQUES = ("link_torque", "motor_torque")
"""Names of errors in N m of any joint, with any time course; the others are PARAMETERS."""
DELAY = "delay"
"""Name of the error of the delay in samples, which may change from sample to sample."""
SECONDS_TO_PROVE = 2  # joints
NARROWEST = 0.02  # width of shares that are not divided
MOST_PARTS = {False: 128, True: 1024}
"""Parts of a box. True: for a proof that is asked for; then the box is also divided for a bound from the start."""
SOLVABLE = 0.5
"""Gain of the loop that a factor of a part closes, up to which the part may have a tube."""
HOPELESS = 8  # times as many parts, if all were as narrow as one without bounds, at which the division ends
TINY = 1e-12  # rad, or of a sum of effects: as good as zero
TIGHT = 1.05  # ratio of a bound to that of the known response, below which a part is not divided
WORTH = 0.99  # ratio of the bounds of halves to that of a part, up to which it is divided
REMAINS = 2e-2  # of a deviation after the sums of the gains, which bound the rest
LONGEST_SUM = 20_000  # samples
FEW = 16  # cells that give the decay of a deviation, and at whose end the gains of a sampled bound are computed
COARSE = 100  # cells on which centre motions are found

Progress = Callable[[float], None]
"""Called with the share of the parts so far that have a tube, then a bound from the start; falls at a division."""


@dataclass(frozen=True, eq=False)
class ErrorBound:
    """Bound of the deviations from the reference for all model errors up to `errors`.

    position, velocity (n,) [rad, rad/s]: ultimate bounds of |q_l - q_ld| and |dq_l - dq_ld| in steady motion; infinite
    if no invariant tube was found. from_start (n,) [rad]: bound of the positions at all times for a robot that starts
    on the reference, and then ends within `position`; infinite unless proven. errors: of PARAMETERS, TORQUES and DELAY.
    storage [J]: ultimate bound of V in steady motion; nan if the law has none. parts: number of parts
    of the box of factors. proven: every constant is verified; otherwise the bound rests on sampled constants.
    """

    position: Array
    velocity: Array
    from_start: Array
    storage: float
    errors: Mapping[str, ArrayLike]
    sample_period: float
    delay: float
    parts: int
    proven: bool

    __repr__ = one_line

    @property
    def found(self) -> bool:
        """True if the bound is finite."""
        return bool(np.all(np.isfinite(self.position)))


def bound_errors(
    law: StaticLaw,
    reference: Reference,
    sample_period: float,
    delay: float = 0.0,
    errors: Mapping[str, ArrayLike] = {},
    progress: Progress = lambda share: None,
    prove: bool | None = None,
    payload_position: ArrayLike = (0.0, 0.0, 0.0),
    seconds: float = np.inf,
) -> ErrorBound:
    """Return a bound of the tracking errors on the reference of the law sampled every sample_period [s].

    delay [s]: from a state to the effort that answers it. errors: largest errors of the robot's PARAMETERS, one number
    or one for each joint or axis (`UncertainRobot`, also for payload_position), largest TORQUES [N m] that act at any
    joint with any time course, and that of the DELAY, which stays between two whole numbers of samples. progress: see
    `Progress`. prove: whether a proof is tried; None: where it takes seconds, with up to SECONDS_TO_PROVE joints or
    without an error of a parameter. seconds: longest time of the divisions, half of it for a proof; if prove is True,
    only of those for a bound from the start.
    Raises ParameterError for an unknown name, an error that is negative or too large, and a reference that has neither
    a common period nor an end within 60 s; StateError unless the sample period is positive and the delay not negative;
    CompilerError without a C compiler.
    """
    sample_period, delay = checked_times(sample_period, delay)
    known = *PARAMETERS, *TORQUES, DELAY
    for name in errors:
        if name not in known:
            raise ParameterError(f"error '{name}' is unknown; expected some of {', '.join(known)}")
    _, fraction = split(delay, sample_period)
    limits = dict.fromkeys(TORQUES, np.inf) | {DELAY: min(fraction, 1 - fraction)}
    sizes = {name: floats(name, errors.get(name, 0.0), ParameterError) for name in limits}
    for name, limit in limits.items():
        if sizes[name].ndim or not 0 <= sizes[name] <= limit or np.isinf(sizes[name]):
            room = f", beside a delay of {delay / sample_period:g} samples" if name == DELAY else ""
            raise ParameterError(f"error '{name}' is {sizes[name]}; expected 0 to {limit:g}{room}")
    n, torques = law.robot.n, [sizes[name] for name in TORQUES]
    model = DeviationModel(law, UncertainRobot(law.robot, errors, payload_position))
    box = -np.ones(model.uncertain.count), np.ones(model.uncertain.count)
    given, late = (model, reference, sample_period, delay, np.repeat(torques, n)), sample_period * float(sizes[DELAY])
    begin = np.inf if prove else time.monotonic()
    search = Search(*given, verified=True, late=late, asked=prove is True, seconds=seconds, end=begin + seconds / 2)
    if prove is None:
        prove = n <= SECONDS_TO_PROVE or not model.uncertain.count
    boxes = search.boxes(*box, progress) if prove and search.applies else []
    proven = bool(boxes) and all(box.has_tube for box in boxes)
    if not proven:
        boxes = Search(*given, verified=False, late=late, end=begin + seconds).boxes(*box, progress)
    ultimate = np.max([box.ultimate for box in boxes], axis=0)
    start = np.max([box.from_start for box in boxes], axis=0)
    storage = float(np.max([box.storage for box in boxes]))
    loop = dict(errors), sample_period, delay
    return ErrorBound(ultimate[:n], ultimate[n:], start[:n], storage, *loop, len(boxes), proven)


@dataclass(frozen=True, eq=False)
class FactorBox:
    """Part of the box of factors, low to high (u,), with its centre motion and the tube about it.

    centre: of the robot in the middle; the reference itself if the loop is unstable or has no period. effects (u,):
    of each factor, by which the part is divided: of second order on a position [rad]; without all bounds the share of
    that, plus the share of the gain of the loop that it closes. first_order, ultimate, from_start (2n,): bounds of
    |q_l - q_ld| and |dq_l - dq_ld|: by the known response to the factors alone; in the steady state; at all times for
    a robot that starts on the reference. The latter two are infinite without a tube. storage: largest V [J] in the
    steady state; nan if the law has none. gains (u,): of the loops that the factors close, where bounds are missing.
    """

    low: Array
    high: Array
    centre: CentreMotion
    effects: Array
    first_order: Array
    ultimate: Array
    from_start: Array
    storage: float = np.inf
    gains: Array | float = 0.0

    @property
    def has_tube(self) -> bool:
        """True if the part has a tube."""
        return bool(np.all(np.isfinite(self.ultimate)))

    @property
    def has_all_bounds(self) -> bool:
        """True if the part has a tube from the start, too."""
        return self.has_tube and bool(np.all(np.isfinite(self.from_start)))

    @property
    def size(self) -> float:
        """Largest bound of a position; infinite without a tube."""
        return float(np.max(np.split(self.ultimate, 2)[0]))

    @property
    def excess(self) -> float:
        """Ratio of the bound of the positions to that to first order in the factors; infinite without a tube."""
        bound, least = (np.split(bounds, 2)[0] for bounds in (self.ultimate, self.first_order))
        return float(np.max(bound / np.maximum(least, TINY)))

    @property
    def narrow(self) -> bool:
        """True if no factor can be divided."""
        return bool(np.all(self.high - self.low <= NARROWEST))

    def volume(self, low: Array, high: Array) -> float:
        """Return the share of this part in the volume of a box of factors."""
        width = high - low
        return float(np.prod(np.divide(self.high - self.low, width, out=np.ones_like(width), where=width > 0)))

    @property
    def halvings(self) -> Array:
        """How often (u,) each factor is to be halved: until the gain of its loop is at most SOLVABLE, or it is narrow.

        That with the largest effect is halved at least once; without any effect, the widest. Gains go with the width.
        """
        width = self.high - self.low
        narrow = np.ceil(np.log2(np.maximum(width / NARROWEST, 1.0)))
        times = np.minimum(np.ceil(np.log2(np.maximum(self.gains / SOLVABLE, 1.0))), narrow) + np.zeros(len(width))
        first = np.argmax(np.where(narrow > 0, self.effects if np.any(self.effects) else width, -1.0))
        times[first] = max(times[first], 1.0)
        return times

    def divided(self) -> list[tuple[Array, Array]]:
        """Return the equal parts into which `halvings` divide the box."""
        counts = (2**self.halvings).astype(int)
        edges = [np.linspace(a, b, 1 + count) for a, b, count in zip(self.low, self.high, counts, strict=True)]
        lows, highs = (product(*(each[part] for each in edges)) for part in (slice(-1), slice(1, None)))
        return [(np.array(low), np.array(high)) for low, high in zip(lows, highs, strict=True)]


@dataclass(frozen=True, eq=False)
class Search:
    """Division of the box of factors into parts with invariant tubes.

    disturbing (2n,) [N m]: torques on links and motors beside the errors of the factors. late: of LinearLoop. asked: of
    MOST_PARTS. seconds: longest time of the division for a bound from the start. end: when other divisions end [s].
    """

    model: DeviationModel
    reference: Reference
    T: float
    delay: float
    disturbing: Array
    verified: bool
    late: float = 0.0
    asked: bool = False
    seconds: float = np.inf
    end: float = np.inf

    @cached_property
    def cells(self) -> Cells:
        """Cells on which tubes are verified, or sampled."""
        return cells_of(self.reference, self.T, self.verified)

    @property
    def applies(self) -> bool:
        """True if the constants can be verified.

        That takes a reference with bounds between points and a law of known operations.
        """
        if not self.cells.verifiable:
            return False
        try:
            for function in (self.model.law_slope, self.model.defect, self.model.slopes):
                taylor_function(function)
        except StateError:
            return False
        return True

    def boxes(self, low: Array, high: Array, progress: Progress = lambda share: None) -> list[FactorBox]:
        """Divide the box until each part has a tube, then the part with the largest bound until it is tight.

        A part without a tube that cannot be divided, as it is narrow, parts are or will be too many or the time is
        over, ends the search.
        """
        waiting: list[tuple[Array, Array, CentreMotion | None]] = [(low, high, None)]
        boxes: list[FactorBox] = []
        while waiting:
            box = self._solved(*waiting.pop())
            if box.has_tube:
                boxes.append(box)
                progress(len(boxes) / (len(boxes) + len(waiting)))
            elif self._divisible(box, len(waiting) + len(boxes) + 1, low, high):
                waiting += [(*ends, box.centre) for ends in box.divided()]
            else:
                return [box]
        while len(boxes) < MOST_PARTS[self.asked] and time.monotonic() < self.end:
            worst = max(boxes, key=lambda box: box.size)
            if worst.excess <= TIGHT or worst.narrow:
                break
            parts = [self._solved(*ends, worst.centre) for ends in worst.divided()]
            if max(part.size for part in parts) > WORTH * worst.size:
                break
            boxes = [box for box in boxes if box is not worst] + parts
        return self._for_start(boxes, low, high, progress) if self.asked else boxes

    def _for_start(self, boxes: list[FactorBox], low: Array, high: Array, progress: Progress) -> list[FactorBox]:
        """Divide the parts that have a tube until each has a bound from the start, too, or the time is over."""
        end = time.monotonic() + self.seconds
        while time.monotonic() < end and (without := [box for box in boxes if not box.has_all_bounds]):
            progress(1 - len(without) / len(boxes))
            first = max(without, key=lambda box: np.sum(box.gains))
            if not self._divisible(first, len(boxes), low, high):
                break
            parts = [self._solved(*ends, first.centre) for ends in first.divided()]
            if not all(part.has_tube for part in parts):
                break
            boxes = [box for box in boxes if box is not first] + parts
        return boxes

    def _divisible(self, box: FactorBox, parts: int, low: Array, high: Array) -> bool:
        """Return whether a box, one of `parts`, can be divided: wide, in time, and parts are and will be few enough."""
        if box.narrow or parts >= MOST_PARTS[self.asked] or time.monotonic() > self.end:
            return False
        return bool(2.0 ** box.halvings.sum() <= HOPELESS * MOST_PARTS[self.asked] * box.volume(low, high))

    def _solved(self, low: Array, high: Array, start: CentreMotion | None) -> FactorBox:
        """Return the part of the box between the factors low and high (u,), with its invariant tube if there is one."""
        linear, none = self.linear((low + high) / 2, start), np.full(2 * self.model.n, np.inf)
        box = FactorBox(low, high, linear.centre, np.zeros(len(low)), none, none, none)
        try:
            problem = self.problem(linear, low, high)
            return box if problem is None else _with_bounds(box, problem)
        except ZeroDivisionError:  # a divisor may be zero: the part is too wide
            return box

    def linear(self, factors: Array, start: CentreMotion | None = None) -> LinearLoop:
        """Return the linear model about the steady motion of a robot with the factors (u,), found from `start`."""
        coarse = steady_motion(self.model, self._coarse, factors, self.delay, start)
        return linear_loop(self.model, replace(coarse, cells=self.cells), self.delay, self.late)

    def problem(self, linear: LinearLoop, low: Array, high: Array) -> TubeProblem | None:
        """Return the problem of a tube for factors from low to high (u,); None for an unstable loop."""
        found = self.gains(linear)
        return None if found is None else TubeProblem(Ranges(linear, low, high, found[1]), found[0], self.disturbing)

    def gains(self, linear: LinearLoop, rate: float = 0.0, few: bool = False) -> tuple[Array, int] | None:
        """Return peak gains of exp(rate t) Z and the cells of their sums; None if it does not decay.

        few: at the end of FEW cells only.
        """
        count, growth = self.cells.count, float(np.exp(rate * self.T))
        spread = np.unique(np.linspace(0, count - 1, min(count, FEW)).round().astype(int))
        blocks = self._blocks(growth * linear.at(spread).spectral_radius)
        if blocks is None:
            return None
        finals = np.arange(count) if self.cells.verified and not few else spread
        found = peak_gains(linear.models.growing(growth), self.cells, self.T, blocks, finals)
        return (found, blocks) if np.all(np.isfinite(found)) else None

    @cached_property
    def _coarse(self) -> Cells:
        """Cells on which centre motions are found."""
        return cells_of(self.reference, self.T, self.verified, COARSE)

    def _blocks(self, radius: float) -> int | None:
        """Return the number of cells after which a deviation has decayed to REMAINS; None without a decay."""
        if not radius < 1:
            return None
        samples = np.log(REMAINS) / np.log(radius) if radius > 0 else 1.0
        return None if samples > LONGEST_SUM else int(np.ceil(samples / self.cells.samples)) + 1


def _with_bounds(box: FactorBox, problem: TubeProblem) -> FactorBox:
    """Return the part with the bounds of its problem."""

    def bound(z: Array) -> Array:
        q, _, dq, _ = np.split(z, 4)
        return np.asarray(box.centre.largest + np.concatenate([q, dq]))

    box = replace(box, effects=problem.effects, first_order=bound(problem.first_order))
    if box.centre.cells.verified and (problem.tube is None or problem.from_start is None):
        gains = problem.loop_gains
        effects = sum(each / max(each.sum(), TINY) for each in (box.effects, gains))
        box = replace(box, effects=effects, gains=gains)
    if problem.tube is None:
        return box
    directions = problem.linear.coordinates.S_inverse * problem.tube.z
    storage = problem.ranges.storage(problem.ranges.tube(directions, problem.steady.lines))
    box = replace(box, ultimate=bound(problem.steady.positions_and_velocities(problem.tube)), storage=storage)
    if problem.from_start is None:
        return box
    start = [bound(known.positions_and_velocities(problem.from_start)) for known in problem.started]
    return replace(box, from_start=np.max(start, axis=0))
