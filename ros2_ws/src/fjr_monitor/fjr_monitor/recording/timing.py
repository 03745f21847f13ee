# SPDX-License-Identifier: Apache-2.0
"""Count the states and commands of a run and measure their period and latency."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fjr_core.numerics.checks import Array

NS = 1e9
MOST = 2**18
"""Different times that a distribution counts; with more its resolution is halved."""


class CountedTimes:
    """Times [ns], counted. They are exact up to MOST different ones, else to `resolution` [ns], a power of two."""

    def __init__(self) -> None:
        self.resolution = 1
        self.least, self.largest = np.inf, -np.inf
        self._values: NDArray[np.int64] = np.zeros(0, dtype=np.int64)
        self._counts: NDArray[np.int64] = np.zeros(0, dtype=np.int64)

    def add(self, times: NDArray[np.int64]) -> None:
        """Add times (k,) [ns]."""
        if not len(times):
            return
        self.least, self.largest = min(self.least, float(times.min())), max(self.largest, float(times.max()))
        more, counts = np.unique(times // self.resolution * self.resolution, return_counts=True)
        self._merge(np.concatenate([self._values, more]), np.concatenate([self._counts, counts]))
        while len(self._values) > MOST:
            self.resolution *= 2
            self._merge(self._values // self.resolution * self.resolution, self._counts)

    def _merge(self, values: NDArray[np.int64], counts: NDArray[np.int64]) -> None:
        self._values, places = np.unique(values, return_inverse=True)
        self._counts = np.bincount(places, weights=counts, minlength=len(self._values)).astype(np.int64)

    @property
    def count(self) -> int:
        """Return how many times were added."""
        return int(self._counts.sum())

    def quantile(self, share: float) -> float:
        """Return the time [ns] below which a share of the times lies, interpolated between two; NaN without any."""
        if not self.count:
            return float("nan")
        ends, place = np.cumsum(self._counts), share * (self.count - 1)
        low, high = self._values[np.searchsorted(ends, [int(place), int(np.ceil(place))], side="right")]
        return float(low + (place - int(place)) * (high - low))

    def histogram(self, edges: Array) -> Array:
        """Return how many times lie between edges (b + 1,) [ns]; what is below the first edge is in the first bin."""
        return np.histogram(np.maximum(self._values, edges[0]), bins=edges, weights=self._counts)[0]

    def above(self, times: Array) -> Array:
        """Return the share of the times above each of `times` (k,) [ns]."""
        ends = np.append(0, np.cumsum(self._counts))
        return np.asarray(1.0 - ends[np.searchsorted(self._values, times, side="right")] / max(1, self.count))


@dataclass(frozen=True)
class Timing:
    """Statistics of the middleware's send times: period of the states, latency from state to command."""

    period_p50_us: float
    period_p99_us: float
    period_max_us: float
    latency_p50_us: float
    latency_p99_us: float
    latency_max_us: float


@dataclass(frozen=True)
class Counts:
    """Sample counts: nominal = published + missing; published = answered + unanswered."""

    nominal: int  # duration times rate; one more if the first state was late, so that one more fits
    published: int  # states recorded
    missing: int  # nominal - published (negative: more states than nominal)
    gaps: int  # steps between stamps longer than 1.5 sample periods
    longest_gap_s: float
    answered: int | None  # states with a recorded command; this and the next three null: no command was recorded
    answered_in_time: int | None  # command sent before the next state
    late: int | None  # command sent after the next state
    unanswered: int | None
    published_fraction: float  # of nominal
    answered_in_time_fraction: float | None  # of published
    lost_by_recorder: dict[str, int | None]  # topic -> gaps in the sequence numbers; null: several publishers


class Clock:
    """Timing and counts of a run that comes in parts; periods from state to state, latencies from state to command."""

    def __init__(self, sample_period: float, lockstep: bool) -> None:
        self._period, self._lockstep = sample_period, lockstep
        self.periods, self.latencies = CountedTimes(), CountedTimes()
        self._states = self._answered = self._in_time = self._gaps = 0
        self._longest, self._last = 0.0, False

    def add(self, t: Array, sent: Array, answered: Array, begin: int = 0) -> None:
        """Add states: stamps and send times (k,) [s], those of commands (k,), NaN: none; the first `begin` were there.

        A command is in time if it is sent before the next state; that of the last state, before the next one is due.
        """
        before = max(0, begin - 1)
        steps = np.diff(t[before:])
        self.periods.add(_ns(np.diff(sent[before:])))
        self.latencies.add(_ns((answered - sent)[begin:][~np.isnan(answered[begin:])]))
        self._states += len(t) - begin
        self._answered += int((~np.isnan(answered[begin:])).sum())
        self._in_time += int((answered[before:-1] < sent[before + 1 :]).sum()) - self._last * (begin > 0)
        due = np.inf if self._lockstep else sent[-1] + self._period
        self._last = bool(answered[-1] < due)
        self._in_time += self._last
        self._gaps += int((steps > 1.5 * self._period).sum())
        self._longest = max(self._longest, float(steps.max(initial=0.0)))

    def timing(self) -> Timing:
        """Return the timing."""
        found = [
            (each.quantile(0.5), each.quantile(0.99), each.largest if each.count else np.nan)
            for each in (self.periods, self.latencies)
        ]
        return Timing(*(value * 1e-3 for values in found for value in values))

    def counts(self, duration: float, lost_messages: dict[str, int | None]) -> Counts:
        """Return the sample counts of a run of `duration` [s]."""
        nominal, answered, in_time = round(duration / self._period), self._answered, self._in_time
        nominal += self._states == nominal + 1  # times count from the first state: if that was late, the last is not
        known = answered > 0
        return Counts(
            nominal=nominal,
            published=self._states,
            missing=nominal - self._states,
            gaps=self._gaps,
            longest_gap_s=self._longest,
            answered=answered if known else None,
            answered_in_time=in_time if known else None,
            late=answered - in_time if known else None,
            unanswered=self._states - answered if known else None,
            published_fraction=self._states / nominal,
            answered_in_time_fraction=in_time / self._states if known else None,
            lost_by_recorder=lost_messages,
        )


def _ns(seconds: Array) -> NDArray[np.int64]:
    return np.asarray(np.rint(seconds * NS), dtype=np.int64)
