# SPDX-License-Identifier: Apache-2.0
"""A record cut into intervals between two states: what the model foretold for the second, and what was measured."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..numerics.checks import Array
from ..robot.robot import Robot
from .certificate import Balance
from .one_step_prediction import Prediction
from .record import Record
from .thresholds import LONGEST_GAP


@dataclass(frozen=True)
class Intervals:
    """k intervals of a record, in order.

    dt (k,) [s]. V0, V1, foretold (k,) [J]: the storage at the first and second state, and at the second by the model,
    the effort sent being held. sent, law (k, n) [N m]: that effort, and the law's at the first state. before, after
    (k, n) [N m]: what the motors gave at both states, nan where it was not measured. error (k, 4n): second state,
    positions and velocities, measured less foretold. slope (k, 4n): dV/d of these at the second state. answered (k,):
    whether the first state was. older (k, n) [N m]: the effort sent before. latency (k,): of the answer to the first
    state by the times these went, as a part of the interval, in which the older effort acted on; 0: not known.
    tracking (k, n) [rad]: q_l - q_ld at the second state.
    """

    dt: Array
    V0: Array
    V1: Array
    foretold: Array
    sent: Array
    law: Array
    before: Array
    after: Array
    error: Array
    slope: Array
    answered: NDArray[np.bool_]
    older: Array
    latency: Array
    tracking: Array

    def __len__(self) -> int:
        return len(self.dt)

    def rows(self, rows: slice | Array) -> Intervals:
        """Some of them."""
        return Intervals(*(getattr(self, name)[rows] for name in _NAMES))


_NAMES = tuple(f.name for f in fields(Intervals))


def intervals(record: Record, balance: Balance, prediction: Prediction) -> Intervals:
    """Those of a record in which everything was measured and no gap is longer than LONGEST_GAP sample periods."""
    series = balance.along(record.position, record.velocity, record.jets)
    sent, dt = held(record.u), np.diff(record.t)
    first = consecutive(record, np.isfinite(series.V))
    before = sent[np.maximum(first - 1, 0)]
    second, q, dq = first + 1, record.position, record.velocity
    q_next, dq_next = prediction.along(q[first], dq[first], sent[first], dt[first])
    foretold = balance.along(q_next, dq_next, record.jets[second]).V
    applied = np.full_like(record.u, np.nan) if record.u_applied is None else record.u_applied
    return Intervals(
        dt=dt[first],
        V0=series.V[first],
        V1=series.V[second],
        foretold=foretold,
        sent=sent[first],
        law=series.u_law[first],
        before=applied[first],
        after=applied[second],
        error=np.hstack([q[second] - q_next, dq[second] - dq_next]),
        slope=series.slope[second],
        answered=np.asarray(np.isfinite(record.u[first]).all(axis=1)),
        older=np.where(np.isfinite(before), before, sent[first]),
        latency=_latency(record)[first] / dt[first],
        tracking=q[second, : record.u.shape[1]] - record.jets[second, 0],
    )


def consecutive(record: Record, known: NDArray[np.bool_] | None = None) -> NDArray[np.intp]:
    """Return the rows whose state and whose next state were measured, without a gap, under a known effort.

    known (k,): further condition on each state. A gap is longer than LONGEST_GAP sample periods.
    """
    finite = np.isfinite(np.hstack([record.position, record.velocity])).all(axis=1)
    good = np.asarray(finite if known is None else finite & known)
    dt, answered = np.diff(record.t), np.asarray(np.isfinite(held(record.u)).all(axis=1))
    pairs = good[:-1] & good[1:] & answered[:-1]
    return np.flatnonzero(pairs & (dt > 0) & (dt < LONGEST_GAP * record.sample_period))


def _latency(record: Record) -> Array:
    """From each state to its answer (k,) [s] by the times these went, up to the next state; 0 where not known."""
    if record.sent is None or record.answered is None:
        return np.zeros(len(record.t))
    known = np.nan_to_num(np.asarray(record.answered) - np.asarray(record.sent))
    return np.asarray(np.clip(known, 0.0, record.sample_period))


def held(u: Array) -> Array:
    """Efforts (k, n) with the last one where none came (nan)."""
    came = np.isfinite(u).all(axis=1)
    last = np.maximum.accumulate(np.where(came, np.arange(len(u)), -1))
    return np.where((last >= 0)[:, None], u[np.maximum(last, 0)], np.nan)


def needed(intervals: Intervals, robot: Robot) -> Array:
    """Mean effort (k, n) [N m] that the motor equation needs in each interval, from the measured velocities.

    Less what is foreseen: a loop in real time that answers within the sample is as it should be.

    M_m ddq_m + K zeta + D_m dq_m = B_m u, integrated over the interval: the motors' generalised momenta against
    their prediction, as A. De Luca, R. Mattone, Actuator failure detection and isolation using generalized momenta,
    ICRA 2003.
    """
    residual: Array = intervals.error[:, 3 * robot.n :] @ _effort(robot) / intervals.dt[:, None]
    return intervals.sent + residual - foreseen(intervals)


def foreseen(intervals: Intervals) -> Array:
    """What acted beside the effort sent (k, n) [N m] by the times of sending alone: so long the older one acted on."""
    return np.asarray(intervals.latency[:, None] * (intervals.older - intervals.sent))


@lru_cache(maxsize=8)
def _effort(robot: Robot) -> Array:
    """(B_m^-1 M_m)' (n, n): what makes efforts of accelerations."""
    return np.asarray(np.linalg.solve(robot.B_m, robot.M_m).T)
