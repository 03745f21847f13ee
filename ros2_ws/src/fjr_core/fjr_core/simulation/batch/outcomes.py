# SPDX-License-Identifier: Apache-2.0
"""What came out of k runs: one row a run, numbers only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from ...numerics.checks import Array


@dataclass(frozen=True, eq=False)
class Outcomes:
    """k runs of n joints; errors are q_l - q_ld at the samples, efforts what was sent to the motors.

    stable (k,): all numbers finite and no error beyond ClosedLoop.lost to the end; lost_at (k,) [s]: when it was
    not any more, else inf.
    rms, peak (k, n) [rad]: of the errors from settle_after on. final (k, n) [rad]: mean of their magnitudes over the
    last second. settling (k,) [s]: from when on every error stays within ClosedLoop.band; inf: not at the end.
    effort_rms, effort_peak (k, n) [N m]: from the start. power (k,) [W]: mean of |u' dq_m|.
    Of a run that is not stable rms, peak, final and settling are inf; the others count until it was lost.
    """

    stable: NDArray[np.bool_]
    lost_at: Array
    rms: Array
    peak: Array
    final: Array
    settling: Array
    effort_rms: Array
    effort_peak: Array
    power: Array

    @classmethod
    def of(cls, rows: Array, n: int) -> Outcomes:
        """From rows (k, width(n)) as the engine writes them: the fields one after another."""
        ends = np.cumsum([0, *(n if name in PER_JOINT else 1 for name in FIELDS)])
        parts = {
            name: rows[:, start:end] if name in PER_JOINT else rows[:, start]
            for name, start, end in zip(FIELDS, ends, ends[1:], strict=False)
        }
        return cls(**{**parts, "stable": parts["stable"] != 0})

    @classmethod
    def joined(cls, parts: Sequence[Outcomes]) -> Outcomes:
        """The runs of several one after another."""
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in FIELDS))


FIELDS = tuple(field.name for field in fields(Outcomes))
PER_JOINT = ("rms", "peak", "final", "effort_rms", "effort_peak")


def width(n: int) -> int:
    """Length of a row for n joints."""
    return sum(n if name in PER_JOINT else 1 for name in FIELDS)
