# SPDX-License-Identifier: Apache-2.0
"""Attribute the growth of V and the tracking error to their causes, block by block.

    V(second state) - V(first) = [change of V in the model with the effort of the law held]
                           + saturation: effort sent - effort of the law   + delay, loss: effort acting - effort sent
                           + mismatch: mean residual of a block            + noise: residual that averages out

The tracking error of a cause is that of its disturbances, propagated through the linearised sampled loop:

    e_k+1 = (Phi + Gamma F) e_k + w_k        e = (q_l, q_m, dq_l, dq_m) less that of the undisturbed loop

w_k is the effect of the cause on the state in interval k: an effort that differs from that of the law, or the residual
of the model. The remainder of the measured tracking error is due to the loop itself: initial error and hold.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fjr_core.law.linearized import equilibria_at, feedback, plant_matrices
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array
from fjr_core.stability.linear_controller import momentum_matrix
from fjr_core.stability.linearization import held_maps
from fjr_monitor.diagnosis.delay_estimation import Acting, foreseen, unsure
from fjr_monitor.diagnosis.record import Innovations, blocks_of

from .thresholds import BLOCK, GAP, NOISE_DEVIATIONS, SAME_EFFORT

MISMATCH, SATURATION, LOSS = "model mismatch", "saturation", "loss"
CAUSES = (MISMATCH, SATURATION, "delay", LOSS)
CONTINUOUS = 1e-6  # relative difference of V between the end of an interval and the start of the next
EMPTY: Array = np.zeros((0, 0, 0))


@dataclass(frozen=True)
class StorageBudget:
    """Contributions to V over b blocks of intervals.

    causes (b, 4) [J]: contribution of each of CAUSES. hold (b,) [J]: growth of V in the ideal sampled loop, with the
    known latency, above the bound exp(-2 beta dt). slack (b,) [J]: decay of V below that bound. noise (b,) [J]: what
    measurement noise explains. missing (b,): commands that never acted. judged (b,): true if every effort is that of
    the law or at a limit.
    """

    causes: Array
    hold: Array
    slack: Array
    noise: Array
    missing: Array
    judged: NDArray[np.bool_]


def storage_budget(found: Innovations, acted: Acting, robot: Robot, beta: float, period: float) -> StorageBudget:
    """Return the contributions to V in the complete blocks of the intervals.

    beta [1/s]: guaranteed rate of V. period [s]: sample period.
    """
    other = found.sent - found.law
    saturation, unanswered = (_gain(found, other * mask[:, None], robot) for mask in (found.answered, ~found.answered))
    cut, late, lost = (_gain(found, part, robot) for part in (acted.cut, acted.late, acted.lost))
    residual = found.V1 - found.predicted - cut - late - lost
    ideal = found.predicted - saturation - unanswered
    usual = foreseen(found)
    within = _gain(found, usual, robot)
    excess = ideal + within - np.exp(-2 * beta * found.dt) * found.V0
    gap = found.dt > GAP * period
    lost = lost + unanswered + np.where(gap, np.maximum(excess, 0.0), 0.0)
    excess = np.where(gap, 0.0, excess)
    mismatch, uncertain = _persistent(found, acted, usual, robot)
    by_queue = np.where(_sums(queued(found).astype(float)) > 0, mismatch, 0.0)
    either = _gain(found, (found.older - found.sent) * unsure(found, period)[:, None], robot)
    causes = np.stack([mismatch - by_queue, _sums(saturation + cut), _sums(late) + by_queue, _sums(lost)], axis=1)
    return StorageBudget(
        causes=causes,
        hold=_sums(np.maximum(excess, 0.0)),
        slack=_sums(np.maximum(-excess, 0.0)),
        noise=np.abs(_sums(residual - within) - mismatch) + NOISE_DEVIATIONS * uncertain + np.abs(_sums(either)),
        missing=_sums(acted.missing.astype(float)),
        judged=_sums(foreign(found).astype(float)) == 0,
    )


def foreign(found: Innovations) -> NDArray[np.bool_]:
    """Return in which intervals (k,) the effort sent is neither that of the law nor at a limit."""
    same = SAME_EFFORT * (1.0 + np.abs(found.law).max(axis=1, initial=0.0)[:, None])
    return np.asarray(((np.abs(found.sent - found.law) > same) & ~found.limited).any(axis=1) & found.answered)


def queued(found: Innovations) -> NDArray[np.bool_]:
    """Return in which intervals (k,) it is unknown which effort acted: its command came a sample late, as few do."""
    late = found.latency >= 1.0
    return np.asarray(late & (2 * np.count_nonzero(late) < len(late)))


def state_change(found: Innovations, effort: Array, robot: Robot) -> Array:
    """Return the change of positions and velocities (k, 4n) by efforts (k, n) [N m] held over their intervals."""
    dv, n = effort @ _acceleration(robot) * found.dt[:, None], robot.n
    change = np.zeros((len(found), 4 * n))
    change[:, n : 2 * n] = dv * found.dt[:, None] / 2
    change[:, 3 * n :] = dv
    return change


def _gain(found: Innovations, effort: Array, robot: Robot) -> Array:
    """Return the change of V (k,) [J] by additional efforts (k, n) [N m] held over their intervals.

    They change dq_m by dv = M_m^-1 B_m effort dt and q_m by dv dt / 2; V is quadratic in dq_m with the matrix M_m.
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
    """Return (M_m^-1 B_m)' (n, n)."""
    return np.asarray(np.linalg.solve(robot.M_m, robot.B_m).T)


