# SPDX-License-Identifier: Apache-2.0
"""Rate of the topics that observers read: reference, tracking error, certificate."""

from __future__ import annotations


class AuxiliaryRate:
    """Decide by stamps which samples are published, on a grid of one period; auxiliary_due in C is the same."""

    def __init__(self, period: float) -> None:
        """period [s]: between two messages; 0: every sample."""
        self._period, self._next = round(period * 1e9), 0

    def due(self, stamp: int) -> bool:
        """Return True if the sample with this stamp [ns] is published; a jump of the stamps restarts the grid."""
        ahead = self._next - stamp
        if 0 < ahead <= self._period:
            return False
        self._next = self._next + self._period if -self._period < ahead <= 0 else stamp + self._period
        return True
