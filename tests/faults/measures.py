# SPDX-License-Identifier: Apache-2.0
"""Metrics of a motion under a fault, computed from the messages of the watcher only."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

THRESHOLD = 0.01  # rad; the arm has recovered when |q_tilde_l| stays below
SECOND = 10**9


@dataclass(frozen=True)
class Sine:
    """q_ld = offset + amplitude sin(frequency t + phase), each (n,)."""

    amplitude: np.ndarray
    frequency: np.ndarray
    offset: np.ndarray
    phase: np.ndarray

    def at(self, t: np.ndarray) -> np.ndarray:
        """Return q_ld (k, n) at the times t (k,) [s]."""
        return self.offset + self.amplitude * np.sin(np.outer(t, self.frequency) + self.phase)

    def holds(self, position: float, velocity: float) -> bool:
        """Return whether the first joint passes this position with this velocity."""
        radius = math.hypot(position - self.offset[0], velocity / self.frequency[0])
        return math.isclose(radius, self.amplitude[0], rel_tol=1e-9)

    def time(self, position: float, velocity: float) -> int:
        """Return the time in the first period at which the first joint passes there with this velocity [ns]."""
        w = self.frequency[0]
        phase = math.atan2((position - self.offset[0]) * w, velocity) - self.phase[0]
        return round(phase % (2 * math.pi) / w * SECOND)


@dataclass(frozen=True)
class Anchor:
    """From the stamp `begin` on, reference time is stamp - zero [ns]."""

    begin: int
    zero: int


@dataclass(frozen=True)
class Motion:
    """Stamps (k,) [ns] and link positions (k, n) [rad] sent by the plant, with the desired motion."""

    stamps: np.ndarray
    q_l: np.ndarray
    anchors: tuple[Anchor, ...]
    reference: Sine

    @property
    def error(self) -> np.ndarray:
        """Return max |q_l - q_ld| over the joints (k,) [rad]; nan before the first answered state."""
        zero = np.full(len(self.stamps), np.nan)
        for anchor in self.anchors:
            zero[self.stamps >= anchor.begin] = anchor.zero
        return np.abs(self.q_l - self.reference.at((self.stamps - zero) / SECOND)).max(axis=1)

    def peak(self, begin: int) -> float:
        """Return the largest error [rad] from the stamp `begin` on."""
        return float(np.max(self.error[self.stamps >= begin]))

    def recovery(self, end: int) -> float:
        """Return the seconds from the stamp `end` until the error stays below THRESHOLD; inf if it does not."""
        above = self.stamps[(self.stamps >= end) & ~(self.error < THRESHOLD)]
        if not len(above):
            return 0.0
        if above[-1] >= np.max(self.stamps) - SECOND // 10:
            return math.inf
        return float(above[-1] - end) / SECOND


def fits(effort: Sequence[float], limit: Sequence[float]) -> bool:
    """Return whether an effort (n,) is finite and within its limit (n,) [N m]."""
    return len(effort) == len(limit) and all(abs(u) <= bound for u, bound in zip(effort, limit, strict=True))
