# SPDX-License-Identifier: Apache-2.0
"""A record of motion from which an arm is identified: samples put on a uniform grid of time, and behind a filter.

All signals of the filtered motion pass the same filter (A. Savitzky, M. Golay, Analytical Chemistry 36(8), 1964).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import resample_poly, savgol_filter

from fjr_core.errors import RecordError, StateError, prefixed
from fjr_core.model import springs
from fjr_core.numerics.checks import MOTOR, Array, positive
from fjr_core.numerics.one_line import joints as joints_of

from .elastic_arm import ElasticArm, packed
from .parameters import HARDENING

SHORTEST_PERIOD, LONGEST_PERIOD = 1e-5, 0.1  # s
MOST_MISSING, LONGEST_GAP = 0.01, 3  # share of all samples, and sample periods between two of them
LOST = 1.75  # sample periods; in a longer step a sample is missing, a shorter one is late
JITTER, LARGEST_JITTER = 0.02, 5.0  # sample periods; below it samples count as uniform, above it they have no period
SIGNALS = ("q_l", "q_m", "torque")
LEAST_MOTION = 1e-4  # rad or m, peak to peak; a joint that moves less stands still
WINDOW = 0.03  # s, of the filter
ORDER = 4  # of the polynomials of Savitzky and Golay's filter
BAND, MARGIN = 0.99, 4.0  # share of the power of velocities below a frequency, and the cutoff relative to it
CUTOFF = (8.0, 40.0)  # Hz; least and largest cutoff


@dataclass(frozen=True, eq=False)
class MotionRecord:
    """k samples of n joints, `dt` [s] apart, reflected to the joint side.

    u (k, n) [N m]: effort that the motors were given from each sample to the next. q_l, q_m (k, n) [rad or m]:
    positions of links and motors. torque (k, n) [N m]: spring torque from a sensor. What is not measured is a column of
    NaN. name: of the file, for messages. Raises StateError for wrong shapes, a number that is not finite in a column
    that is measured, and a joint without any position.
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
        for name in ("u", *SIGNALS):
            if np.shape(values := getattr(self, name)) != shape:
                raise StateError(f"{name} has shape {np.shape(values)}; expected {shape}")
            measured = np.isfinite(values).any(axis=0) | (name == "u")
            for k, j in np.argwhere(measured & ~np.isfinite(values))[:1]:
                wrong = f"{name} of {self.joints[j]} is {values[k, j]} at sample {k}"
                raise StateError(f"{wrong}; expected a finite number at every sample")
        for joint in np.array(self.joints)[~(self.measured("q_l") | self.measured("q_m"))][:1]:
            raise StateError(f"{joint} has neither link nor motor positions; expected {joint} or {joint}{MOTOR}")

    def measured(self, signal: str) -> NDArray[np.bool_]:
        """Return the joints (n,) of which a signal of SIGNALS is measured."""
        return np.asarray(np.isfinite(getattr(self, signal)[:1]).any(axis=0))

    @property
    def ranges(self) -> Array:
        """Return the range of the positions of each joint (n,), of the side that moves further."""
        return np.fmax(np.ptp(self.q_l, axis=0), np.ptp(self.q_m, axis=0))

    @cached_property
    def still(self) -> tuple[str, ...]:
        """Return the joints that stand still."""
        return tuple(joint for joint, moved in zip(self.joints, self.ranges, strict=True) if moved < LEAST_MOTION)

    @property
    def driven(self) -> list[int]:
        """Return the joints that move under an effort that changes."""
        return [j for j, joint in enumerate(self.joints) if joint not in self.still and np.ptp(self.u[:, j]) > 0]

    def both_sides(self, j: int) -> bool:
        """Return whether link and motor of joint j are measured."""
        return bool(self.measured("q_l")[j] and self.measured("q_m")[j])


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
    note = f"interpolated to {dt * 1e3:.6g} ms: samples are up to {jitter * 1e3:.2g} ms off it, {missing} are missing"
    at_grid, measured = np.full((len(grid), sampled.shape[1]), np.nan), np.isfinite(sampled).all(axis=0)
    if measured.any():
        at_grid[:, measured] = CubicSpline(t, sampled[:, measured])(grid)
    return dt, _means(t, held, grid, dt), at_grid, (note,)


def _checked_steps(name: str, t: Array) -> Array:
    """Return the steps (k - 1,) [s] of increasing, finite times with a plausible period."""
    if len(t) < 2:
        raise RecordError(f"{name} has {len(t)} samples; expected at least 2, each with a time of its own")
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
            f"{name}: {100 * share:.1f} % of the steps are longer than the usual {period * 1e3:.6g} ms; "
            f"expected at most {100 * MOST_MISSING:.0f} % (a period that changes, or lost samples)"
        )


def _means(t: Array, values: Array, grid: Array, dt: float) -> Array:
    """Return the means (len(grid), m) over [grid, grid + dt] of values that hold from each time to the next."""
    ends = np.append(t, grid[-1] + dt) if grid[-1] + dt > t[-1] else t
    widths = np.diff(ends)[:, None]
    area = np.vstack([np.zeros((1, values.shape[1])), np.cumsum(values[: len(widths)] * widths, axis=0)])
    at = np.append(grid, grid[-1] + dt)
    integral = np.column_stack([np.interp(at, ends, column) for column in area.T]) if area.size else area
    return np.asarray(np.diff(integral, axis=0) / dt)


def held_longer(u: Array, share: float) -> Array:
    """Return efforts (k, n) that, held for a sample, act as those at its begin that change after a share of it do.

    Those act earlier by (1 - share) / 2 samples, and a longer hold smooths more: exact to second order in its length.
    """
    spline, at = CubicSpline(np.arange(len(u)), u), np.arange(len(u)) + (1 - share) / 2
    return np.asarray(spline(at) - (1 - share**2) / 24 * spline(at, 2))


