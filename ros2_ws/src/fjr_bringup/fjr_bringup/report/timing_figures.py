# SPDX-License-Identifier: Apache-2.0
"""How the loop kept time, in plots."""

from __future__ import annotations

import numpy as np

from fjr_bringup.analysis.metrics import Report
from fjr_bringup.analysis.run_data import TrackingData
from fjr_bringup.formatting import milliseconds, percent, plural
from fjr_bringup.recording.reader import Array
from fjr_bringup.report.figure import Line, Plot

BINS = 60
HALF = 0.5  # a state: where a log axis has its empty bins
SMALLEST = 1e-3  # ms


def period(data: TrackingData, report: Report) -> Plot:
    """How regularly the states were sent."""
    timing, counts = report.timing, report.counts
    title = f"{counts.published} of {counts.nominal} states published"
    caption = _percentiles(timing.period_p50_us, timing.period_p99_us, timing.period_max_us)
    return _histogram("period", title, caption, np.diff(data.sent) * 1e3, "time between states [ms]", "c1")


def latency(data: TrackingData, report: Report) -> Plot:
    """How soon each state was answered."""
    timing, counts = report.timing, report.counts
    title = f"{percent(counts.answered_in_time_fraction)} answered before the next state"
    caption = _percentiles(timing.latency_p50_us, timing.latency_p99_us, timing.latency_max_us)
    return _histogram("latency", title, caption, data.latency * 1e3, "state to command [ms]", "c3")


def timeline(data: TrackingData, report: Report) -> Plot:
    """When states came late or were answered late."""
    counts, since = report.counts, np.diff(data.sent, prepend=np.nan) * 1e3
    lines = [
        Line("since the last state", since, "c1", 1.0),
        Line("to its command", data.latency * 1e3, "c3", 1.0),
        Line("sample period", np.full(len(data.t), data.sample_period * 1e3), "grey", 1.0, (6, 4)),
    ]
    late = "" if counts.late is None else f", {plural(counts.late, 'late answer')}, {counts.unanswered} without"
    caption = "Time from state to state and from state to command, as the middleware stamped them when they were sent."
    title = plural(counts.gaps, "gap") + late
    return Plot("timeline", title, caption, data.t, lines, y_label="[ms]", y_log=True, wide=True)


def _percentiles(p50: float, p99: float, largest: float) -> str:
    return f"50 %: {milliseconds(p50)}, 99 %: {milliseconds(p99)}, largest: {milliseconds(largest)}."


def _histogram(name: str, title: str, caption: str, values: Array, label: str, shade: str) -> Plot:
    """Both axes logarithmic, from the smallest to the largest value: nothing is cut off."""
    edges, heights = bins(values[np.isfinite(values)])
    line = Line("states", heights, shade, 1.2, step=True, fill=True)
    axes = {"x_label": label, "y_label": "states", "x_log": True, "y_log": True, "time": False}
    return Plot(name, title, caption, edges, [line], y_range=(HALF, None), **axes)  # type: ignore[arg-type]


def bins(values: Array) -> tuple[Array, Array]:
    """Edges (BINS + 1,) [ms] and the number from each edge to the next, HALF where there is none."""
    if not values.size:
        return np.array([SMALLEST, 1.0]), np.full(2, np.nan)
    low = max(float(values.min()), SMALLEST)
    high = max(float(values.max()) * 1.01, 1.2 * low)
    edges = np.asarray(np.geomspace(min(low, high / 2) / 1.01, high, BINS + 1), dtype=np.float64)
    counted, _ = np.histogram(np.maximum(values, edges[0]), bins=edges)
    return edges, np.append(np.maximum(counted.astype(float), HALF), HALF)
