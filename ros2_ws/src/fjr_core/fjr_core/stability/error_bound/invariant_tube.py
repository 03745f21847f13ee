# SPDX-License-Identifier: Apache-2.0
"""Find a tube of deviations that no admissible disturbance leaves: peak gains and a fixed point.

With |z| <= tube the torques w_l, w_m and errors e of the effort, by which the robot differs from the linear model of
its cell, are bounded by `Spread`. Peak gains turn these bounds into bounds of z. If the new bounds lie within the tube,
no solution that starts at z = 0 leaves it: at the first instant at which one did, it would still be within the bounds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...numerics.checks import Array
from .peak_gains import response
from .reference_cells import Cells
from .sampled_deviation import LinearCells

MOST_ROUNDS = 500
DIVERGED = 50.0  # growth of the bounds at which the iteration ends
GROWING = 4  # repetitions of the bound of a rate between samples, which depends on itself
MARGIN = 1 + 1e-3  # of the disturbance that is verified over the fixed point of the iteration


@dataclass(frozen=True, eq=False)
class Spread:
    """Bounds over all cells, tube and factors of the differences from the linear model.

    torque (2n,): d_l, d_m along the reference with hold and delay. H (n, 4n), M (n, n), G (n, 4n), B (n, n), F (n, 4n):
    largest differences of the slopes from those of the model, elementwise.
    """

    torque: Array
    H: Array
    M: Array
    G: Array
    B: Array
    F: Array


@dataclass(frozen=True, eq=False)
class Deviations:
    """Bounds: z (4n,) at all times, torque (2n,) [N m] beside the known ones, effort v (n,), acceleration (n,)."""

    z: Array
    torque: Array
    effort: Array
    acceleration: Array


@dataclass(frozen=True, eq=False)
class Centre:
    """Largest magnitudes of the response to the known torques: z, its rate (4n,), link acceleration, effort (n,)."""

    z: Array
    rate: Array
    acceleration: Array
    effort: Array

    def none(self) -> Centre:
        """Return the response to no torque."""
        return Centre(*(np.zeros_like(value) for value in (self.z, self.rate, self.acceleration, self.effort)))


def centre_of(linear: LinearCells, cells: Cells, torque: Array, aging: Array) -> Centre:
    """Return the steady response to torques (c, 2n) [N m] in each cell, and to `aging` times the age of the effort."""
    n, T, steady = linear.n, linear.sample_period, response(linear.models, cells, torque, aging)
    z, by_effort, by_torque = steady[:, : 4 * n], *linear.inputs
    ends = [torque + age * aging for age in (linear.delay, linear.delay + T)]
    own = [_times(linear.A, z) + _times(by_torque, each) for each in ends]
    in_transit = [steady[:, start : start + n] for start in range(4 * n, steady.shape[1], n)]
    efforts = [_times(linear.F, z), *in_transit]
    rates = [each + _times(by_effort, effort) for each in own for effort in efforts]
    slope, half = np.abs(linear.A).max(axis=0), linear.between
    rate = steepest = _largest(*rates)
    for _ in range(GROWING):
        steepest = rate + half * slope @ steepest
    return Centre(_largest(z), MARGIN * steepest, _largest(*own)[2 * n : 3 * n], _largest(*efforts))


def _times(matrices: Array, vectors: Array) -> Array:
    return np.asarray(np.einsum("cij,cj->ci", matrices, vectors))


def _largest(*values: Array) -> Array:
    return np.asarray(np.abs(np.concatenate(values)).max(axis=0))


def fixed_point(linear: LinearCells, gains: Array, spread: Spread, centre: Centre) -> Deviations | None:
    """Return bounds that reproduce themselves, or None if the iteration diverges.

    gains: of peak_gains. They are verified: the disturbance that follows from the returned bounds, with a margin, is at
    most that from which they were computed.
    """
    n = linear.n
    disturbance = np.concatenate([spread.torque, np.zeros(n)])
    most = DIVERGED * (float(centre.rate.max()) + float((gains[: 4 * n] @ disturbance).max()))
    for _ in range(MOST_ROUNDS):
        assumed = MARGIN * disturbance
        found = _deviations(linear, gains, assumed, centre)
        if not np.all(np.isfinite(found.z)) or found.z.max() > most:
            return None
        disturbance = _disturbance(found, spread)
        if np.all(disturbance <= assumed):
            return found
    return None


def _disturbance(found: Deviations, spread: Spread) -> Array:
    """Return the bounds (3n,) of torques and effort errors within deviations."""
    links = spread.H @ found.z + spread.M @ found.acceleration
    motors = spread.G @ found.z + spread.B @ found.effort
    return np.concatenate([spread.torque + np.concatenate([links, motors]), spread.F @ found.z])


def _deviations(linear: LinearCells, gains: Array, disturbance: Array, centre: Centre) -> Deviations:
    """Return the bounds of deviations under disturbances; between samples a bound grows by its rate."""
    n, S, half = linear.n, linear.models.loop.shape[1], linear.between
    torque, error, at_samples = disturbance[: 2 * n], disturbance[2 * n :], gains @ disturbance
    effort = at_samples[S + n :] + error
    slope = np.abs(linear.A).max(axis=0)
    by_effort, by_torque = (np.abs(each).max(axis=0) for each in linear.inputs)
    rate = between = by_effort @ effort + by_torque @ torque
    for _ in range(GROWING):
        between = at_samples[: 4 * n] + half * rate
        rate = slope @ between + by_effort @ effort + by_torque @ torque
    rate = MARGIN * rate
    links = slice(2 * n, 3 * n)
    acceleration = at_samples[S : S + n] + (by_torque @ torque)[links] + half * slope[links] @ rate
    return Deviations(
        z=at_samples[: 4 * n] + half * rate + centre.z + half * centre.rate,
        torque=torque,
        effort=effort + centre.effort,
        acceleration=acceleration + centre.acceleration + half * slope[links] @ centre.rate,
    )
