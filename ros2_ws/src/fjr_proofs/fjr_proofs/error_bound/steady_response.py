# SPDX-License-Identifier: Apache-2.0
"""Steady response of the linear loop about a centre motion to what is known of torque and effort errors.

What a robot differs from the centre motion in is, to first order, known up to the factors f, which are constant: the
age of the acting effort, the defect of the law, and the torque errors' derivatives with respect to f. The response to
each is computed over a period. It is not bounded, so that it keeps its signs and its course in time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fjr_core.numerics.checks import Array

from .modal_coordinates import Coordinates
from .peak_gains import ROUNDING
from .reference_cells import Cells
from .sampled_deviation import LinearCells


@dataclass(frozen=True, eq=False)
class Drive:
    """Known torques and efforts in each of c cells: the first of k columns, and the others times -1 to 1.

    torque (c, 2n, k) [N m], effort (c, n, k) [N m]; aging (c, 2n) [N m/s] times the age of the acting effort in the
    first column.
    """

    torque: Array
    aging: Array
    effort: Array

    def in_coordinates(self, coordinates: Coordinates) -> Drive:
        """Return the drive in coordinates of torques and efforts."""
        torques = coordinates.torques
        return Drive(torques @ self.torque, self.aging @ torques.T, coordinates.effort @ self.effort)

    def beside(self, other: Drive) -> Drive:
        """Return the drive with the further columns of another one, whose first is zero."""
        torque = np.concatenate([self.torque, other.torque[:, :, 1:]], axis=2)
        return Drive(torque, self.aging, np.concatenate([self.effort, other.effort[:, :, 1:]], axis=2))

    def shifted(self, cells: int) -> Drive:
        """Return the drive of the cells a number of cells before."""
        return Drive(*(np.roll(each, cells, axis=0) for each in (self.torque, self.aging, self.effort)))

    def at_age(self, age: float) -> Array:
        """Return the torques (c, 2n, k) at an age [s] of the effort."""
        return _added_first(self.torque, age * self.aging)


@dataclass(frozen=True, eq=False)
class Response:
    """Response Z (c, S, k) at the end of each cell, and largest magnitudes over all cells and all columns together.

    z, rate (4n,): deviation and its rate. acceleration, effort (n,). remaining (S,): of Z before the sums of the gains.
    """

    Z: Array
    z: Array
    rate: Array
    acceleration: Array
    effort: Array
    remaining: Array

    def __add__(self, other: Response) -> Response:
        """Return the sum of the largest magnitudes; Z stays."""
        names = ("z", "rate", "acceleration", "effort", "remaining")
        return Response(self.Z, *(getattr(self, name) + getattr(other, name) for name in names))


def steady_response(linear: LinearCells, cells: Cells, drive: Drive, blocks: int = 0) -> Response:
    """Return the steady response to a drive in each cell; from rest if the reference is not periodic.

    blocks: cells of the sums of the gains. A chain that is longer than them ends `slips` cells beside the one in which
    it is, where the samples do not divide the period.
    """
    models, drive = linear.models, drive.in_coordinates(linear.coordinates)
    force = models.effort @ drive.effort
    force[:, : 4 * linear.n] += linear.forced(drive.torque, drive.aging)
    before_last = _over_samples(models.loop, force, cells.samples - 1)
    step, pushed = models.loop @ before_last[0], models.loop @ before_last[1] + force
    Z, ends, earlier = np.zeros(force.shape[1:]), np.zeros(force.shape), np.zeros(force.shape)
    if cells.periodic:
        whole: Array = np.eye(len(Z))
        for A, b in zip(step, pushed, strict=True):
            whole, Z = np.asarray(A @ whole), A @ Z + b
        Z = np.asarray(np.linalg.solve(np.eye(len(Z)) - whole, Z))
    for i in range(cells.count):
        earlier[i] = before_last[0][i] @ Z + before_last[1][i]
        ends[i] = Z = step[i] @ Z + pushed[i]
    drift = cells.drift if cells.verified else 0.0
    slips = np.ceil(blocks * drift / cells.length) + 1 if drift else 0.0
    return _magnitudes(linear, ends, earlier, drive, slips * _largest(ends - np.roll(ends, 1, axis=0)))


def _over_samples(loop: Array, force: Array, samples: int) -> tuple[Array, Array]:
    """Return the maps over a number of samples and their inputs from those of one sample."""
    step, pushed = np.zeros_like(loop) + np.eye(loop.shape[1]), np.zeros_like(force)
    for _ in range(samples):
        step, pushed = loop @ step, loop @ pushed + force
    return step, pushed


def transient(linear: LinearCells, cells: Cells, Z: Array, blocks: int) -> Response:
    """Return the decay of Z (S, k) at time 0 over a number of cells."""
    at = np.repeat(np.arange(blocks) % cells.count, cells.samples)
    ended = np.roll(at, 1) if cells.aligned else at
    course = np.empty((len(at), *Z.shape))
    for k, i in enumerate(at):
        course[k] = Z
        Z = linear.models.loop[i] @ Z
    n, columns = linear.n, Z.shape[1]
    quiet = Drive(np.zeros((len(at), 2 * n, columns)), np.zeros((len(at), 2 * n)), np.zeros((len(at), n, columns)))
    return _magnitudes(linear.at(ended), course, np.roll(course, 1, axis=0), quiet, _largest(course))


def _magnitudes(linear: LinearCells, Z: Array, earlier: Array, drive: Drive, remaining: Array) -> Response:
    """Return the response at the end of cells with its largest magnitudes.

    earlier: Z one sample before; the last of its efforts acts until the sample, the torque is that of either end of it.
    If aligned, the next cell follows: its law answers, and both have their rates.
    """
    n, T, z = linear.n, linear.sample_period, Z[:, : 4 * linear.n]
    following, driven = (linear.shifted(-1), drive.shifted(-1)) if linear.aligned else (linear, drive)
    efforts = [*_efforts(following, Z, driven), _efforts(linear, earlier, drive)[-1]]
    rates, accelerations = [], []
    for cells, acting in ((linear, drive), (following, driven)):
        by_effort, by_torque = cells.inputs
        for age in (linear.delay, linear.delay + T):
            own = cells.A @ z + by_torque[:, :, : 2 * n] @ acting.at_age(age)
            rates += [_largest(own + by_effort @ effort) for effort in efforts]
            accelerations.append(_largest(own[:, 2 * n : 3 * n]))
    effort = np.max([_largest(each) for each in efforts], axis=0)
    rate, acceleration = np.max(rates, axis=0), np.max(accelerations, axis=0)
    return Response(Z, _largest(z), linear.growth @ rate, acceleration, effort, remaining)


def _efforts(linear: LinearCells, Z: Array, drive: Drive) -> list[Array]:
    """Return the efforts (c, n, k) of the law at Z and of those in transit, the oldest last."""
    n = linear.n
    own = linear.law @ Z[:, : 4 * n] + drive.effort
    return [own, *(Z[:, start : start + n] for start in range(4 * n, Z.shape[1], n))]


def _largest(columns: Array) -> Array:
    """Return the largest magnitudes (rows,) of the sums of columns (c, rows, k), all but the first with any sign."""
    return np.asarray(ROUNDING * np.abs(columns).sum(axis=2).max(axis=0))


def _added_first(columns: Array, values: Array) -> Array:
    """Return columns (c, rows, k) with values (c, rows) added to the first."""
    result = columns.copy()
    result[:, :, 0] += values
    return result
