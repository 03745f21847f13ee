# SPDX-License-Identifier: Apache-2.0
"""A record of motion from which an arm is identified: samples as recorded, put on a uniform grid of time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from fjr_core.errors import RecordError, StateError
from fjr_core.numerics.checks import Array, positive
from fjr_core.numerics.one_line import joints as joints_of

SHORTEST_PERIOD, LONGEST_PERIOD = 1e-5, 0.1  # s
MOST_MISSING, LONGEST_GAP = 0.01, 3  # share of all samples, and sample periods between two of them
LOST = 1.75  # sample periods; in a longer step a sample is missing, a shorter one is late
JITTER, LARGEST_JITTER = 0.02, 5.0  # sample periods; below it samples count as uniform, above it they have no period
LARGEST = 2 * 10**7  # numbers of a record in memory
SIGNALS = ("q_l", "q_m", "torque")
LEAST_MOTION = 1e-4  # rad or m, peak to peak; a joint that moves less stands still


@dataclass(frozen=True, eq=False)
class MotionRecord:
    """k samples of n joints, `dt` [s] apart, reflected to the joint side.

    u (k, n) [N m]: effort that the motors were given from each sample to the next. q_l, q_m (k, n) [rad or m]:
    positions of links and motors, NaN: not measured (a joint without a link encoder has a column of NaN). torque (k, n)
    [N m]: spring torque from a sensor, NaN: none. name: of the file, for messages. Raises StateError for wrong shapes,
    an effort that is not finite and a joint without any measurement.
    """

    name: str
    joints: tuple[str, ...]
    dt: float
    u: Array
    q_l: Array
    q_m: Array
    torque: Array

    def __repr__(self) -> str:
        k, n = self.u.shape
        return f"MotionRecord({self.name!r}, {joints_of(n)}, {k} samples, dt={self.dt:.4g} s)"

    def __post_init__(self) -> None:
        positive("dt", self.dt, StateError)
        shape = np.shape(self.u)
        if len(shape) != 2 or shape[1] != len(self.joints):
            raise StateError(f"u has shape {shape}; expected (samples, {len(self.joints)})")
        for name in SIGNALS:
            if np.shape(getattr(self, name)) != shape:
                raise StateError(f"{name} has shape {np.shape(getattr(self, name))}; expected {shape}")
        if not np.all(np.isfinite(self.u)):
            raise StateError("u is not finite at some sample; expected an effort at each sample")
        for j, joint in enumerate(self.joints):
            if not any(np.any(np.isfinite(getattr(self, name)[:, j])) for name in ("q_l", "q_m")):
                raise StateError(f"{joint} has neither link nor motor positions; expected at least one of them")

    @property
    def ranges(self) -> Array:
        """Return the range of the positions of each joint (n,), of the side that moves further."""
        with np.errstate(all="ignore"):
            return np.nan_to_num(np.fmax(np.ptp(self.q_l, axis=0), np.ptp(self.q_m, axis=0)))

    @cached_property
    def still(self) -> tuple[str, ...]:
        """Return the joints that stand still."""
        return tuple(joint for joint, moved in zip(self.joints, self.ranges, strict=True) if moved < LEAST_MOTION)

    @property
    def driven(self) -> list[int]:
        """Return the joints that move under an effort that changes."""
        changes = np.ptp(self.u, axis=0) > 0
        return [j for j, joint in enumerate(self.joints) if joint not in self.still and changes[j]]

    def both_sides(self, j: int) -> bool:
        """Return whether link and motor of joint j are measured."""
        return bool(np.isfinite(self.q_l[:, j]).any() and np.isfinite(self.q_m[:, j]).any())


def on_uniform_grid(name: str, t: Array, held: Array, sampled: Array) -> tuple[float, Array, Array, tuple[str, ...]]:
    """Return signals on the grid 0, dt, 2 dt, ...: dt [s], held, sampled, and a sentence if anything was interpolated.

    t (k,) [s]. held (k, m): signals that are held between samples; their mean over each interval. sampled (k, l): the
    others, by cubic interpolation; columns of NaN stay NaN. Raises RecordError, which names the record, for times that
    run back, jump, or have no common period.
    """
    steps = _checked_steps(name, t)
    period = float(np.median(steps))
    counts = np.where(steps < LOST * period, 1, np.rint(steps / period)).astype(int)
    _check_gaps(name, t, counts, period)
    dt = float((t[-1] - t[0]) / counts.sum())
    index = np.concatenate([[0], np.cumsum(counts)])
    jitter = float(np.max(np.abs(t - t[0] - index * dt)))
    if jitter > LARGEST_JITTER * dt:
        raise RecordError(
            f"{name}: samples are up to {jitter:.3g} s off a grid of {dt * 1e3:.6g} ms; expected one sample period "
            "(it seems to change)"
        )
    missing = int((counts - 1).sum())
    if missing == 0 and jitter <= JITTER * dt:
        return dt, held, sampled, ()
    grid = t[0] + dt * np.arange(index[-1] + 1)
    off = f"samples are up to {jitter * 1e3:.2g} ms off this grid, {missing} are missing"
    note = f"interpolated to {dt * 1e3:.6g} ms: {off}"
    at_grid, measured = np.full((len(grid), sampled.shape[1]), np.nan), np.isfinite(sampled).all(axis=0)
    if measured.any():
        at_grid[:, measured] = CubicSpline(t, sampled[:, measured])(grid)
    return dt, _means(t, held, grid, dt), at_grid, (note,)


def _checked_steps(name: str, t: Array) -> Array:
    """Return the steps (k - 1,) [s] of increasing, finite times with a plausible period."""
    if len(t) < 2:
        raise RecordError(f"{name} has {len(t)} samples; expected at least 2")
    if not np.all(np.isfinite(t)):
        raise RecordError(f"{name}: the time of sample {int(np.argmin(np.isfinite(t)))} is not finite; expected s")
    steps = np.diff(t)
    if not np.all(steps > 0):
        i = int(np.argmax(~(steps > 0)))
        what = "stands still" if steps[i] == 0 else f"runs back by {-steps[i]:.6g} s"
        raise RecordError(f"{name}: time {what} at sample {i + 1} ({t[i]:.6g} s); expected times that increase")
    period = float(np.median(steps))
    if not SHORTEST_PERIOD <= period <= LONGEST_PERIOD:
        raise RecordError(
            f"{name}: samples are {period:.6g} s apart; expected {SHORTEST_PERIOD:g} to {LONGEST_PERIOD:g} s "
            "(is the unit of the time right?)"
        )
    return np.asarray(steps)


def _check_gaps(name: str, t: Array, counts: Array, period: float) -> None:
    """Raise RecordError for a jump and for too many missing samples."""
    if np.max(counts) > LONGEST_GAP:
        i = int(np.argmax(counts))
        raise RecordError(
            f"{name}: time jumps by {t[i + 1] - t[i]:.6g} s at sample {i + 1} ({t[i]:.6g} s); "
            f"expected steps of {period * 1e3:.6g} ms (give one part by start and duration, or the parts as records)"
        )
    share = float(np.mean(counts > 1))
    if share > MOST_MISSING:
        raise RecordError(
            f"{name}: {share:.1%} of the steps are longer than the usual {period * 1e3:.6g} ms; "
            f"expected at most {MOST_MISSING:.0%} (a period that changes, or lost samples)"
        )


def _means(t: Array, values: Array, grid: Array, dt: float) -> Array:
    """Return the means (len(grid), m) over [grid, grid + dt] of values that hold from each time to the next."""
    ends = np.append(t, grid[-1] + dt) if grid[-1] + dt > t[-1] else t
    widths = np.diff(ends)[:, None]
    area = np.vstack([np.zeros((1, values.shape[1])), np.cumsum(values[: len(widths)] * widths, axis=0)])
    at = np.append(grid, grid[-1] + dt)
    integral = np.column_stack([np.interp(at, ends, column) for column in area.T]) if area.size else area
    return np.asarray(np.diff(integral, axis=0) / dt)


@dataclass
class TimeWindow:
    """Part of a record: from `start` [s] after its first sample for `duration` [s]. ended: nothing more follows."""

    start: float = 0.0
    duration: float = np.inf
    ended: bool = field(default=False, init=False)
    _first: float | None = field(default=None, init=False)
    _count: int = field(default=0, init=False)

    @property
    def text(self) -> str:
        """Return the window for a message; empty if it is everything."""
        return "" if self.start == 0 and np.isinf(self.duration) else f" from {self.start:g} s for {self.duration:g} s"

    def of(self, t: Array, block: Array) -> Array:
        """Return the rows of a block with the times t [s] that are in the window; raise RecordError if too many are."""
        self._first = float(t[0]) if self._first is None and len(t) else self._first
        since = t - (self._first or 0.0)
        self.ended = bool(len(t) and since[-1] >= self.start + self.duration)
        rows = np.asarray(block[(since >= self.start) & (since < self.start + self.duration)])
        self._count += rows.size
        if self._count > LARGEST:
            raise RecordError(
                f"the record holds more than {LARGEST:,} numbers; expected fewer: choose a --start and a --duration"
            )
        return rows


def record_of_samples(
    name: str,
    joints: tuple[str, ...],
    t: Array,
    q_l: Array,
    q_m: Array,
    u: Array,
    torque: Array,
    notes: Sequence[str] = (),
) -> tuple[MotionRecord, tuple[str, ...]]:
    """Return the record on a uniform grid that samples at t (k,) [s] make, and notes on what was substituted.

    q_l, q_m, u, torque: as in MotionRecord. notes: on the samples. Raises RecordError.
    """
    dt, effort, sampled, on_grid = on_uniform_grid(name, t, u, np.hstack([q_l, q_m, torque]))
    record = MotionRecord(name, joints, dt, effort, *np.hsplit(sampled, 3))
    return record, tuple(f"{name}: {note}" for note in (*notes, *on_grid))
