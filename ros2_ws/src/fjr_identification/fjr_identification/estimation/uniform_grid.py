# SPDX-License-Identifier: Apache-2.0
"""Put the samples of a record on a uniform grid of time: small jitter is interpolated, a jump is refused."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from fjr_core.errors import RecordError
from fjr_core.numerics.checks import Array

SHORTEST_PERIOD, LONGEST_PERIOD = 1e-5, 0.1  # s
MOST_MISSING, LONGEST_GAP = 0.01, 3  # share of all samples, and sample periods between two of them
LOST = 1.75  # sample periods; in a longer step a sample is missing, a shorter one is late
JITTER, LARGEST_JITTER = 0.02, 5.0  # sample periods; below it samples count as uniform, above it they have no period


@dataclass(frozen=True, eq=False)
class Uniform:
    """Signals on the grid 0, dt, 2 dt, ... of k samples; jitter, missing: what was interpolated.

    dt [s]. held (k, m): mean over each interval of signals that are held between samples. sampled (k, l): cubic
    interpolation of the others. jitter [s]: largest distance of a sample from the grid. missing: number of samples.
    """

    dt: float
    held: Array
    sampled: Array
    jitter: float
    missing: int

    @property
    def notes(self) -> tuple[str, ...]:
        """A sentence if anything was interpolated."""
        if self.missing == 0 and self.jitter <= JITTER * self.dt:
            return ()
        return (
            f"interpolated to {self.dt * 1e3:.6g} ms: samples are up to {self.jitter * 1e3:.2g} ms off this grid, "
            f"{self.missing} are missing",
        )


def uniform(name: str, t: Array, held: Array, sampled: Array) -> Uniform:
    """Return the signals on a uniform grid; t (k,) [s], held (k, m), sampled (k, l), columns of NaN stay NaN.

    Raises RecordError, which names the record, for times that run back, jump, or have no common period.
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
        return Uniform(dt, held, sampled, jitter, 0)
    grid = t[0] + dt * np.arange(index[-1] + 1)
    return Uniform(dt, _means(t, held, grid, dt), _interpolated(t, sampled, grid), jitter, missing)


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
            f"expected steps of {period * 1e3:.6g} ms (give the parts as records of their own)"
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


def _interpolated(t: Array, values: Array, grid: Array) -> Array:
    """Return the values at the grid (len(grid), l) by cubic splines; columns of NaN stay NaN."""
    found = np.full((len(grid), values.shape[1]), np.nan)
    known = np.isfinite(values).all(axis=0)
    if known.any():
        found[:, known] = CubicSpline(t, values[:, known])(grid)
    return found
