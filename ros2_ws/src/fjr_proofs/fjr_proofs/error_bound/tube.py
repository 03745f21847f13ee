# SPDX-License-Identifier: Apache-2.0
"""Find the steady motion of a robot, and the tube about it that no robot with factors in a box leaves.

The deviation z is a sum of known lines and a rest. While the rest stays in a tube, the torques w_l, w_m and errors e
of the effort, by which the robot differs from the linear model of its cell, are bounded by `Mismatch`. Peak gains turn
these bounds into bounds of z. If the new bounds lie within the tube, no solution that starts in its known response
(steady, or with the decay of a start) leaves it: up to the first instant at which one did, it would be within the
bounds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, reduce

import numpy as np
from scipy.linalg import block_diag

from fjr_core.numerics.checks import Array

from ..verification.taylor_models import ROUNDING
from .cells import Cells
from .deviation_model import CentreMotion, DeviationModel
from .enclosures import Mismatch, Ranges
from .known_response import KnownErrors, Response, course, steady_response
from .linear_loop import LinearLoop, linear_loop
from .uncertain_robot import INVERSE

STEPS = 5  # of Newton's method
MOST_ROUNDS = 500  # of the iteration to a fixed point
DIVERGED = 50.0  # growth of the bounds at which the iteration ends
MARGIN = 1 + 1e-3  # of the disturbance that is verified over the fixed point of the iteration
CREDIBLE = 0.3  # rad; largest position of a tube whose constants are sampled
GROWTH, ROUNDS = 1.1, 25  # of the tube that is tried
SPARSE = 8  # cells, of which one is taken to find a tube
CLOSE = 1.05  # ratio of a bound to that of the known response at which a tube is not shrunk
SHRINKS = 0.9  # ratio of an ultimate bound to the last one at which it is final


def steady_motion(
    model: DeviationModel, cells: Cells, factors: Array, delay: float, start: CentreMotion | None = None
) -> CentreMotion:
    """Return the centre motion of a robot with shares (u,), along which its sampled loop is steady; delay [s].

    Newton's method with one linear model: its steady response to the defect of the law and the age of the effort is
    added to the motion of the links until both balance on average over a sample. With cells of several samples the
    result is the same, as only the defect in their middle counts. The links stay on the reference if it has no period
    or the loop is unstable. start: motion from which it is found.
    """
    centre = CentreMotion.ideal(cells, factors) if start is None else replace(start, cells=cells, factors=factors)
    if not cells.periodic:
        return centre
    linear = linear_loop(model, centre, delay)
    if linear.spectral_radius >= 1:
        return centre
    for _ in range(STEPS):
        errors = Ranges(replace(linear, centre=centre), factors, factors, 1).known_errors()
        y = steady_response(linear, errors).Z[:, : 4 * model.n, 0]
        centre = centre.moved(y @ linear.coordinates.S_inverse[: model.n].T)
    return centre


@dataclass(frozen=True, eq=False)
class DeviationBounds:
    """Bounds in the coordinates of the linear model at all times.

    z (4n,), acceleration (n,) of the links: of what the lines leave of the deviation; effort (n,), and its change in a
    sample (n,) if the delay varies: of the whole deviation.
    """

    z: Array
    effort: Array
    change: Array
    acceleration: Array


def fixed_point(
    linear: LinearLoop, gains: Array, mismatch: Mismatch, known: Response | None = None, aged: float = 1.0
) -> DeviationBounds | None:
    """Return bounds that reproduce themselves, or None if the iteration diverges.

    gains: of peak_gains. They are verified: the disturbance that follows from the returned bounds, with a margin, is at
    most that from which they were computed. aged: factor from bounds of what acts now to those of its cause.
    """
    known = known or Response.none(linear.n, linear.models.loop.shape[1])
    n, disturbance = linear.n, mismatch.unknown
    most = DIVERGED * (float(known.z.max()) + float((gains[: 4 * n, : len(disturbance)] @ disturbance).max()))
    for _ in range(MOST_ROUNDS):
        assumed = MARGIN * disturbance
        bounds = _bounds_under(linear, gains, assumed, known)
        if not np.all(np.isfinite(bounds.z)) or bounds.z.max() > most:
            return None
        disturbance = mismatch.unknown + aged * _following(linear, mismatch, assumed, bounds)
        if np.all(disturbance <= assumed):
            return bounds
    return None


def loop_gain(linear: LinearLoop, gains: Array, mismatch: Mismatch) -> float:
    """Return the factor by which disturbances grow in a round of `fixed_point`, which converges if it is below 1."""
    known = Response.none(linear.n, linear.models.loop.shape[1])
    units = np.eye(len(mismatch.unknown))
    following = [_following(linear, mismatch, unit, _bounds_under(linear, gains, unit, known)) for unit in units]
    return float(np.abs(np.linalg.eigvals(np.array(following))).max())


def _following(linear: LinearLoop, mismatch: Mismatch, assumed: Array, bounds: DeviationBounds) -> Array:
    """Return the disturbances that follow from bounds of the deviations, and from those that they assume."""
    n = linear.n
    torques = mismatch.X @ bounds.z
    torques[: 2 * n] += np.concatenate([mismatch.M @ bounds.acceleration, mismatch.B @ bounds.effort])
    change = bounds.change + 2 * assumed[-n:] if linear.late else np.zeros(0)
    return np.concatenate([torques, change, mismatch.F @ bounds.z])


def _bounds_under(linear: LinearLoop, gains: Array, disturbance: Array, known: Response) -> DeviationBounds:
    """Return the bounds of deviations under disturbances: torques, changes and errors of the effort.

    Efforts, if aligned, and accelerations at the end of a cell are those of its own model or of the next.
    """
    n, S, links = linear.n, linear.models.loop.shape[1], linear.links
    at_samples = gains @ np.append(disturbance, known.remaining)
    slope_jump, law_jump = linear.jumps
    at_samples[S : S + n] += slope_jump @ at_samples[: 4 * n]
    at_samples[S + n : S + 2 * n] += law_jump @ at_samples[: 4 * n]
    at_samples[S + 2 * n :] += law_jump @ at_samples[: 4 * n] if linear.late else 0.0
    torque, error = disturbance[: 3 * n], disturbance[-n:]
    effort = at_samples[S + n : S + 2 * n] + error
    acting = effort + disturbance[3 * n : 4 * n] if linear.late else effort
    slope, by_effort, by_torque = linear.largest
    rate = slope @ at_samples[: 4 * n] + by_effort @ acting + by_torque @ torque
    rate[links] = at_samples[S : S + n] + (by_torque @ torque)[links]
    between, bulge = linear.between_samples(rate, slope[links] @ by_torque @ torque)
    return DeviationBounds(
        z=at_samples[: 4 * n] + between + known.z + known.between,
        effort=effort + known.effort,
        change=at_samples[S + 2 * n :] + known.change if linear.late else known.change,
        acceleration=rate[links] + bulge + known.acceleration + known.bulge,
    )


@dataclass(frozen=True, eq=False)
class Known:
    """What is known of the deviation in the cells of some ranges, to second order in the factors.

    lines (c, 4n, 1 + u), accelerations (c, n, 1 + u) of the links: of the robot in the middle, and by each factor, to
    first order. errors: of second order along the lines. whole: response to all that is known. rest: magnitudes of it
    less the lines, with their changes in the window of a cell; second (4n,): those of its second order at the samples.
    """

    ranges: Ranges
    lines: Array
    accelerations: Array
    errors: KnownErrors
    whole: Response
    rest: Response
    second: Array

    def positions_and_velocities(self, bounds: DeviationBounds) -> Array:
        """Return bounds (4n,) of z in the joints: of what is known, and of what else `bounds` contain."""
        inverse = self.ranges.linear.coordinates.S_inverse
        known = ROUNDING * np.abs(inverse @ self.whole.Z[:, : len(inverse)]).sum(axis=2).max(axis=0)
        return np.asarray(known + np.abs(inverse) @ (bounds.z - self.second))

    @property
    def sparse(self) -> Known:
        """What is known in one of SPARSE cells, if they are verified; else in all."""
        some, ranges = slice(None, None, SPARSE if self.ranges.linear.centre.cells.verified else 1), self.ranges
        lines, accelerations = self.lines[some], self.accelerations[some]
        return replace(self, ranges=ranges.of(ranges.at[some]), lines=lines, accelerations=accelerations)


@dataclass(frozen=True, eq=False)
class TubeProblem:
    """Ranges about a centre motion in a box of factors, and gains of the sums of the linear model.

    disturbing (2n,) [N m]: torques on links and motors beside the errors of the factors.
    """

    ranges: Ranges
    gains: Array
    disturbing: Array

    @property
    def linear(self) -> LinearLoop:
        """Linear model about the centre motion."""
        return self.ranges.linear

    @cached_property
    def tube(self) -> DeviationBounds | None:
        """Ultimate bounds of a robot in steady motion, and of one that starts on the reference if `from_start` exists.

        With verified constants a tube that is not CLOSE to the first order, or contains that from the start, is shrunk:
        each bound is the tube of the next one, until it decreases by less than 10 %.
        """
        first = self.grown(self.steady)
        if first is None:
            return None
        n, largest = self.linear.n, self.linear.centre.largest[: self.linear.n]
        positions = self.steady.positions_and_velocities(first)[:n]
        if not self.linear.centre.cells.verified:
            return first if np.max(positions) <= CREDIBLE else None
        if self.from_start is None and np.max((largest + positions) / (largest + self.first_order[:n])) <= CLOSE:
            return first
        return self.shrunk(self.from_start or first)

    @cached_property
    def from_start(self) -> DeviationBounds | None:
        """Bounds at all times of a robot that starts on the reference with the motors of its model; if verified."""
        return self.grown(*self.started) if self.linear.centre.cells.verified else None

    @cached_property
    def steady(self) -> Known:
        """What is known of a robot in steady motion."""
        cells, states = self.linear.centre.cells, slice(4 * self.linear.n)

        def respond(errors: KnownErrors) -> Response:
            return steady_response(self.linear, errors, self.ranges.blocks)

        first = respond(self._known_errors)
        lines = np.roll(first.Z[:, states], cells.aligned, axis=0) * cells.verified
        beside = (np.roll(lines, -k, axis=0) for k in cells.beside(self.ranges.blocks))
        return self._known(self.ranges, self._known_errors, first, (lines, *beside), respond)

    @cached_property
    def started(self) -> tuple[Known, Known]:
        """What is known of a robot that starts on the reference with its model's motors: until it is settled, and then.

        Until then the lines are those of the start. Then they are those of the steady motion, and what is left of the
        start is bounded; also in the last cells before, which windows of the cells after them contain.
        """
        linear, cells, blocks = self.linear, self.linear.centre.cells, self.ranges.blocks
        samples, (middle, beside) = cells.samples, cells.sampled_beside(blocks)
        margin = beside.stop // samples + 1
        at, start = np.arange(blocks + margin) % cells.count, np.zeros((len(self._start), 1 + self.ranges.factors))
        start[:, 0] = self._start
        first = course(linear, start, at, self._known_errors.at(at))
        Z = np.concatenate([start[None], first.Z])[:, : 4 * linear.n]
        ends = middle + samples * np.arange(blocks)
        lines = (Z[ends], *(Z[np.maximum(ends + k, 0)] for k in beside))
        later = self.steady.errors.at(at[blocks:])

        def respond(errors: KnownErrors) -> Response:
            return course(linear, np.zeros((len(start), errors.torque.shape[2])), at, errors.followed_by(later))

        ranges = self.ranges.of(at[:blocks])
        known = self._known(ranges, self._known_errors.at(ranges.at), first, lines, respond)
        last = np.repeat(at, samples)[-2 * margin * samples :]
        left = np.abs(known.whole.Z[-len(last) :] - self.steady.whole.Z[last]).sum(axis=2).max(axis=0)
        decay = course(linear, np.diag(left), (at[-1] + 1 + np.arange(blocks)) % cells.count)
        left = ROUNDING * np.maximum(left, np.abs(decay.Z).sum(axis=2).max(axis=0))
        return known, replace(self.steady, rest=self.steady.rest.plus(Response.within(linear, left)))

    @property
    def first_order(self) -> Array:
        """Largest deviations (4n,) in steady motion to first order in the factors."""
        verified, known = self.linear.centre.cells.verified, self.steady
        Z = known.lines if verified else known.whole.Z[:, : 4 * self.linear.n]
        return np.asarray(np.abs(self.linear.coordinates.S_inverse @ Z).sum(axis=2).max(axis=0))

    @property
    def loop_gains(self) -> Array:
        """Gains (u,) of the loops that each factor alone closes about the linear model."""
        few = self.steady.sparse
        parts = few.ranges.of_factors(len(self._unknown), few.lines)
        return np.array([loop_gain(self.linear, self.gains, mismatch) for mismatch in parts])

    @property
    def effects(self) -> Array:
        """Largest deviations of a position (u,) of second order in each factor; of first order if sampled."""
        u, n = self.ranges.factors, self.linear.n
        positions = self.linear.coordinates.S_inverse[:n] @ self.steady.whole.Z[:, : 4 * n]
        largest = np.abs(positions).max(axis=(0, 1))
        if not self.linear.centre.cells.verified:
            return np.asarray(largest[1:])
        i, j = np.triu_indices(u, 1)
        effects, mixed = largest[1 + u : 1 + 2 * u].copy(), largest[1 + 2 * u :]
        for factor in (i, j):
            np.add.at(effects, factor, mixed)
        return np.asarray(effects)

    def grown(self, *known: Known) -> DeviationBounds | None:
        """Return bounds that lie within their tube, which grows from what is known; None if none are found.

        The tube is found on a few cells and confirmed on all.
        """
        n, z, few = self.linear.n, np.max([each.rest.z for each in known], axis=0), [each.sparse for each in known]
        tube = GROWTH * np.asarray(self.gains[: 4 * n, : len(self._unknown)] @ self._unknown + z)
        for _ in range(ROUNDS):
            bounds = self._bounds_within(tube, *few)
            if bounds is not None and np.all(bounds.z <= tube):
                bounds = self._bounds_within(tube, *known)
            if bounds is None or np.all(bounds.z <= tube):
                return bounds
            tube = GROWTH * np.maximum(bounds.z, tube / GROWTH)
        return None

    def shrunk(self, tube: DeviationBounds) -> DeviationBounds:
        """Return ultimate bounds of deviations that stay within a tube: each bound is the tube of the next one."""
        for _ in range(ROUNDS):
            bounds = self._bounds_within(tube.z, self.steady)
            if bounds is None:
                return tube
            bounded = replace(bounds, z=np.minimum(bounds.z, tube.z))
            if np.all(bounded.z > SHRINKS * tube.z):
                return bounded
            tube = bounded
        return tube

    def _bounds_within(self, tube: Array, *known: Known) -> DeviationBounds | None:
        """Return bounds of the deviations that hold while these stay within a tube (4n,); None without any."""
        rest, largest, bounds = reduce(Response.most, (each.rest for each in known)), None, None
        for each in known:
            found = each.ranges.mismatch(tube, self._unknown, each.lines, each.accelerations)
            if found is None:
                return None
            largest = found if largest is None else largest.most(found)
            bounds = fixed_point(self.linear, self.gains, largest, rest)
            if bounds is None:
                return None
        return bounds

    def _known(
        self,
        ranges: Ranges,
        errors: KnownErrors,
        first: Response,
        lines: tuple[Array, ...],
        respond: Callable[[KnownErrors], Response],
    ) -> Known:
        """Return what is known with the response of first order: its lines, and other values that windows contain.

        respond: gives the response to the errors of second order.
        """
        if not self.linear.centre.cells.verified:
            still = np.zeros_like(lines[0][:, : self.linear.n])
            return Known(ranges, lines[0], still, errors, first, first, first.z)
        linear, links = self.linear.at(ranges.at), slice(2 * self.linear.n, 3 * self.linear.n)
        torque = linear.inputs[1][:, links] @ linear.coordinates.torques @ errors.torque
        accelerations = tuple(linear.A[:, links] @ z + torque for z in lines)
        second_errors = ranges.second_order(lines[0], accelerations[0])
        second = respond(second_errors)
        Z = second.Z.copy()
        Z[:, :, : first.Z.shape[2]] += first.Z
        whole = first.plus(second)._replace(Z=Z)
        rest = whole._replace(z=second.z + _changes(lines), acceleration=second.acceleration + _changes(accelerations))
        return Known(ranges, lines[0], accelerations[0], second_errors, whole, rest, second.z)

    @cached_property
    def _known_errors(self) -> KnownErrors:
        return self.ranges.known_errors()

    @cached_property
    def _unknown(self) -> Array:
        S, unknown = self.linear.coordinates, self.ranges.unknown_errors(self._known_errors)
        ends, of_joints = (self.ranges.low, self.ranges.high), self.linear.model.uncertain.of_joints
        least = [np.minimum(*(of_joints(name, end) for end in ends)) + np.zeros(self.linear.n) for name in INVERSE]
        unknown[: len(self.disturbing)] += self.disturbing / np.concatenate(least)  # as the equations are divided
        changes = [S.torque] if self.linear.late else []
        return np.asarray(np.abs(block_diag(S.torques, *changes, S.effort)) @ unknown)

    @property
    def _start(self) -> Array:
        """Z (S,) of a robot on the reference at time 0; its efforts in transit are those of its model."""
        n, centre, S = self.linear.n, self.linear.centre, self.linear.coordinates
        ideal = CentreMotion.ideal(centre.cells, self.linear.model.uncertain.nominal)

        def state(motion: CentreMotion, t: float) -> tuple[Array, Array]:
            path = motion.path.columns(np.array([t])).reshape(-1, n).T
            x, u = self.linear.model.states(path, motion.factors)
            return x.full().ravel(), u.full().ravel()

        def apart(t: float) -> tuple[Array, Array]:
            (x, u), (x_c, u_c) = state(ideal, t), state(centre, t)
            return x - x_c, u - u_c

        efforts = (self.linear.models.loop.shape[1] - 4 * n) // n
        times = -self.linear.sample_period * np.arange(1 + efforts)
        return np.concatenate([S.S @ apart(times[0])[0], *(S.effort @ apart(t)[1] for t in times[1:])])


def _changes(lines: tuple[Array, ...]) -> Array:
    """Return the largest differences (rows,) of lines (c, rows, k) from the first, and their rounding."""
    apart = np.max([np.abs(each - lines[0]).sum(axis=2).max(axis=0) for each in lines], axis=0)
    return np.asarray(ROUNDING * apart + (ROUNDING - 1) * np.abs(lines[0]).sum(axis=2).max(axis=0))
