# SPDX-License-Identifier: Apache-2.0
"""Several runs in the same axes: error, effort, storage, and how soon each answered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fjr_bringup.analysis.metrics import Report
from fjr_bringup.analysis.run_data import TrackingData
from fjr_bringup.recording.reader import Array
from fjr_bringup.report.figure import DRAWN, Line, Plot, colour, drawable, thinned
from fjr_core.robot.joint_units import joined

POINTS = 240  # of a distribution
SHORTEST = 1e-3  # ms


@dataclass(frozen=True)
class Compared:
    """A run beside others: the name that tells it from them, what it is, and where its own page is."""

    label: str
    data: TrackingData
    report: Report
    page: Path


def side_by_side_plots(runs: Sequence[Compared]) -> list[Plot]:
    """All plots that the runs have something for, in the order of the page."""
    drawn = [errors(runs), efforts(runs), storages(runs), latencies(runs), periods(runs)]
    return [plot for plot in drawn if not plot.is_empty]


def errors(runs: Sequence[Compared]) -> Plot:
    """The largest error of all joints."""
    values = [np.abs(run.data.error).max(axis=1) for run in runs]
    caption = "The largest |q_l − q_ld| of all joints at each state; log axis."
    return _over_time("error", "Tracking error", caption, runs, values, f"error [{_units(runs, 'position')}]")


def efforts(runs: Sequence[Compared]) -> Plot:
    """The largest effort of all joints."""
    values = [np.fmax.reduce(np.abs(run.data.u), axis=1) for run in runs]
    caption = "The largest |u| of all joints at each state; log axis."
    return _over_time("effort", "Effort", caption, runs, values, f"|u| [{_units(runs, 'effort')}]")


def _units(runs: Sequence[Compared], what: str) -> str:
    return joined(getattr(each, what) for run in runs for each in run.data.units)


def storages(runs: Sequence[Compared]) -> Plot:
    """V / V(0), with the bounds dashed."""
    relative = [drawable(run.data.relative_storage, log=True) for run in runs]
    floor = min(float(np.nanmin(values, initial=1e-3)) for values in relative) / 30.0
    caption = "V relative to its start; dashed: the bound exp(−2βt) of each run."
    plot = _over_time("storage", "Storage V and its bound", caption, runs, relative, "V(t) / V(0)")
    bounds = [np.where(run.data.V[0] > 0, np.exp(-2.0 * run.data.beta * plot.x), np.nan) for run in runs]
    dashed = [
        Line("", np.where((bound > floor) & (plot.x <= run.data.t[-1]), bound, np.nan), colour(i), 1.2, (6, 4))
        for i, (run, bound) in enumerate(zip(runs, bounds, strict=True))
    ]
    return Plot(plot.name, plot.title, caption, plot.x, [*plot.lines, *dashed], y_label=plot.y_label, y_log=True)


def latencies(runs: Sequence[Compared]) -> Plot:
    """What part of the states waited longer than so long."""
    values = [run.data.latency * 1e3 for run in runs]
    return _distribution("latency", "From state to command", "that waited longer", runs, values)


def periods(runs: Sequence[Compared]) -> Plot:
    """What part of the states came later after the one before than so late."""
    values = [np.diff(run.data.sent) * 1e3 for run in runs]
    return _distribution("period", "From state to state", "that came later", runs, values)


def _over_time(
    name: str, title: str, caption: str, runs: Sequence[Compared], values: Sequence[Array], label: str
) -> Plot:
    """On the union of the runs' own times."""
    rows = [thinned([column], DRAWN // len(runs)) for column in values]
    times = np.unique(np.concatenate([run.data.t[keep] for run, keep in zip(runs, rows, strict=True)]))
    lines = [
        Line(run.label, np.interp(times, run.data.t[keep], column[keep], np.nan, np.nan), colour(i), 1.3)
        for i, (run, keep, column) in enumerate(zip(runs, rows, values, strict=True))
    ]
    return Plot(name, title, caption, times, lines, y_label=label, y_log=True)


def _distribution(name: str, title: str, what: str, runs: Sequence[Compared], values: Sequence[Array]) -> Plot:
    known = [np.sort(column[np.isfinite(column)]) for column in values]
    everything = np.maximum(np.concatenate(known), SHORTEST)
    low, high = float(everything.min(initial=1.0)), float(everything.max(initial=SHORTEST))
    times = np.geomspace(low / 1.05, max(high, low) * 1.05, POINTS)
    lines = [
        Line(run.label, 100.0 * (1.0 - np.searchsorted(column, times, side="right") / max(1, len(column))), colour(i))
        for i, (run, column) in enumerate(zip(runs, known, strict=True))
        if len(column)
    ]
    caption = f"Part of the states {what} than the time below; both axes log."
    axes = {"x_label": "time [ms]", "y_label": "states [%]", "x_log": True, "y_log": True, "time": False}
    return Plot(name, title, caption, times, lines, **axes)  # type: ignore[arg-type]
