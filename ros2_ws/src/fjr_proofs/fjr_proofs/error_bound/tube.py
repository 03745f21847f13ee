# SPDX-License-Identifier: Apache-2.0
"""Find the steady motion of a robot, and the tube about it that no robot with factors in a box leaves.

The deviation z is a sum of known lines and a rest. While the rest stays in a tube, the torques w_l, w_m and errors e
of the effort, by which the robot differs from the linear model of its cell, are bounded by `Mismatch`. Peak gains turn
these bounds into bounds of z. If the new bounds lie within the tube, no solution that starts in its known response
(steady, or with the decay of a start) leaves it: up to the first instant at which one did, it would be within the
bounds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from fjr_core.numerics.checks import Array

from .cells import Cells
from .deviation_model import CentreMotion, DeviationModel
from .enclosures import Mismatch, Ranges, Tube
from .linear_loop import KnownErrors, LinearLoop, Response, linear_loop, steady_response, transient
from .peak_gains import ROUNDING

STEPS = 5  # of Newton's method
MOST_ROUNDS = 500
DIVERGED = 50.0  # growth of the bounds at which the iteration ends
MARGIN = 1 + 1e-3  # of the disturbance that is verified over the fixed point of the iteration
CREDIBLE = 0.3  # rad; largest position of a tube whose constants are sampled
GROWTH, ROUNDS = 1.4, 8  # of the tube that is tried
CLOSE = 1.05  # ratio of a bound to that of the known response at which a tube is not shrunk
SHRINKS = 0.9  # ratio of an ultimate bound to the last one at which it is final
NARROWER, BETWEEN = 6, 1.4  # halvings of a box at which a tube is sought, and a width between two of them


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
        torques = mismatch.X @ bounds.z
        torques[: 2 * n] += np.concatenate([mismatch.M @ bounds.acceleration, mismatch.B @ bounds.effort])
        change = bounds.change + 2 * assumed[-n:] if linear.late else np.zeros(0)
        disturbance = mismatch.unknown + aged * np.concatenate([torques, change, mismatch.F @ bounds.z])
        if np.all(disturbance <= assumed):
            return bounds
    return None


def _bounds_under(linear: LinearLoop, gains: Array, disturbance: Array, known: Response) -> DeviationBounds:
    """Return the bounds of deviations under disturbances: torques, changes and errors of the effort.

    Between samples a bound grows by its rate. Efforts and accelerations at the end of a cell are those of its own model
    or, if aligned, of the next.
    """
    n, S, half = linear.n, linear.models.loop.shape[1], linear.between
    at_samples = gains @ np.append(disturbance, known.remaining)
    slope_jump, law_jump = linear.jumps
    at_samples[S : S + n] += slope_jump[2 * n : 3 * n] @ at_samples[: 4 * n]
    at_samples[S + n : S + 2 * n] += law_jump @ at_samples[: 4 * n]
    at_samples[S + 2 * n :] += law_jump @ at_samples[: 4 * n] if linear.late else 0.0
    torque, error = disturbance[: 3 * n], disturbance[-n:]
    effort = at_samples[S + n : S + 2 * n] + error
    acting = effort + disturbance[3 * n : 4 * n] if linear.late else effort
    slope = np.abs(linear.A).max(axis=0)
    by_effort, by_torque = (np.abs(inputs).max(axis=0) for inputs in linear.inputs)
    rate = linear.growth @ (slope @ at_samples[: 4 * n] + by_effort @ acting + by_torque @ torque)
    links = slice(2 * n, 3 * n)
    acceleration = at_samples[S : S + n] + (by_torque @ torque)[links] + half * slope[links] @ rate
    return DeviationBounds(
        z=at_samples[: 4 * n] + half * rate + known.z + half * known.rate,
        effort=effort + known.effort,
        change=at_samples[S + 2 * n :] + known.change if linear.late else known.change,
        acceleration=acceleration + known.acceleration + half * slope[links] @ known.rate,
    )


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

        With verified constants a tube that is not CLOSE to the known response, or contains that to the start, is
        shrunk: each bound is the tube of the next one, until it decreases by less than 10 %.
        """
        first = self._steady_tube
        if first is None or not self.linear.centre.cells.verified:
            return first
        if self.from_start is None:
            n, largest = self.linear.n, self.linear.centre.largest[: self.linear.n]
            excess = (largest + self.in_joints(first)[:n]) / (largest + self.first_order[:n])
            if np.max(excess) <= CLOSE:
                return first
        return self.shrunk(self.from_start or first)

    @cached_property
    def from_start(self) -> DeviationBounds | None:
        """Bounds at all times of a robot that starts on the reference with the motors of its model; if verified."""
        if not self.linear.centre.cells.verified:
            return None
        return self.grown(self.started)

    @cached_property
    def started(self) -> Response:
        """Response to what is known of a robot that starts on the reference with the motors of its model."""
        decaying = -self.known.Z[-1]
        decaying[:, 0] += self._start
        return self.known.plus(transient(self.linear, decaying, self.ranges.blocks))

    @cached_property
    def known(self) -> Response:
        """Steady response to what is known: to first order in the factors, and to second order along the lines."""
        return steady_response(self.linear, self._to_second_order, self.ranges.blocks)

    @cached_property
    def lines(self) -> Array:
        """Response (c, 4n, u) in each cell, at its start if aligned, to each factor to first order; zero if sampled."""
        cells, n = self.linear.centre.cells, self.linear.n
        if not cells.verified:
            return np.zeros((cells.count, 4 * n, self._uncertain))
        return np.roll(self._to_first_order.Z[:, : 4 * n, 1:], cells.aligned, axis=0)

    @cached_property
    def accelerations(self) -> Array:
        """Accelerations (c, n, u) of the links on the lines."""
        linear, n = self.linear, self.linear.n
        links, u = slice(2 * n, 3 * n), self._uncertain
        if not linear.centre.cells.verified:
            return np.zeros((len(self.lines), n, u))
        torque = linear.coordinates.torques @ self._known_errors.torque[:, :, 1 : 1 + u]
        return np.asarray(linear.A[:, links] @ self.lines + linear.inputs[1][:, links] @ torque)

    @property
    def effect(self) -> Array:
        """Largest deviation of a position by each uncertain factor, to first order."""
        n = self.linear.n
        positions = self.linear.coordinates.S_inverse[:n] @ self._to_first_order.Z[:, : 4 * n, 1:]
        return np.asarray(np.abs(positions).max(axis=(0, 1)))

    @property
    def first_order(self) -> Array:
        """Largest deviations (4n,) to first order in the factors."""
        responses = self.linear.coordinates.S_inverse @ self._to_first_order.Z[:, : 4 * self.linear.n]
        return np.asarray(np.abs(responses).sum(axis=2).max(axis=0))

    @property
    def share(self) -> float:
        """Width of a box about the same factors that has a tube, relative to this one."""
        shares = 0.5 ** np.arange(1, NARROWER + 1)
        share = next((share for share in shares if self._has_tube(share)), float(shares[-1]))
        if share == shares[0]:  # two halves have a tube
            return float(share)
        return float(BETWEEN * share if self._has_tube(BETWEEN * share) else share)

    def in_joints(self, bounds: DeviationBounds) -> Array:
        """Return bounds (4n,) of the deviations z: of the known response, and of what else `bounds` contain."""
        inverse, n = self.linear.coordinates.S_inverse, self.linear.n
        known = ROUNDING * np.abs(inverse @ self.known.Z[:, : 4 * n]).sum(axis=2).max(axis=0)
        return np.asarray(known + np.abs(inverse) @ (bounds.z - self._rest.z))

    def as_tube(self, bounds: DeviationBounds) -> Tube:
        """Return the tube about the lines with the bounds of what they leave."""
        inverse = self.linear.coordinates.S_inverse
        return self.ranges.tube(inverse * bounds.z, self.lines)

    @cached_property
    def _steady_tube(self) -> DeviationBounds | None:
        """Bounds of a robot in steady motion in the first tube that contains them; None without any."""
        bounds = self.grown(self.known)
        if bounds is None or self.linear.centre.cells.verified:
            return bounds
        return bounds if np.max(self.in_joints(bounds)[: self.linear.n]) <= CREDIBLE else None

    def _has_tube(self, share: float) -> bool:
        """Return whether a box about the factors of the centre motion, of a share of this width, has a tube."""
        ranges, c = self.ranges, self.linear.centre.factors
        low, high = (c + share * (end - c) for end in (ranges.low, ranges.high))
        return replace(self, ranges=Ranges(self.linear, low, high, ranges.blocks))._steady_tube is not None

    def grown(self, known: Response) -> DeviationBounds | None:
        """Return bounds that lie within their tube, which grows from the known response; None if none are found."""
        n, rest = self.linear.n, self._without_lines(known)
        tube = GROWTH * np.asarray(self.gains[: 4 * n, : len(self._unknown)] @ self._unknown + rest.z)
        for _ in range(ROUNDS):
            bounds = self._bounds_within(tube, rest)
            if bounds is None or np.all(bounds.z <= tube):
                return bounds
            tube = GROWTH * np.maximum(bounds.z, tube / GROWTH)
        return None

    def shrunk(self, tube: DeviationBounds) -> DeviationBounds:
        """Return ultimate bounds of deviations that stay within a tube: each bound is the tube of the next one."""
        rest = self._without_lines(self.known)
        for _ in range(ROUNDS):
            bounds = self._bounds_within(tube.z, rest)
            if bounds is None:
                return tube
            bounded = replace(bounds, z=np.minimum(bounds.z, tube.z))
            if np.all(bounded.z > SHRINKS * tube.z):
                return bounded
            tube = bounded
        return tube

    def _bounds_within(self, tube: Array, rest: Response) -> DeviationBounds | None:
        """Return bounds of the deviations that hold while these stay within a tube (4n,); None without any."""
        mismatch = self.ranges.mismatch(tube, self._unknown, self.lines, self.accelerations)
        return None if mismatch is None else fixed_point(self.linear, self.gains, mismatch, rest)

    def _without_lines(self, known: Response) -> Response:
        """Return a response without the lines, but with their changes in the window of a cell."""
        if not self.linear.centre.cells.verified:
            return known
        parts = []
        for name, lines in (("z", self.lines), ("acceleration", self.accelerations)):
            whole, own, rest = (getattr(response, name) for response in (known, self.known, self._rest))
            inexact = (ROUNDING - 1) * np.abs(lines).sum(axis=2).max(axis=0)
            parts.append(ROUNDING * (whole - own + rest + self._changes(lines)) + inexact)
        return replace(known, z=parts[0], acceleration=parts[1])

    def _changes(self, lines: Array) -> Array:
        """Return the largest differences (rows,) of lines (c, rows, u) of the cells whose times a window contains."""
        offsets = self.linear.centre.cells.beside(self.ranges.blocks)
        apart = [np.abs(np.roll(lines, -k, axis=0) - lines).sum(axis=2) for k in offsets]
        return np.asarray(np.max(apart, axis=(0, 1)))

    @cached_property
    def _rest(self) -> Response:
        """Steady response to what is known beside the lines."""
        on_lines = self._uncertain if self.linear.centre.cells.verified else 0
        errors = self._to_second_order.without(slice(1, 1 + on_lines))
        return steady_response(self.linear, errors, self.ranges.blocks)

    @cached_property
    def _to_first_order(self) -> Response:
        return steady_response(self.linear, self._known_errors, self.ranges.blocks)

    @cached_property
    def _to_second_order(self) -> KnownErrors:
        if not self.linear.centre.cells.verified or not self._uncertain:
            return self._known_errors
        return self._known_errors.extended(*self.ranges.second_order(self.lines, self.accelerations))

    @cached_property
    def _known_errors(self) -> KnownErrors:
        return self.ranges.known_errors()

    @cached_property
    def _unknown(self) -> Array:
        S, unknown = self.linear.coordinates, self.ranges.unknown_errors(self._known_errors)
        unknown[: len(self.disturbing)] += self.disturbing
        changes = [S.torque] if self.linear.late else []
        return np.asarray(np.abs(block_diag(S.torques, *changes, S.effort)) @ unknown)

    @property
    def _uncertain(self) -> int:
        """Number of uncertain factors."""
        return len(self.ranges.low)

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
