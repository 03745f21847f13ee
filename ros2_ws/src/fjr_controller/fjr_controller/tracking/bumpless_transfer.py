# SPDX-License-Identifier: Apache-2.0
"""How the effort comes in without a step: from a stop's effort at the start, from the last one sent after a break."""

from __future__ import annotations

from collections.abc import Callable

from fjr_core.numerics.checks import Array


def smoothstep(s: float) -> float:
    """3 s^2 - 2 s^3 between 0 and 1, constant outside: C^1 and monotone."""
    s = min(max(s, 0.0), 1.0)
    return s * s * (3.0 - 2.0 * s)


class Fade:
    """u = (1 - s) u_rest + s u_law (a ramp), or u = u_law + (1 - s) (u_last - u_law(0)) (a blend), s from 0 to 1.

    u_rest is the stop policy's effort where the ramp begins. In the blend the law's feedback acts in full from the
    first sample on; what is added is an external input omega of eq. (42), which fades.
    """

    def __init__(self) -> None:
        self.active = False
        self._ramp = False
        self._first: Array | None = None
        self._start, self._duration = 0, 0.0

    def ramp(self, stamp: int, duration: float) -> None:
        """From the stop policy's effort at the stamp [ns], for duration [s]; 0: at once."""
        self._begin(stamp, duration, ramp=True)

    def blend(self, stamp: int, duration: float) -> None:
        """From the last effort sent; 0: at once."""
        self._begin(stamp, duration, ramp=False)

    def stop(self) -> None:
        """Nothing fades any more."""
        self.active = False

    def apply(self, u: Array, last: Array, rest: Callable[[], Array], stamp: int) -> Array:
        """The effort for the law's u (n,) at the stamp; u itself at the end.

        last (n,): the last effort sent; rest gives the stop policy's (n,).
        """
        if not self.active:
            return u
        s = smoothstep((stamp - self._start) * 1e-9 / self._duration)
        self.active = s < 1.0
        if not self.active:
            return u
        if self._first is None:
            self._first = rest().copy() if self._ramp else last - u
        return (1.0 - s) * self._first + (s * u if self._ramp else u)

    def _begin(self, stamp: int, duration: float, ramp: bool) -> None:
        self.active = duration > 0.0
        self._start, self._duration, self._ramp, self._first = stamp, duration, ramp, None
