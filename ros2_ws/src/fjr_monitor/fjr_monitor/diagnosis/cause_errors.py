# SPDX-License-Identifier: Apache-2.0
"""Compute the tracking error due to each cause, and grade a violation by it.

The disturbances of a cause are propagated through the linearised sampled loop:

    e_k+1 = (Phi + Gamma F) e_k + w_k        e = (q_l, q_m, dq_l, dq_m) less that of the undisturbed loop

w_k is the effect of the cause on the state in interval k: an effort that differs from that of the law, or the residual
of the model. The remainder of the measured tracking error is due to the loop itself: initial error and hold.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fjr_core.law.vdpbc.law import TrackingLaw
from fjr_core.law.vdpbc.linearized import feedback
from fjr_core.model.equilibrium import equilibria_at, plant_matrices
from fjr_core.model.robot import Robot
from fjr_core.monitoring.axes import Axes
from fjr_core.monitoring.thresholds import BLOCK, GAP, RELATIVE
from fjr_core.numerics.checks import Array
from fjr_core.stability.linear_controller import momentum_matrix
from fjr_core.stability.one_sample_map import SampledLoop
from fjr_monitor.diagnosis.delay_estimation import Acting
from fjr_monitor.diagnosis.record import Innovations, foreseen
from fjr_monitor.diagnosis.storage_budget import CAUSES, blocks_of, foreign, state_change

EMPTY: Array = np.zeros((0, 0, 0))


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


@dataclass(frozen=True)
class Grade:
    """Largest tracking error (n,) [rad, m] by cause; within: true if all are within the tolerance."""

    errors: dict[str, Array]
    within: bool


class Grading:
    """Largest error (n,) due to each cause in the judged blocks outside a transient, for blocks that come in parts.

    The loop's own error is bounded by an envelope that decays from block to block with the square root of the
    guaranteed factor of V. A block belongs to a transient if that envelope exceeds both the tolerance (n,) and the
    errors due to the causes; if all judged blocks do, all count. Within the tolerance: the errors due to the causes are
    at most the tolerance plus RELATIVE times the envelope.
    """

    def __init__(self, decay: float, tolerance: Array) -> None:
        """decay: guaranteed factor of V in a block."""
        self._decay, self._tolerance = np.sqrt(decay), tolerance
        self._envelope = np.zeros(len(tolerance))
        self._all, self._settled = (Grade({}, True) for _ in range(2))

    def add(self, made: CauseErrors, judged: NDArray[np.bool_]) -> None:
        """Add blocks; judged (b,): those that count."""
        total, own = made.peaks.sum(axis=1), made.own.copy()
        for value in own:  # the running maximum, multiplied by the decay from block to block
            np.maximum(value, self._decay * self._envelope, out=value)
            self._envelope = value
        settled = judged & ~((own > self._tolerance) & (own > total)).any(axis=1)
        within = (total <= self._tolerance + RELATIVE * own).all(axis=1)
        self._all, self._settled = (
            _larger(grade, made.peaks[rows], bool(within[rows].all()))
            for grade, rows in ((self._all, judged), (self._settled, settled))
        )

    def grade(self) -> Grade:
        """Return the grade of the blocks so far."""
        return self._settled if self._settled.errors else self._all


def _larger(grade: Grade, peaks: Array, within: bool) -> Grade:
    """Return the grade with more blocks (b, 4, n); unchanged without any."""
    if not len(peaks):
        return grade
    errors = dict(zip(CAUSES, peaks.max(axis=0), strict=True))
    larger = {cause: np.maximum(error, grade.errors.get(cause, error)) for cause, error in errors.items()}
    return Grade(larger, grade.within and within)


def detail(causes: Sequence[str], errors: dict[str, Array], axes: Axes) -> str:
    """Format causes with the error due to each: "delay makes 0.14 mrad at joint2, sampling"."""
    return ", ".join(f"{cause} makes {axes.largest(errors[cause])}" if cause in errors else cause for cause in causes)
