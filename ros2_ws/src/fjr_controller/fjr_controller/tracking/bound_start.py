# SPDX-License-Identifier: Apache-2.0
"""From when on the law's bound on the storage counts."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Certificate:
    """V(t) <= V0 exp(-2 beta (t - start)) [J] counts from `start` [ns of the stamps]; V belongs to the stamp `now`."""

    start: int
    V0: float
    now: int
    V: float


class Watch:
    """Begins a certificate at the first sample that the law alone answers, and keeps it until void()."""

    def __init__(self) -> None:
        self._start: int | None = None
        self._V0 = self._V = 0.0
        self._now = 0

    def see(self, stamp: int, V: float) -> None:
        """The law's own effort left for this stamp [ns], with storage V [J]."""
        if self._start is None:
            self._start, self._V0 = stamp, V
        self._now, self._V = stamp, V

    def void(self) -> None:
        """The effort was not the law's, or the law is another one: the bound must begin anew."""
        self._start = None

    @property
    def certificate(self) -> Certificate | None:
        """The certificate, None while there is none."""
        return None if self._start is None else Certificate(self._start, self._V0, self._now, self._V)
