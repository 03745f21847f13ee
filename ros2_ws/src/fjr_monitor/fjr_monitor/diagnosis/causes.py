# SPDX-License-Identifier: Apache-2.0
"""Attribute the growth of V and the tracking error to their causes, block by block, and grade a violation by the error.

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
from fjr_core.stability.linearization import SampledLoop
from fjr_monitor.diagnosis.delay_estimation import Acting, foreseen
from fjr_monitor.diagnosis.record import Innovations

from . import thresholds
from .thresholds import AT_LIMIT, BLOCK, GAP, NOISE_DEVIATIONS, SAME_EFFORT, UNSURE, JointTolerances
from .verdict import MISMATCH, NO_DECAY, SAMPLING, SATURATION, Diagnosis, detail, explained, unknown, violated

CAUSES = (MISMATCH, SATURATION, "delay", "loss")
CONTINUOUS = 1e-6  # relative difference of V between the end of an interval and the start of the next
EMPTY: Array = np.zeros((0, 0, 0))


@dataclass(frozen=True)
class StorageBudget:
    """Contributions to V over b blocks of intervals.

    causes (b, 4) [J]: contribution of each of CAUSES. hold (b,) [J]: growth of V in the ideal sampled loop, with the
    known latency, above the bound exp(-2 beta dt). slack (b,) [J]: decay of V below that bound. noise (b,) [J]: what
    measurement noise explains. judged (b,): true if every effort is that of the law or at its limit.
    """

    causes: Array
    hold: Array
    slack: Array
    noise: Array
    judged: NDArray[np.bool_]


def storage_budget(
    found: Innovations, acted: Acting, robot: Robot, beta: float, period: float, limit: Array
) -> StorageBudget:
    """Return the contributions to V in the complete blocks of the intervals.

    beta [1/s]: guaranteed rate of V. period [s]: sample period. limit (n,) [N m]: effort limits.
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
    unsure = _gain(found, (found.older - found.sent) * (UNSURE * (found.latency > 0))[:, None], robot)
    causes = np.stack([mismatch, _sums(saturation + cut), _sums(late), _sums(lost)], axis=1)
    return StorageBudget(
        causes=causes,
        hold=_sums(np.maximum(excess, 0.0)),
        slack=_sums(np.maximum(-excess, 0.0)),
        noise=np.abs(_sums(residual - within) - mismatch) + NOISE_DEVIATIONS * uncertain + np.abs(_sums(unsure)),
        judged=_sums(foreign(found, limit).astype(float)) == 0,
    )


def foreign(found: Innovations, limit: Array) -> NDArray[np.bool_]:
    """Return in which intervals (k,) the effort sent is neither that of the law nor at its limit (n,) [N m]."""
    at_limit = np.abs(found.sent) >= AT_LIMIT * limit
    same = SAME_EFFORT * (1.0 + np.abs(found.law).max(axis=1, initial=0.0)[:, None])
    differs = np.abs(found.sent - found.law) > same
    return np.asarray((differs & ~at_limit).any(axis=1) & found.answered)


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
    slope, errors = _sums(found.slope), blocks_of(found.error - state_change(found, effort, robot))
    gain: Array = (slope * errors.mean(axis=1)).sum(axis=1)
    deviation: Array = np.sqrt((slope**2 * errors.var(axis=1)).sum(axis=1) / BLOCK)
    return gain, deviation


def blocks_of(values: Array) -> Array:
    """Return values (k, ...) as (b, BLOCK, ...) without an incomplete last block."""
    count = len(values) // BLOCK
    return values[: count * BLOCK].reshape(count, BLOCK, *values.shape[1:])


def _sums(values: Array) -> Array:
    sums: Array = blocks_of(values).sum(axis=1)
    return sums


