# SPDX-License-Identifier: Apache-2.0
"""Bumpless transfer of the effort: from the stop policy's effort at the start, from the last one sent in a recovery."""

from __future__ import annotations

from collections.abc import Callable

from fjr_core.numerics.checks import Array


def smoothstep(s: float) -> float:
    """Return 3 s^2 - 2 s^3 for s within 0 to 1, constant outside: C^1 and monotone."""
    s = min(max(s, 0.0), 1.0)
    return s * s * (3.0 - 2.0 * s)


class BumplessTransfer:
    """Blend efforts with the smoothstep s(t) from 0 to 1.

    ramp:  u = (1 - s) u_stop + s u_law, with the stop policy's effort u_stop at the beginning of the ramp
    blend: u = u_law + (1 - s) (u_last - u_law(0)), with the last effort sent u_last

    A blend keeps the full feedback from the first sample on: what it adds is an external input omega of eq. (42).
    """

    def __init__(self) -> None:
        self.active = False
        self._ramp = False
        self._initial: Array | None = None
        self._start, self._duration = 0, 0.0

    def begin(self, stamp: int, duration: float, *, ramp: bool) -> None:
        """Begin a ramp, or else a blend, at the stamp [ns] for duration [s]; 0: none."""
        self.active = duration > 0.0
        self._start, self._duration, self._ramp, self._initial = stamp, duration, ramp, None

    def stop(self) -> None:
        """End the transfer."""
        self.active = False

    def apply(self, u: Array, last: Array, stop_effort: Callable[[], Array], stamp: int) -> Array:
        """Return the effort (n,) for the law's u (n,) at the stamp [ns]; u itself once the transfer has ended.

        last (n,): last effort sent. stop_effort: returns the stop policy's effort (n,).
        """
        if not self.active:
            return u
        s = smoothstep((stamp - self._start) * 1e-9 / self._duration)
        self.active = s < 1.0
        if not self.active:
            return u
        if self._initial is None:
            self._initial = stop_effort().copy() if self._ramp else last - u
        return (1.0 - s) * self._initial + (s * u if self._ramp else u)
