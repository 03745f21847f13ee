# SPDX-License-Identifier: Apache-2.0
"""Limits of the effort and of its rate, with the time spent in saturation."""

from __future__ import annotations

import numpy as np

from fjr_core.control.safety_settings import Settings
from fjr_core.numerics.checks import Array

from .events import WARN, Journal

SATURATED, RATE_LIMITED = "efforts saturated", "efforts rate limited"


class EffortLimits:
    """Saturate efforts at their limits, then limit their rate; report saturation to the journal.

    left (n,) [N m]: last effort that was sent, zero before the first. sent (n,) [N m]: the same within the present
    limits, from which the rate counts. saturated (n,): joints at their limit in the last sample. clipped, slowed: True
    if the effort limits, or the rate limits, changed the last effort.
    """

    def __init__(self, settings: Settings, journal: Journal) -> None:
        n = settings.n
        self._journal = journal
        self.sent, self.left = np.zeros(n), np.zeros(n)
        self.saturated, self.clipped, self.slowed = np.zeros(n, dtype=bool), False, False
        self._seconds, self._seconds_any = np.zeros(n), 0.0
        self._stamp: int | None = None
        self._dt = 0.0
        self._pair = np.zeros((2, n))  # |u| and |u - sent|
        self._most = np.zeros((2, n))  # upper limits of these
        self._above = np.zeros((2, n), dtype=bool)
        self.apply(settings)

    @property
    def seconds(self) -> dict[str, float]:
        """Return the time in saturation [s]: "in saturation" of any joint, "in saturation: <joint>" of each."""
        each = zip(self._joints, self._seconds, strict=True)
        return {
            "in saturation": self._seconds_any,
            **{f"in saturation: {joint}": float(seconds) for joint, seconds in each},
        }

    def apply(self, settings: Settings) -> None:
        """Replace the limits; the rate counts from the last effort within the new limits."""
        self._joints = settings.joints
        self._limit, rate = np.asarray(settings.effort), np.asarray(settings.effort_rate)
        limited = np.isfinite(rate)
        self._limited, self._rate_limited = bool(np.isfinite(self._limit).any()), bool(limited.any())
        self._rate, self._free = np.where(limited, rate, 0.0), np.where(limited, 0.0, np.inf)
        self._most[:] = self._limit, self._largest_step(self._dt)
        self._longest = round(settings.state_timeout * 1e9)
        self.clipped = self.clipped and self._limited
        self.slowed = self.slowed and self._rate_limited
        self.sent[...] = self.saturate(self.sent)

    def saturate(self, u: Array) -> Array:
        """Return the effort u (n,) [N m] within the effort limits; u itself if there are none."""
        return np.clip(u, -self._limit, self._limit) if self._limited else u

    def send(self, u: Array, stamp: int) -> Array:
        """Return the limited effort (n,) for the finite effort u (n,) [N m] of the sample at `stamp` [ns].

        Return u itself where no limit acts. The rate counts over the difference of the stamps, at most state_timeout;
        the first effort starts from zero.
        """
        dt = 0.0 if self._stamp is None else min(max(stamp - self._stamp, 0), self._longest) * 1e-9
        if self.clipped:
            self._seconds += dt * self.saturated
            self._seconds_any += dt
        if (self._limited or self._rate_limited) and self._exceeds(u, dt):
            u = self._limit_rate(self._saturate_joints(u))
        self._stamp = stamp
        self._keep(u)
        if not self.clipped:
            self._journal.episodes.discard(SATURATED)
        if self.clipped or self.slowed:
            self._report()
        return u

    def replace(self, u: Array) -> None:
        """Keep an effort that was sent without a sample: after a silence, or at the end."""
        self._keep(u)
        self.clipped = self.slowed = False

    def _exceeds(self, u: Array, dt: float) -> bool:
        """Return True if u exceeds a limit or is too far from the last effort, over dt [s]."""
        if dt != self._dt:
            self._dt, self._most[1] = dt, self._largest_step(dt)
        pair = self._pair
        np.copyto(pair[0], u)
        np.subtract(u, self.sent, out=pair[1])
        np.abs(pair, out=pair)
        np.greater(pair, self._most, out=self._above)
        if np.count_nonzero(self._above):
            return True
        self.clipped = self.slowed = False
        return False

    def _largest_step(self, dt: float) -> Array:
        """Return the largest change of each effort over dt [s]."""
        return self._rate * dt + self._free

    def _saturate_joints(self, u: Array) -> Array:
        np.copyto(self.saturated, self._above[0])
        self.clipped = bool(self.saturated.any())
        return self.saturate(u) if self.clipped else u

    def _limit_rate(self, u: Array) -> Array:
        step = self._most[1]
        self.slowed = bool((np.abs(u - self.sent) > step).any())
        return np.clip(u, self.sent - step, self.sent + step) if self.slowed else u

    def _keep(self, u: Array) -> None:
        np.copyto(self.sent, u)
        np.copyto(self.left, u)

    def _report(self) -> None:
        """Count saturated samples by joint and samples at the rate limit; log the beginning of a saturation."""
        if self.clipped:
            joints = [joint for joint, over in zip(self._joints, self.saturated, strict=True) if over]
            for joint in joints:
                self._journal.count(f"{SATURATED}: {joint}")
            sentence = f"the effort of {', '.join(joints)} is at its limit"
            self._journal.report_episode(WARN, SATURATED, sentence, joint=joints[0])
        if self.slowed:
            self._journal.count(RATE_LIMITED)