def rises(found: Innovations, limit: Array, lowest: float = np.inf, before: float = np.nan) -> Array:
    """Return V at the end of each interval and the lowest V before it (2, k) [J].

    An interval without the law's effort counts as V = 0; after it, and after a missing interval, the search for the
    lowest V starts again. lowest, before [J]: the lowest V before the first interval, and V at the end of the one
    before, infinite if the search starts again, NaN if not known. limit (n,) [N m]: of the efforts.
    """
    found_lowest, other = np.zeros(len(found)), foreign(found, limit)
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

    def add(self, found: Innovations, period: float, limit: Array) -> None:
        """Add the next intervals; period [s]: sample period. limit (n,) [N m]: of the efforts."""
        if not len(found):
            return
        risen = rises(found, limit, *self._last)
        foreign_last = bool(foreign(found.rows(slice(-1, None)), limit)[0])
        self._last = (float(risen[1, -1]), np.inf if foreign_last else float(found.V1[-1]))
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

    peaks (b, 4, n): largest |q_l - q_ld| [rad, m] due to each of CAUSES in a block. own (b, n): largest remaining
    error, due to the loop itself.
    """

    peaks: Array
    own: Array


def closed_loop(law: TrackingLaw, configurations: Array, period: float) -> Array:
    """Return Phi + Gamma F (k, 4n, 4n) in positions and velocities at k configurations (k, n), held for period [s]."""
    equilibria = equilibria_at(law.robot, configurations)
    momenta = momentum_matrix(equilibria)
    A, B = plant_matrices(equilibria)
    F = feedback(equilibria, law.gains)
    Phi, Gamma = SampledLoop(configurations, A, B, F).held_map(period)
    return np.asarray(np.linalg.solve(momenta, (Phi + Gamma @ F) @ momenta))


class CausePropagation:
    """The state error e (4n, 4) due to each of CAUSES, propagated from interval to interval; zero at first.

    loops (m, 4n, 4n): closed loops at m configurations, spread evenly over `total` intervals; None: over those of each
    call.
    """

    def __init__(self, robot: Robot, loops: Array = EMPTY, total: int | None = None) -> None:
        self.loops = loops
        self._robot, self._total, self._done = robot, total, 0
        self._e = np.zeros((4 * robot.n, len(CAUSES)))

    def errors(self, found: Innovations, acted: Acting, period: float, limit: Array) -> CauseErrors:
        """Return the errors due to the causes in the complete blocks of the next intervals."""
        count, n, loops = len(found) // BLOCK * BLOCK, self._robot.n, self.loops
        before, total = (0, count) if self._total is None else (self._done, self._total)
        w = disturbances(found, acted, self._robot, period, limit)
        steps = np.maximum(1, np.round(found.dt / period)).astype(int)
        made = np.zeros((count, len(CAUSES), n))
        for k in range(count):
            loop = loops[(before + k) * len(loops) // total]
            for _ in range(steps[k]):
                self._e = loop @ self._e
            self._e = self._e + w[k]
            made[k] = self._e[:n].T
        self._done += count
        own = found.tracking[:count] - made.sum(axis=1)
        return CauseErrors(*(np.abs(blocks_of(values)).max(axis=1) for values in (made, own)))


def disturbances(found: Innovations, acted: Acting, robot: Robot, period: float, limit: Array) -> Array:
    """Return the change of the state (k, 4n, 4) due to each of CAUSES in each interval."""
    other, answered = found.sent - found.law, found.answered[:, None]
    saturation = other * (answered & ~foreign(found, limit)[:, None]) + acted.cut
    loss = acted.lost + other * ~answered + _outdated(found, period)
    mismatch = found.error - state_change(found, acted.cut + acted.late + acted.lost + foreseen(found), robot)
    efforts = (state_change(found, effort, robot) for effort in (saturation, acted.late, loss))
    return np.stack([mismatch, *efforts], axis=2)


def _outdated(found: Innovations, period: float) -> Array:
    """Return the mean difference (k, n) between the held effort and that of the law, had it been sampled in a gap."""
    law = np.vstack([found.law[1:], found.law[-1:]])
    samples = np.maximum(1.0, np.round(found.dt / period)) * (found.dt > GAP * period)
    share = np.divide(samples - 1, 2 * samples, out=np.zeros_like(samples), where=samples > 0)
    return np.asarray((found.law - law) * share[:, None])


class BlockStatistics:
    """The blocks of a loop that is stable at its sample period, counted."""

    def __init__(self, decay: float, axes: JointTolerances) -> None:
        """decay: guaranteed factor of V in a block."""
        self._decay, self._axes = decay, axes
        self._envelope = np.zeros(len(axes.tolerance))
        self._graded = np.zeros(2, dtype=bool)  # whether any block is judged; of these, any outside a transient
        self._within = np.ones(2, dtype=bool)
        self._errors = np.zeros((2, len(CAUSES), len(axes.tolerance)))
        self._blocks = self._counted = self._above = 0
        self._strongest = np.zeros(len(CAUSES), dtype=int)
        self._hold = self._slack = 0.0
        self._added: list[Array] = []

    def add(self, blocks: StorageBudget, made: CauseErrors) -> None:
        """Add blocks and the tracking errors by cause in them; only those with `judged` can be violated."""
        causes = np.maximum(blocks.causes[blocks.judged], 0.0)
        allowed = (blocks.slack + thresholds.PREDICTED * (blocks.hold + blocks.noise))[blocks.judged]
        above = ~(causes.sum(axis=1) <= allowed)
        self._blocks += len(blocks.judged)
        self._counted += len(above)
        self._above += int(above.sum())
        self._strongest += np.bincount(np.argmax(causes[above], axis=1), minlength=len(CAUSES))
        self._hold += float(blocks.hold.sum())
        self._slack += float(blocks.slack.sum())
        self._added.append(blocks.hold + blocks.noise)
        self._grade(made, blocks.judged)

    def _grade(self, made: CauseErrors, judged: NDArray[np.bool_]) -> None:
        """Keep the largest error (n,) due to each cause in the judged blocks, and in those outside a transient.

        The loop's own error is bounded by an envelope that decays from block to block with the square root of the
        guaranteed factor of V. A block belongs to a transient if that envelope exceeds both the tolerance (n,) and the
        errors due to the causes; if all judged blocks do, all count. Within the tolerance: the errors due to the causes
        are at most the tolerance plus RELATIVE times the envelope.
        """
        total, own, tolerance = made.peaks.sum(axis=1), made.own.copy(), self._axes.tolerance
        for value in own:  # the running maximum, multiplied by the decay from block to block
            np.maximum(value, np.sqrt(self._decay) * self._envelope, out=value)
            self._envelope = value
        settled = judged & ~((own > tolerance) & (own > total)).any(axis=1)
        within = (total <= tolerance + thresholds.RELATIVE * own).all(axis=1)
        for i, rows in enumerate((judged, settled)):
            self._graded[i] |= rows.any()
            self._within[i] &= within[rows].all()
            self._errors[i] = np.maximum(self._errors[i], made.peaks[rows].max(axis=0, initial=0.0))

    def floor(self, tolerated: float) -> float:
        """Return the storage [J] that hold, noise and the tolerated tracking error explain.

        tolerated [J]: storage of the tolerated error. The remainder is the level at which the decay in a block equals
        the lower quartile of what hold and noise add. The quartile keeps a diverging loop from raising its own floor.
        """
        if not self._blocks:
            return tolerated
        added = np.concatenate(self._added)
        explained = np.quantile(np.where(np.isfinite(added), added, np.finfo(float).max), 0.25)
        return tolerated + thresholds.PREDICTED * float(explained) / max(1 - self._decay, np.finfo(float).eps)

    def conclude(self, grown: float, figures: dict[str, float]) -> Diagnosis:
        """Diagnose the blocks; grown: growth of V over its lowest value and its floor. figures: further numbers."""
        share, strongest = self._above / max(1, self._counted), self._strongest / max(1, self._above)
        figures = {**figures, "blocks": float(self._counted), "violated share": share, "growth of V": grown}
        figures |= {f"violated by {cause}": float(strongest[i] * share) for i, cause in enumerate(CAUSES)}
        order = np.argsort(-strongest, kind="stable")
        causes = tuple(CAUSES[i] for i in order if strongest[i] >= thresholds.CAUSE_SHARE)
        if grown > thresholds.DIVERGED:  # the hold is the cause if it added more to V than the decay removed
            causes = causes or ((SAMPLING,) if self._hold > self._slack else ())
            return violated(f"V grew to {grown:.2g} times its floor", causes, figures)
        if self._blocks < thresholds.FEWEST:
            states = int(figures.get("intervals", self._blocks * BLOCK))
            fewest = thresholds.FEWEST * BLOCK
            return unknown(f"{states} consecutive states with a command; expected {fewest}", figures)
        if self._counted < max(thresholds.FEWEST, thresholds.JUDGED * self._blocks):
            return unknown("most efforts sent are not those of the law", figures)
        which = int(self._graded[1])
        errors = dict(zip(CAUSES, self._errors[which], strict=True)) if self._graded[which] else {}
        often = share >= thresholds.HIGH_SHARE or (share >= thresholds.SHARE and self._above >= thresholds.FEWEST)
        if grown > thresholds.EXCEEDED or often:
            size, why = detail(causes, errors, self._axes), explained(causes)
            if causes and self._within[which] and SATURATION not in causes:
                sentence = f"{size}, within the tolerance: {why}"
                return Diagnosis("degraded", causes, sentence, figures, errors, size)
            sentence = f"{NO_DECAY}: {why}" + (f"; {size}" if size else "")
            return Diagnosis("violated", causes, sentence, figures, errors, size)
        if share > thresholds.SHARE_OF_FEW:
            few = f"V exceeds its floor in {self._above} of {self._counted} blocks; expected more blocks"
            return unknown(few, figures)
        sentence = "V decays as guaranteed, down to the floor that hold and noise predict"
        return Diagnosis("holding", (), sentence, figures, errors)
