# SPDX-License-Identifier: Apache-2.0
"""Response of the linear loop to what is known of the errors.

What a robot differs from the centre motion in is, to first order, known up to the factors f, which are constant: the
age of the acting effort, the defect of the law, and the torque errors' derivatives with respect to f. The response to
each is computed over a period. It is not bounded, so that it keeps its signs and its course in time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fjr_core.law.linearized import Indices
from fjr_core.numerics.checks import Array

from ..verification.taylor_models import ROUNDING
from .linear_loop import LinearLoop


@dataclass(frozen=True, eq=False)
class KnownErrors:
    """Known errors of torques and efforts in each of c cells: the first of k columns, and the others times -1 to 1.

    torque (c, 3n, k) [N m], effort (c, n, k) [N m]; aging (c, 3n) [N m/s] times the age of the acting effort in the
    first column.
    """

    torque: Array
    aging: Array
    effort: Array

    def at(self, cells: Indices) -> KnownErrors:
        """Return the errors of the selected cells."""
        return KnownErrors(self.torque[cells], self.aging[cells], self.effort[cells])

    def followed_by(self, others: KnownErrors) -> KnownErrors:
        """Return the errors with those of further cells."""
        pairs = (self.torque, others.torque), (self.aging, others.aging), (self.effort, others.effort)
        return KnownErrors(*map(np.concatenate, pairs))

    def torque_at(self, age: float) -> Array:
        """Return the torques (c, 3n, k) at an age [s] of the effort."""
        torque = self.torque.copy()
        torque[:, :, 0] += age * self.aging
        return torque


class Response(NamedTuple):
    """Response Z (c, S, k) at the end of each cell, and largest magnitudes over all cells and all columns together.

    z (4n,), acceleration (n,): deviation, and that of the links, at the samples; between, bulge: by how much they may
    exceed these in between. effort (n,), and its change (n,) since the last sample. remaining (S,): of Z before the
    sums of the gains.
    """

    Z: Array
    z: Array
    between: Array
    acceleration: Array
    bulge: Array
    effort: Array
    change: Array
    remaining: Array

    @classmethod
    def none(cls, n: int, states: int) -> Response:
        """Return the response to nothing."""
        return cls(np.zeros((0, states, 0)), *map(np.zeros, (4 * n, 4 * n, n, n, n, n, states)))

    @classmethod
    def within(cls, linear: LinearLoop, Z: Array) -> Response:
        """Return the largest magnitudes of any response within bounds Z (S,)."""
        n, law, y = linear.n, np.abs(linear.law).max(axis=0), Z[: 4 * linear.n]
        effort = np.max([law @ y, *Z[4 * n :].reshape(-1, n)], axis=0)
        slope, by_effort, _ = linear.largest
        rate = slope @ y + by_effort @ effort
        between, bulge = linear.between_samples(rate, np.zeros(n))
        return cls(np.zeros((0, len(Z), 0)), y, between, rate[linear.links], bulge, effort, 2 * effort, Z)

    def plus(self, other: Response, share: float = 1.0) -> Response:
        """Return the sum with a share of the largest magnitudes of another response; Z stays."""
        return Response(self.Z, *(own + share * more for own, more in zip(self[1:], other[1:], strict=True)))

    def most(self, other: Response) -> Response:
        """Return the larger magnitudes of two responses; Z stays."""
        return Response(self.Z, *(np.maximum(own, more) for own, more in zip(self[1:], other[1:], strict=True)))


def steady_response(linear: LinearLoop, errors: KnownErrors, blocks: int = 0) -> Response:
    """Return the steady response to known errors in each cell; from rest if the reference is not periodic.

    blocks: cells of the sums of the gains. A chain that is longer than them ends `slips` cells beside the one in which
    it is, where the samples do not divide the period.
    """
    models, cells = linear.models, linear.centre.cells
    errors, force = _forced(linear, errors)
    step, pushed = np.zeros_like(models.loop) + np.eye(models.loop.shape[1]), np.zeros_like(force)
    for _ in range(cells.samples - 1):
        step, pushed = models.loop @ step, models.loop @ pushed + force
    before_last, pushed_before_last = step, pushed
    step, pushed = models.loop @ step, models.loop @ pushed + force
    Z, ends, earlier = np.zeros(force.shape[1:]), np.zeros(force.shape), np.zeros(force.shape)
    if cells.periodic:
        whole: Array = np.eye(len(Z))
        for A, b in zip(step, pushed, strict=True):
            whole, Z = np.asarray(A @ whole), A @ Z + b
        Z = np.asarray(np.linalg.solve(np.eye(len(Z)) - whole, Z))
    for i in range(cells.count):
        earlier[i] = before_last[i] @ Z + pushed_before_last[i]
        ends[i] = Z = step[i] @ Z + pushed[i]
    slips = np.ceil(blocks * cells.drift / cells.length) + 1 if cells.drift else 0.0
    remaining = slips * _largest(ends - np.roll(ends, 1, axis=0))
    after = np.roll(np.arange(cells.count), -int(cells.verified))
    following = linear.at(after), errors.at(after)
    return _magnitudes((linear, errors), following, ends, earlier, remaining)


def course(linear: LinearLoop, Z: Array, at: Indices, errors: KnownErrors | None = None) -> Response:
    """Return the response to known errors of the cells `at`, one after the other, from Z (S, k) at time 0.

    Z (samples, S, k) of the result is the response at the end of each sample of them: a sample ends its cell, so that
    the first cell is as long as it has to be. Without errors Z decays.
    """
    n, samples, own = linear.n, linear.centre.cells.samples, linear.at(at)
    if errors is None:
        errors = KnownErrors(*map(np.zeros, ((len(at), 3 * n, Z.shape[1]), (len(at), 3 * n), (len(at), n, Z.shape[1]))))
    errors, force = _forced(own, errors)
    loop = own.models.loop
    course, earlier = np.empty((2, len(at), samples, *Z.shape))
    for sample in range(samples):
        earlier[0, sample], Z = Z, loop[0] @ Z + force[0]
        course[0, sample] = Z
    for i in range(1, len(at)):
        course[i] = course[i - 1]
        for _ in range(samples):
            earlier[i], course[i] = course[i], loop[i] @ course[i] + force[i]
    of_samples = np.repeat(np.arange(len(at)), samples)
    after = np.append(of_samples[1:], of_samples[-1])
    ended, following = ((own.at(each), errors.at(each)) for each in (of_samples, after))
    shape = len(of_samples), *Z.shape
    return _magnitudes(ended, following, course.reshape(shape), earlier.reshape(shape), np.zeros(len(Z)))


def _forced(linear: LinearLoop, errors: KnownErrors) -> tuple[KnownErrors, Array]:
    """Return errors in the coordinates of the linear model, and by what (c, S, k) they move Z in a sample."""
    S = linear.coordinates
    errors = KnownErrors(S.torques @ errors.torque, errors.aging @ S.torques.T, S.effort @ errors.effort)
    force = linear.models.effort @ errors.effort
    force[:, : 4 * linear.n] += linear.forced(errors.torque, errors.aging)
    return errors, force


def _magnitudes(
    ended: tuple[LinearLoop, KnownErrors],
    following: tuple[LinearLoop, KnownErrors],
    Z: Array,
    earlier: Array,
    remaining: Array,
) -> Response:
    """Return the response at the end of cells with its largest magnitudes.

    earlier: Z one sample before; the last of its efforts acts until the sample, the torque is that of either end of it.
    following: the cells of the next sample, whose law answers if they are aligned; both have their rates.
    """
    linear, n, z = ended[0], ended[0].n, Z[:, : 4 * ended[0].n]
    answering = following if linear.centre.cells.aligned else ended
    efforts, rates, jerks = [*_efforts(*answering, Z), _efforts(*ended, earlier)[-1]], [], []
    for loop, acting in (ended, following):
        by_effort, by_torque = loop.inputs
        for age in (linear.delay, linear.delay + linear.sample_period):
            by_torques = by_torque @ acting.torque_at(age)
            rates += [_largest(loop.A @ z + by_torques + by_effort @ effort) for effort in efforts]
            jerks.append(_largest(loop.A[:, loop.links] @ by_torques))
    rate = np.max(rates, axis=0)
    between, bulge = linear.between_samples(rate, np.max(jerks, axis=0))
    change = _largest(efforts[0] - efforts[1]) if linear.late else np.zeros(n)  # efforts[1]: the newest in transit
    effort = np.max([_largest(u) for u in efforts], axis=0)
    return Response(Z, _largest(z), between, rate[linear.links], bulge, effort, change, remaining)


def _efforts(linear: LinearLoop, errors: KnownErrors, Z: Array) -> list[Array]:
    """Return the efforts (c, n, k) of the law at Z and of those in transit, the oldest last."""
    n = linear.n
    answer = linear.law @ Z[:, : 4 * n] + errors.effort
    return [answer, *(Z[:, start : start + n] for start in range(4 * n, Z.shape[1], n))]


def _largest(columns: Array) -> Array:
    """Return the largest magnitudes (rows,) of the sums of columns (c, rows, k), all but the first with any sign."""
    return np.asarray(ROUNDING * np.abs(columns).sum(axis=2).max(axis=0))
