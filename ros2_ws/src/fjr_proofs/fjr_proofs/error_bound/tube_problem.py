# SPDX-License-Identifier: Apache-2.0
"""Find the tube about a centre motion that robots with factors in a box do not leave."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fjr_core.numerics.checks import Array

from .centre_motion import CentreMotion
from .invariant_tube import Deviations, fixed_point
from .peak_gains import ROUNDING
from .ranges import Ranges
from .sampled_deviation import LinearCells
from .steady_response import Drive, Response, steady_response, transient
from .tube import Tube

CREDIBLE = 0.3  # rad; largest position of a tube whose constants are sampled
GROWTH, ROUNDS = 1.4, 8  # of the tube that is tried
CLOSE = 1.05  # ratio of a bound to that of the known response at which a tube is not shrunk
SHRINKS = 0.9  # ratio of an ultimate bound to the last one at which it is final
NARROWER, BETWEEN = 6, 1.4  # halvings of a box at which a tube is sought, and a width between two of them

Within = Callable[[Array], Deviations | None]
"""Return bounds of the deviations that hold while these stay within a tube (4n,); None without any."""


@dataclass(frozen=True, eq=False)
class TubeProblem:
    """Linear model about a centre motion, gains of its sums, and ranges in a box of factors.

    disturbing (2n,) [N m]: torques on links and motors beside the errors of the factors.
    """

    linear: LinearCells
    gains: Array
    ranges: Ranges
    disturbing: Array

    def narrowed(self, share: float) -> TubeProblem:
        """Return the problem for a box about the factors of the centre motion, whose width is `share` of this one."""
        ranges, c = self.ranges, self.ranges.centre.factors
        return replace(
            self, ranges=replace(ranges, low=c + share * (ranges.low - c), high=c + share * (ranges.high - c))
        )

    @cached_property
    def known(self) -> Response:
        """Steady response to what is known: to first order in the factors, and along the lines to second order."""
        drive = self._drive
        if self.lines.shape[2]:
            drive = drive.beside(self.ranges.second_order(self.linear, self.lines))
        return steady_response(self.linear, self._centre.cells, drive, self.ranges.blocks)

    @cached_property
    def tube(self) -> Deviations | None:
        """Ultimate bounds of a robot in steady motion, and of one that starts on the reference if `from_start` exists.

        With verified constants a tube that is not CLOSE to the known response, or contains that to the start, is
        shrunk: each bound is the tube of the next one, until it decreases by less than 10 %.
        """
        found = self._found
        if found is None or not self._centre.cells.verified:
            return found
        close = self.from_start is None and self._excess(found) <= CLOSE
        return found if close else _shrunk(self._within(self.known), self.from_start or found)

    @cached_property
    def _found(self) -> Deviations | None:
        """Bounds of a robot in steady motion in the first tube that contains them; None without any."""
        found = _grown(self._within(self.known), self._first(self.known))
        if found is None or self._centre.cells.verified:
            return found
        return found if np.max(self.in_joints(found)[: self.linear.n]) <= CREDIBLE else None

    def in_joints(self, found: Deviations | None = None) -> Array:
        """Return bounds (4n,) of the deviations z: of the known response, and of what else `found` contains."""
        inverse, n = self.linear.coordinates.S_inverse, self.linear.n
        first_order = ROUNDING * np.abs(inverse @ self.known.Z[:, : 4 * n]).sum(axis=2).max(axis=0)
        if found is None:
            return np.asarray(first_order)
        return np.asarray(first_order + np.abs(inverse) @ (found.z - self._beside_lines))

    @cached_property
    def lines(self) -> Array:
        """Response (c, 4n, u) at the start of each cell to each factor, to first order, if it is known there."""
        cells = self._centre.cells
        if not cells.aligned:
            return np.zeros((cells.count, 4 * self.linear.n, 0))
        Z = steady_response(self.linear, cells, self._drive, self.ranges.blocks).Z
        return np.roll(Z[:, : 4 * self.linear.n, 1 : 1 + self._uncertain], 1, axis=0)

    @cached_property
    def _beside_lines(self) -> Array:
        """Bounds (4n,) of the known response at samples less that along the lines."""
        known, u = self.known.Z[:, : 4 * self.linear.n], self.lines.shape[2]
        return np.asarray(np.abs(np.delete(known, slice(1, 1 + u), axis=2)).sum(axis=2).max(axis=0))

    @property
    def _uncertain(self) -> int:
        return int(np.count_nonzero(self.ranges.high > self.ranges.low))

    def _beside(self, known: Response) -> Response:
        """Return a response without the lines, but with their changes in a cell."""
        if not self.lines.shape[2]:
            return known
        changes = np.abs(np.roll(self.lines, -1, axis=0) - self.lines).sum(axis=2).max(axis=0)
        inexact = (ROUNDING - 1) * np.abs(self.lines).sum(axis=2).max(axis=0)
        return replace(known, z=ROUNDING * (known.z - self.known.z + self._beside_lines + changes) + inexact)

    def _excess(self, found: Deviations) -> float:
        """Return the ratio of the bounds of the positions' errors to those of the known response."""
        n, largest = self.linear.n, self._centre.largest[: self.linear.n]
        return float(np.max((largest + self.in_joints(found)[:n]) / (largest + self.in_joints()[:n])))

    def as_tube(self, found: Deviations) -> Tube:
        """Return the tube about the lines with the bounds of what they leave."""
        inverse = self.linear.coordinates.S_inverse
        return Tube(inverse * found.z, inverse @ self.lines)

    @property
    def effect(self) -> Array:
        """Largest deviation of a position by each uncertain factor, to first order."""
        n = self.linear.n
        known = self.linear.coordinates.S_inverse[:n] @ self.known.Z[:, : 4 * n, 1 : 1 + self._uncertain]
        return np.asarray(np.abs(known).max(axis=(0, 1)))

    @cached_property
    def from_start(self) -> Deviations | None:
        """Bounds at all times of a robot that starts on the reference with the motors of its model; if verified."""
        if not self._centre.cells.verified:
            return None
        decaying = -self.known.Z[-1]
        decaying[:, 0] += self._start
        whole = self.known + transient(self.linear, self._centre.cells, decaying, self.ranges.blocks)
        return _grown(self._within(whole), self._first(whole))

    @property
    def share(self) -> float:
        """Width of a box about the same factors that has a tube, relative to this one."""
        shares = 0.5 ** np.arange(1, NARROWER + 1)
        share = next((share for share in shares if self.narrowed(share)._found is not None), float(shares[-1]))
        if share == shares[0]:  # two halves have a tube
            return float(share)
        return float(BETWEEN * share if self.narrowed(BETWEEN * share)._found is not None else share)

    @cached_property
    def _drive(self) -> Drive:
        return self.ranges.drive()

    @cached_property
    def _unknown(self) -> Array:
        given = np.append(self.disturbing, np.zeros(2 * self.linear.n))
        return np.asarray(self.linear.coordinates.errors @ (self.ranges.unknown(self._drive) + given))

    @property
    def _centre(self) -> CentreMotion:
        return self.ranges.centre

    def _first(self, known: Response) -> Array:
        n = self.linear.n
        return np.asarray(self.gains[: 4 * n, : 4 * n] @ self._unknown + self._beside(known).z)

    def _within(self, known: Response) -> Within:
        beside = self._beside(known)

        def within(tube: Array) -> Deviations | None:
            spread = self.ranges.spread(self.linear, tube, self._unknown, self.lines)
            return None if spread is None else fixed_point(self.linear, self.gains, spread, beside)

        return within

    @property
    def _start(self) -> Array:
        """Z (S,) of a robot on the reference at time 0; its efforts in transit are those of its model."""
        n, model, cells = self.linear.n, self.linear.model, self._centre.cells
        states, T = self.linear.models.loop.shape[1], cells.sample_period

        def state(motion: CentreMotion, t: float) -> tuple[Array, Array]:
            x, u = model.states(motion.path.columns(np.array([t])).reshape(-1, n).T, motion.factors)
            return x.full().ravel(), u.full().ravel()

        ideal = CentreMotion.ideal(cells, np.ones_like(self._centre.factors))
        times = -T * np.arange(1 + (states - 4 * n) // n)
        S = self.linear.coordinates
        apart = [[a - b for a, b in zip(state(ideal, t), state(self._centre, t), strict=True)] for t in times]
        return np.concatenate([S.S @ apart[0][0], *(S.effort @ u for _, u in apart[1:])])


def _grown(within: Within, first: Array) -> Deviations | None:
    """Return bounds that lie within their tube, which grows from `first` (4n,) on; None if none are found."""
    tube = GROWTH * first
    for _ in range(ROUNDS):
        found = within(tube)
        if found is None or np.all(found.z <= tube):
            return found
        tube = GROWTH * np.maximum(found.z, tube / GROWTH)
    return None


def _shrunk(within: Within, tube: Deviations) -> Deviations:
    """Return ultimate bounds of deviations that stay within a tube: each bound is the tube of the next one."""
    for _ in range(ROUNDS):
        found = within(tube.z)
        if found is None:
            return tube
        bounded = replace(found, z=np.minimum(found.z, tube.z))
        if np.all(bounded.z > SHRINKS * tube.z):
            return bounded
        tube = bounded
    return tube