def _persistent(found: Innovations, acted: Acting, usual: Array, robot: Robot) -> tuple[Array, Array]:
    """Return the change of V (b,) by the mean residual of each block and its standard deviation (b,).

    The residual excludes the known deviations of the effort.
    """
    effort = acted.cut + acted.late + acted.lost + usual
    slope, errors = _sums(found.slope), blocks_of(found.error - state_change(found, effort, robot), BLOCK)
    gain: Array = (slope * errors.mean(axis=1)).sum(axis=1)
    deviation: Array = np.sqrt((slope**2 * errors.var(axis=1)).sum(axis=1) / BLOCK)
    return gain, deviation


def _sums(values: Array) -> Array:
    return np.asarray(blocks_of(values, BLOCK).sum(axis=1))


def rises(found: Innovations, lowest: float = np.inf, before: float = np.nan) -> Array:
    """Return V at the end of each interval and the lowest V before it (2, k) [J].

    An interval without the law's effort counts as V = 0; after it, and after a missing interval, the search for the
    lowest V starts again. lowest, before [J]: the lowest V before the first interval, and V at the end of the one
    before, infinite if the search starts again, NaN if not known.
    """
    found_lowest, other = np.zeros(len(found)), foreign(found)
    for k, (V0, V1) in enumerate(zip(found.V0.tolist(), found.V1.tolist(), strict=True)):
        lowest = V0 if abs(V0 - before) > CONTINUOUS * V0 else min(lowest, V0)
        found_lowest[k], before = lowest, np.inf if other[k] else V1
    return np.stack([np.where(other, 0.0, found.V1), found_lowest])


def highest(risen: Array) -> Array:
    """Return those of `rises` (2, k) that may be the largest ratio to the lowest V plus a floor, whatever the floor."""
    V, lowest = risen[:, np.lexsort((-risen[0], risen[1]))]
    kept = np.append(True, V[1:] > np.maximum.accumulate(V)[:-1]) if len(V) else np.zeros(0, dtype=bool)
    return np.stack([V[kept], lowest[kept]])


def growth(risen: Array, floor: float) -> float:
    """Return the largest ratio of V to the lowest V before it plus the floor [J]; risen (2, k) as from `rises`."""
    V, lowest = risen
    return float(np.max(V / (lowest + floor), initial=0.0))


