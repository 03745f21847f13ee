# SPDX-License-Identifier: Apache-2.0
"""Who supplied the storage: what V gained in a block of intervals over the ideal sampled loop, by its cause.

V(second state) - V(first) = [what the law's own effort, held, makes of V in the model]
                           + saturation: effort sent - the law's   + delay, loss: effort that acted - effort sent
                           + mismatch: residual that persists      + noise: residual that averages out
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..numerics.checks import Array
from ..robot.robot import Robot
from .delay_estimation import Acting
from .innovations import Intervals, foreseen
from .thresholds import AT_LIMIT, BLOCK, GAP, SAME_EFFORT, SIGNIFICANT, UNSURE

CAUSES = ("model mismatch", "saturation", "delay", "loss")


@dataclass(frozen=True)
class Supplies:
    """b blocks: what was supplied to V by each of CAUSES (b, 4) [J], what is foretold and what is allowed.

    hold (b,): by the ideal sampled loop, its answers as late as the stamps say, beyond exp(-2 beta dt). slack (b,):
    what that loop lost beyond it. noise (b,). judged (b,): whether the effort was the law's, or at its limit,
    throughout. V (b,): at the end.
    """

    causes: Array
    hold: Array
    slack: Array
    noise: Array
    judged: NDArray[np.bool_]
    V: Array


def supplies(found: Intervals, acted: Acting, robot: Robot, beta: float, period: float, limit: Array) -> Supplies:
    """The supplies of the whole blocks of the intervals."""
    other = found.sent - found.law
    saturation, unanswered = (_gain(found, other * mask[:, None], robot) for mask in (found.answered, ~found.answered))
    cut, late, lost = (_gain(found, part, robot) for part in (acted.cut, acted.late, acted.lost))
    rest = found.V1 - found.foretold - cut - late - lost
    ideal = found.foretold - saturation - unanswered
    usual = foreseen(found)
    within = _gain(found, usual, robot)
    excess = ideal + within - np.exp(-2 * beta * found.dt) * found.V0
    gap = found.dt > GAP * period
    lost = lost + unanswered + np.where(gap, np.maximum(excess, 0.0), 0.0)
    excess = np.where(gap, 0.0, excess)
    mismatch, uncertain = _persistent(found, acted, usual, robot)
    unsure = _gain(found, (found.older - found.sent) * (UNSURE * (found.latency > 0))[:, None], robot)
    causes = np.stack([mismatch, _sums(saturation + cut), _sums(late), _sums(lost)], axis=1)
    return Supplies(
        causes=causes,
        hold=_sums(np.maximum(excess, 0.0)),
        slack=_sums(np.maximum(-excess, 0.0)),
        noise=np.abs(_sums(rest - within) - mismatch) + SIGNIFICANT * uncertain + np.abs(_sums(unsure)),
        judged=_sums(foreign(found, limit).astype(float)) == 0,
        V=blocks_of(found.V1)[:, -1],
    )


def foreign(found: Intervals, limit: Array) -> NDArray[np.bool_]:
    """Return in which intervals (k,) the effort sent is neither the law's nor at its limit (n,) [N m]."""
    at_limit = np.abs(found.sent) >= AT_LIMIT * limit
    same = SAME_EFFORT * (1.0 + np.abs(found.law).max(axis=1, initial=0.0)[:, None])
    differs = np.abs(found.sent - found.law) > same
    return np.asarray((differs & ~at_limit).any(axis=1) & found.answered)


def state_change(found: Intervals, effort: Array, robot: Robot) -> Array:
    """Return what efforts (k, n) [N m], each held for its interval, change in positions and velocities (k, 4n)."""
    dv, n = effort @ _acceleration(robot) * found.dt[:, None], robot.n
    change = np.zeros((len(found), 4 * n))
    change[:, n : 2 * n] = dv * found.dt[:, None] / 2
    change[:, 3 * n :] = dv
    return change


def _gain(found: Intervals, effort: Array, robot: Robot) -> Array:
    """What V gained (k,) [J] by efforts (k, n) [N m] beside the rest, held for each interval.

    They change dq_m by dv = M_m^-1 B_m effort dt, q_m by dv dt / 2; V is quadratic in dq_m with the matrix M_m.
    """
    if not np.count_nonzero(effort):
        return np.zeros(len(found))
    dv, n = effort @ _acceleration(robot) * found.dt[:, None], robot.n
    q, v = found.slope[:, n : 2 * n], found.slope[:, 3 * n :]
    linear = ((v + q * found.dt[:, None] / 2) * dv).sum(axis=1)
    gain: Array = linear - ((dv @ robot.M_m) * dv).sum(axis=1) / 2
    return gain


@lru_cache(maxsize=8)
def _acceleration(robot: Robot) -> Array:
    """(M_m^-1 B_m)' (n, n)."""
    return np.asarray(np.linalg.solve(robot.M_m, robot.B_m).T)


def _persistent(found: Intervals, acted: Acting, usual: Array, robot: Robot) -> tuple[Array, Array]:
    """What V gained (b,) by the mean residual of each block, without the effort that acted; its deviation (b,)."""
    effort = acted.cut + acted.late + acted.lost + usual
    slope, errors = _sums(found.slope), blocks_of(found.error - state_change(found, effort, robot))
    gain: Array = (slope * errors.mean(axis=1)).sum(axis=1)
    deviation: Array = np.sqrt((slope**2 * errors.var(axis=1)).sum(axis=1) / BLOCK)
    return gain, deviation


def blocks_of(values: Array) -> Array:
    """Return values (k, ...) as (b, BLOCK, ...), without the last ones that fill no block."""
    count = len(values) // BLOCK
    return values[: count * BLOCK].reshape(count, BLOCK, *values.shape[1:])


def _sums(values: Array) -> Array:
    sums: Array = blocks_of(values).sum(axis=1)
    return sums
