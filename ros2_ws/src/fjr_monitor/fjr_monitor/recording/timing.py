# SPDX-License-Identifier: Apache-2.0
"""Count the states and commands of a run and measure their period and latency."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fjr_monitor.recording.files import Times
from fjr_monitor.recording.signals import END

SHARES = (0.5, 0.99, 1.0)  # of the quantiles in Timing


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
    """Timing and counts of a run.

    periods (k - 1,), latencies [ns]: from state to state, and from state to command where there is one.
    """

    def __init__(self, stamp: Times, sent: Times, answered: Times, sample_period: float, lockstep: bool) -> None:
        """Take stamps and send times of states and the send times of their commands (k,) [ns]; -1: none.

        A command is in time if it is sent before the next state; that of the last state, before the next one is due.
        """
        known = answered >= 0
        self.periods, self.latencies = np.diff(sent), (answered - sent)[known]
        due = END if lockstep else sent[-1] + round(sample_period * 1e9)
        self._period, self._states, self._answered = sample_period, len(stamp), int(known.sum())
        self._in_time = int((known & (answered < np.append(sent[1:], due))).sum())
        steps = np.diff(stamp) * 1e-9
        self._gaps, self._longest = int((steps > 1.5 * sample_period).sum()), float(steps.max(initial=0.0))

    def timing(self) -> Timing:
        """Return the timing."""
        nothing = [np.nan] * len(SHARES)
        spreads = [np.quantile(each, SHARES) if len(each) else nothing for each in (self.periods, self.latencies)]
        return Timing(*(float(value) * 1e-3 for spread in spreads for value in spread))

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