class StorageGrowth:
    """V along the intervals of a record that come in order.

    highest (2, m) [J]: as of `highest`. thirds (2,) [J]: largest V in the first and in the last third of all intervals.
    figures: numbers of the diagnosis.
    """

    def __init__(self, total: int) -> None:
        """total: number of intervals that will come."""
        self._total, self._done, self._last = total, 0, (np.inf, np.nan)
        self.highest: Array = np.zeros((2, 0))
        self.thirds = np.zeros(2)
        self.figures = {"intervals": float(total), "effort age": 0.0, "gaps": 0.0, "unanswered": 0.0}
        self.figures |= {"largest V": -np.inf, "last V": np.nan}

    def add(self, found: Innovations, period: float) -> None:
        """Add the next intervals; period [s]: sample period."""
        if not len(found):
            return
        risen = rises(found, *self._last)
        self._last = float(risen[1, -1]), float(risen[0, -1]) or np.inf  # 0: not the effort of the law
        self.highest = highest(np.hstack([self.highest, risen]))
        third, places = max(1, self._total // 3), self._done + np.arange(len(found))
        for i, rows in enumerate((places < third, places >= self._total - third)):
            self.thirds[i] = np.maximum(self.thirds[i], found.V1[rows].max(initial=0.0))
        self._done += len(found)
        self.figures["gaps"] += float((found.dt > GAP * period).sum())
        self.figures["unanswered"] += float((~found.answered).sum())
        self.figures["largest V"] = float(np.maximum(self.figures["largest V"], found.V1.max()))
        self.figures["last V"] = float(found.V1[-1])


@dataclass(frozen=True)
class CauseErrors:
    """Tracking errors in b blocks, by cause.

    peaks (b, 4, n): largest |q_l - q_ld| [rad, m] due to each of CAUSES in a block. noise (b, n): part of that due to a
    model mismatch which white noise makes, as large as the residuals about their mean in a block. own (b, n): largest
    remaining error, due to the loop itself. measured (b, n): largest error.
    """

    peaks: Array
    noise: Array
    own: Array
    measured: Array


def closed_loop(law: TrackingLaw, configurations: Array, period: float) -> Array:
    """Return Phi + Gamma F (k, 4n, 4n) in positions and velocities at k configurations (k, n), held for period [s]."""
    equilibria = equilibria_at(law.robot, configurations)
    momenta = momentum_matrix(equilibria)
    A, B = plant_matrices(equilibria)
    F = feedback(equilibria, law.gains)
    Phi, Gamma = held_maps(A, B, period)
    return np.asarray(np.linalg.solve(momenta, (Phi + Gamma @ F) @ momenta))


class CausePropagation:
    """The state error e (4n, 5) due to each of CAUSES and to noise, propagated between intervals; zero at first.

    loops (m, 4n, 4n): closed loops at m configurations, spread evenly over `total` intervals; None: over those of each
    call.
    """

    def __init__(self, robot: Robot, loops: Array = EMPTY, total: int | None = None) -> None:
        self.loops = loops
        self._robot, self._total, self._done = robot, total, 0
        self._e = np.zeros((4 * robot.n, len(CAUSES) + 1))
        self._signs = np.random.default_rng(0)

    def errors(self, found: Innovations, acted: Acting, period: float) -> CauseErrors:
        """Return the errors due to the causes in the complete blocks of the next intervals."""
        count, n, loops = len(found) // BLOCK * BLOCK, self._robot.n, self.loops
        before, total = (0, count) if self._total is None else (self._done, self._total)
        w = disturbances(found, acted, self._robot, period)[:count]
        noise = w[:, :, 0] - np.repeat(blocks_of(w[:, :, 0], BLOCK).mean(axis=1), BLOCK, axis=0)
        noise *= self._signs.choice([-1.0, 1.0], (count, 1)) * np.sqrt(BLOCK / (BLOCK - 1))  # white, the same variance
        w = np.concatenate([w, noise[:, :, None]], axis=2)
        steps = np.maximum(1, np.round(found.dt / period)).astype(int)
        made = np.zeros((count, len(CAUSES) + 1, n))
        for k in range(count):
            loop = loops[(before + k) * len(loops) // total]
            for _ in range(steps[k]):
                self._e = loop @ self._e
            self._e = self._e + w[k]
            made[k] = self._e[:n].T
        self._done += count
        causes, measured = made[:, :-1], found.tracking[:count]
        values = causes, made[:, -1], measured - causes.sum(axis=1), measured
        peaks, noise, *rest = (np.abs(blocks_of(each, BLOCK)).max(axis=1) for each in values)
        return CauseErrors(peaks, np.minimum(noise, peaks[:, 0]), *rest)


def disturbances(found: Innovations, acted: Acting, robot: Robot, period: float) -> Array:
    """Return the change of the state (k, 4n, 4) due to each of CAUSES in each interval."""
    other, answered = found.sent - found.law, found.answered[:, None]
    saturation = other * (answered & ~foreign(found)[:, None]) + acted.cut
    samples = np.maximum(1.0, np.round(found.dt / period)) * (found.dt > GAP * period)
    share = np.divide(samples - 1, 2 * samples, out=np.zeros_like(samples), where=samples > 0)
    outdated = (found.law - np.vstack([found.law[1:], found.law[-1:]])) * share[:, None]  # mean over what a gap missed
    loss = acted.lost + other * ~answered + outdated
    mismatch = found.error - state_change(found, acted.cut + acted.late + acted.lost + foreseen(found), robot)
    cut, late, lost = (state_change(found, effort, robot) for effort in (saturation, acted.late, loss))
    by_queue = mismatch * queued(found)[:, None]
    known = unsure(found, period)[:, None] < 1.0  # else what acted is not, and the rest is the loop's own, as the hold
    return np.stack([(mismatch - by_queue) * known, cut, late + by_queue, lost], axis=2)