def record_of_samples(
    name: str, joints: tuple[str, ...], t: Array, signals: list[Array], held: float = np.inf, notes: Sequence[str] = ()
) -> tuple[MotionRecord, tuple[str, ...]]:
    """Return the record on a uniform grid that samples at t (k,) [s] make, and notes on what was substituted.

    signals: q_l, q_m, u, torque as in MotionRecord. held [s]: how long the controller holds an effort, if shorter than
    a sample. notes: on the samples. Raises RecordError.
    """
    q_l, q_m, u, torque = signals
    with prefixed(f"{name}: ", StateError, RecordError):
        MotionRecord(name, joints, 1.0, u, q_l, q_m, torque)  # refuses gaps, which a grid would hide
    dt, effort, sampled, on_grid = on_uniform_grid(name, t, u, np.hstack([q_l, q_m, torque]))
    if held * LOST < dt:
        effort = held_longer(effort, held / dt)
        on_grid += (f"efforts change each {held * 1e3:.6g} ms: interpolated between samples",)
    record = MotionRecord(name, joints, dt, effort, *np.hsplit(sampled, 3))
    return record, tuple(f"{name}: {note}" for note in (*notes, *on_grid))


@dataclass(frozen=True, eq=False)
class FilteredMotion:
    """Smoothed positions, velocities and accelerations of links and motors, and efforts, each (k, n).

    A side without encoders follows from the other one by the torque sensor, or by the rigid arm and the prior's K.
    rigid: torque of the rigid links.
    """

    dt: float
    q_l: Array
    v_l: Array
    a_l: Array
    q_m: Array
    v_m: Array
    a_m: Array
    u: Array
    rigid: Array

    @cached_property
    def stride(self) -> int:
        """Return the number of samples from one independent sample to the next, by the bandwidth of the motion."""
        power = np.abs(np.fft.rfft(np.nan_to_num(self.v_m), axis=0)) ** 2
        share = np.cumsum(power, axis=0) / np.maximum(np.sum(power, axis=0), 1e-300)
        highest = np.max(np.argmax(share >= BAND, axis=0)) / (len(self.v_m) * self.dt)
        cutoff = np.clip(MARGIN * highest, *CUTOFF)
        return max(1, int(0.4 / (cutoff * self.dt)))

    def state(self, sample: int) -> Array:
        """Return (q_l, q_m, v_l, v_m) (4n,) at a sample."""
        return np.concatenate([self.q_l[sample], self.q_m[sample], self.v_l[sample], self.v_m[sample]])


def filtered(record: MotionRecord, arm: ElasticArm, values: Mapping[str, Array]) -> FilteredMotion:
    """Return the filtered motion of a record; values: of all parameters, by name."""
    q_l, q_m = record.q_l.copy(), record.q_m.copy()
    no_link, no_motor = ~record.measured("q_l"), ~record.measured("q_m")
    q_l[:, no_link], q_m[:, no_motor] = q_m[:, no_link], q_l[:, no_motor]
    motion = (smoothed(q_l, record.dt, order).T for order in range(3))
    rigid = np.asarray(arm.link_torque(*motion, packed(arm, values))[0].full().T)
    torque = np.where(record.measured("torque"), record.torque, rigid)
    stiffness = zip(values["joint_stiffness"], values[HARDENING], torque.T, strict=True)
    zeta = [springs.root(K, cubic, tau, np) for K, cubic, tau in stiffness]
    deflection = smoothed(np.transpose(zeta) + values["offset"], record.dt)
    q_l[:, no_link] = (q_m - deflection)[:, no_link]
    q_m[:, no_motor] = (q_l + deflection)[:, no_motor]
    (q_l, v_l, a_l), (q_m, v_m, a_m) = ([smoothed(q, record.dt, order) for order in range(3)] for q in (q_l, q_m))
    return FilteredMotion(record.dt, q_l, v_l, a_l, q_m, v_m, a_m, smoothed(record.u, record.dt), rigid)


def smoothed(signal: Array, dt: float, order: int = 0) -> Array:
    """Return the derivative of this order of a signal (k, ...) behind the filter of all signals."""
    window = max(7, 2 * round(WINDOW / dt / 2) + 1)
    if len(signal) <= window:
        window = 7
    return np.asarray(savgol_filter(signal, window, ORDER, deriv=order, delta=dt, axis=0))


def shifted(signal: Array, dt: float, time: float) -> Array:
    """Return the signal (k,) `time` [s] later, by Lagrange's cubic through four samples; its ends are held."""
    first = int(np.floor(-time / dt))
    f, k = -time / dt - first, np.arange(first - 1, first - 1 + len(signal))
    weights = -f * (f - 1) * (f - 2) / 6, (f * f - 1) * (f - 2) / 2, -(f + 1) * f * (f - 2) / 2, (f**3 - f) / 6
    return np.asarray(sum(w * signal[np.clip(k + i, 0, len(signal) - 1)] for i, w in enumerate(weights)))


def decimated(signals: Array, stride: int) -> Array:
    """Return every `stride`-th sample of the signals (k, ...) behind a low-pass filter."""
    return np.asarray(resample_poly(signals, 1, stride)) if stride > 1 else signals


def inner(rows: Array, dt: float) -> Array:
    """Return the rows (k, ...) without those near the ends, which filters and shifts falsify."""
    edge = round(2 * WINDOW / dt) + 2
    return rows[edge:-edge] if len(rows) > 4 * edge else rows
