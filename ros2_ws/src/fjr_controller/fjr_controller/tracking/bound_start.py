# SPDX-License-Identifier: Apache-2.0
"""The initial value of the bound V(t) <= V(0) exp(-2 beta t), which is reset whenever the law alone does not act."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class BoundStatus:
    """V(t) <= V0 exp(-2 beta (t - start)) [J] from the stamp `start` [ns] on; V [J] is the value at the stamp `now`."""

    start: int
    V0: float
    now: int
    V: float


class BoundStart:
    """Start a bound at the first sample for which the law alone acts, and keep it until reset()."""

    def __init__(self) -> None:
        self._start: int | None = None
        self._V0 = self._V = 0.0
        self._now = 0

    def update(self, stamp: int, V: float) -> None:
        """Take the storage V [J] of a sample at `stamp` [ns] whose effort is the law's own."""
        if self._start is None:
            self._start, self._V0 = stamp, V
        self._now, self._V = stamp, V

    def reset(self) -> None:
        """Discard the bound: the effort was not the law's own, or the law has changed."""
        self._start = None

    @property
    def certificate(self) -> BoundStatus | None:
        """Return the certificate, or None if there is no bound."""
        return None if self._start is None else BoundStatus(self._start, self._V0, self._now, self._V)
