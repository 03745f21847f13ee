# SPDX-License-Identifier: Apache-2.0
"""Enclose the derivatives of periodic sinusoidal references over intervals of time."""

from __future__ import annotations

import numpy as np

from fjr_core.errors import TrajectoryError
from fjr_core.motions.reference import Reference
from fjr_core.motions.sine import Sines, common_period
from fjr_core.numerics.checks import Array, kind_of
from fjr_core.numerics.intervals import Interval, cosine, sine, stack


def period_of(reference: Reference) -> float | None:
    """Return the period [s] of a sinusoidal reference; None if it is constant.

    Raises TrajectoryError for another reference, and for sines without a common period.
    """
    if not isinstance(reference, Sines):
        raise TrajectoryError(f"reference is {kind_of(reference)}; expected sines, whose derivatives are enclosed")
    amplitude, frequency, _ = reference.rows
    moving = frequency[amplitude != 0]
    if not np.any(moving):
        return None
    period = common_period(moving)
    if period is None:
        raise TrajectoryError(f"reference has the frequencies {np.unique(moving).tolist()}; expected a common period")
    return period


def sine_jets(reference: Sines, t: Interval, derivatives: int) -> Interval:
    """Return q_ld and its derivatives over intervals of time t (k,) [s]: (derivatives n, k), column by column."""
    return stack([jet for order in range(derivatives) for jet in _of_order(reference, t, order)])


def _of_order(reference: Sines, t: Interval, order: int) -> list[Interval]:
    """Return the derivative of this order of each joint over t."""
    found = []
    for amplitude, frequency, phase, offset in zip(*_columns(reference), strict=True):
        whole = Interval.exact(np.full_like(t.mid, offset if order == 0 else 0.0))
        for a, w, p in zip(amplitude, frequency, phase, strict=True):
            angle = t * Interval.exact(w) + Interval.exact(p)
            wave = cosine(angle) if order % 2 else sine(angle)
            whole = whole + wave * _factor(-a if order % 4 > 1 else a, w, order)
        found.append(whole)
    return found


def _factor(a: float, w: float, order: int) -> Interval:
    factor = Interval.exact(a)
    for _ in range(order):
        factor = factor * Interval.exact(w)
    return factor


def _columns(reference: Sines) -> tuple[Array, Array, Array, Array]:
    amplitude, frequency, phase = reference.rows
    return amplitude.T, frequency.T, phase.T, np.broadcast_to(np.asarray(reference.offset), (reference.n,))
