# SPDX-License-Identifier: Apache-2.0
"""Find a tube of deviations that no admissible disturbance leaves: peak gains and a fixed point.

The deviation z is a sum of known lines and a rest. While the rest stays in a tube, the torques w_l, w_m and errors e
of the effort, by which the robot differs from the linear model of its cell, are bounded by `Spread`. Peak gains turn
these bounds into bounds of z. If the new bounds lie within the tube, no solution that starts in its known response
(steady, or with the decay of a start) leaves it: up to the first instant at which one did, it would be within the
bounds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fjr_core.numerics.checks import Array

from .sampled_deviation import LinearCells
from .steady_response import Response

MOST_ROUNDS = 500
DIVERGED = 50.0  # growth of the bounds at which the iteration ends
MARGIN = 1 + 1e-3  # of the disturbance that is verified over the fixed point of the iteration


@dataclass(frozen=True, eq=False)
class Spread:
    """Bounds over all cells, tube and factors of the differences from the linear model.

    unknown (4n,): torque errors d_l, d_m, accelerations (none) and defects of the law along the centre motion and the
    lines, beside the known ones. H (n, 4n), G (n, 4n), B (n, n), F (n, 4n): largest differences of the slopes from
    those of the model, elementwise. M (n, n): of M_i^-1 M_l(q_l) from the identity. All in the coordinates of the
    linear model.
    """

    unknown: Array
    H: Array
    M: Array
    G: Array
    B: Array
    F: Array


@dataclass(frozen=True, eq=False)
class Deviations:
    """Bounds in the coordinates of the linear model at all times.

    z (4n,): of what the lines leave of the deviation; effort (n,) and link acceleration (n,) of the whole deviation.
    """

    z: Array
    effort: Array
    acceleration: Array


def fixed_point(linear: LinearCells, gains: Array, spread: Spread, known: Response) -> Deviations | None:
    """Return bounds that reproduce themselves, or None if the iteration diverges.

    gains: of peak_gains. They are verified: the disturbance that follows from the returned bounds, with a margin, is at
    most that from which they were computed.
    """
    n = linear.n
    disturbance = spread.unknown
    most = DIVERGED * (float(known.z.max()) + float((gains[: 4 * n, : 4 * n] @ disturbance).max()))
    for _ in range(MOST_ROUNDS):
        assumed = MARGIN * disturbance
        found = _deviations(linear, gains, assumed, known)
        if not np.all(np.isfinite(found.z)) or found.z.max() > most:
            return None
        disturbance = _disturbance(found, spread)
        if np.all(disturbance <= assumed):
            return found
    return None


def _disturbance(found: Deviations, spread: Spread) -> Array:
    """Return the bounds (4n,) of torques, accelerations and effort errors within deviations."""
    links, motors = spread.H @ found.z, spread.G @ found.z + spread.B @ found.effort
    return spread.unknown + np.concatenate([links, motors, spread.M @ found.acceleration, spread.F @ found.z])


def _deviations(linear: LinearCells, gains: Array, disturbance: Array, known: Response) -> Deviations:
    """Return the bounds of deviations under disturbances; between samples a bound grows by its rate.

    Efforts and accelerations at the end of a cell are those of its own model or, if aligned, of the next.
    """
    n, S, half = linear.n, linear.models.loop.shape[1], linear.between
    at_samples = gains @ np.append(disturbance, known.remaining)
    slope_jump, law_jump = linear.jumps
    at_samples[S : S + n] += slope_jump[2 * n : 3 * n] @ at_samples[: 4 * n]
    at_samples[S + n :] += law_jump @ at_samples[: 4 * n]
    torque, error = disturbance[: 3 * n], disturbance[3 * n :]
    effort = at_samples[S + n :] + error
    slope = np.abs(linear.A).max(axis=0)
    by_effort, by_torque = (np.abs(each).max(axis=0) for each in linear.inputs)
    rate = linear.growth @ (slope @ at_samples[: 4 * n] + by_effort @ effort + by_torque @ torque)
    links = slice(2 * n, 3 * n)
    acceleration = at_samples[S : S + n] + (by_torque @ torque)[links] + half * slope[links] @ rate
    return Deviations(
        z=at_samples[: 4 * n] + half * rate + known.z + half * known.rate,
        effort=effort + known.effort,
        acceleration=acceleration + known.acceleration + half * slope[links] @ known.rate,
    )
