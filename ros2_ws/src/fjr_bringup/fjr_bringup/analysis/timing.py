# SPDX-License-Identifier: Apache-2.0
"""Count the states and commands of a run and measure their period and latency."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fjr_bringup.analysis.run_data import RunData
from fjr_bringup.recording.reader import Array


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

    nominal: int  # duration times rate
    published: int  # states recorded
    missing: int  # nominal - published (negative: more states than nominal)
    gaps: int  # steps between stamps longer than 1.5 sample periods
    longest_gap_s: float
    answered: int | None  # states with a recorded command; this and the next three null: no command was recorded
    answered_in_time: int | None  # command sent before the next state
    late: int | None  # command sent after the next state
    unanswered: int | None
    published_fraction: float  # of nominal
    answered_in_time_fraction: float | None  # of nominal
    lost_by_recorder: dict[str, int | None]  # topic -> gaps in the sequence numbers; null: several publishers


def timing(data: RunData) -> Timing:
    """Return the timing of a run."""
    latency = data.latency[~np.isnan(data.latency)]
    return Timing(*_percentiles(np.diff(data.sent)), *_percentiles(latency))


def counts(data: RunData, duration: float, lost_messages: dict[str, int | None]) -> Counts:
    """Return the sample counts of a run of `duration` [s]."""
    nominal, published = round(duration / data.sample_period), len(data.t)
    answered = ~np.isnan(data.answered)
    known, in_time = answered.any(), int((data.answered < data.deadline)[answered].sum())
    steps = np.diff(data.t, append=data.t[-1])
    return Counts(
        nominal=nominal,
        published=published,
        missing=nominal - published,
        gaps=int((steps > 1.5 * data.sample_period).sum()),
        longest_gap_s=float(steps.max()),
        answered=int(answered.sum()) if known else None,
        answered_in_time=in_time if known else None,
        late=int(answered.sum()) - in_time if known else None,
        unanswered=published - int(answered.sum()) if known else None,
        published_fraction=published / nominal,
        answered_in_time_fraction=in_time / nominal if known else None,
        lost_by_recorder=lost_messages,
    )


def _percentiles(seconds: Array) -> tuple[float, float, float]:
    """Return median, 99th percentile and maximum [us]."""
    values = seconds * 1e6 if seconds.size else np.array([np.nan])
    return float(np.percentile(values, 50)), float(np.percentile(values, 99)), float(values.max())
