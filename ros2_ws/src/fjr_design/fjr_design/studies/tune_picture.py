# SPDX-License-Identifier: Apache-2.0
"""Picture of a tuning study: Pareto fronts of the candidates, and the errors on fresh draws."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fjr_core.numerics.checks import Array
from fjr_monitor.report.picture import COLOURS, GREY, LEGEND, STYLE
from fjr_msgs_py.console.output import percent

from .tune import Figures

if TYPE_CHECKING:
    from .tune_run import Tuned

AXES = {"effort_noise": "noise in the effort [N m]", "effort_peak": "peak effort [N m]"}


@mpl.rc_context(STYLE)
def draw(tuned: Tuned, path: Path) -> Path:
    """Write the picture: error against noise in the effort, error against peak effort, distribution of the error."""
    figure = Figure(figsize=(12.0, 4.2), layout="constrained")
    axes = figure.subplots(1, 3)
    for ax, name in zip(axes, AXES, strict=False):
        _front(ax, tuned, name)
    _distribution(axes[2], tuned.scenario, tuned.chosen)
    title = f"{tuned.study.sweep.name}: {len(tuned.found.candidates)} candidates, {tuned.study.fresh:,} fresh draws"
    figure.suptitle(title, fontsize=13, x=0.01, ha="left")
    figure.savefig(path)
    return path


def _front(ax: Axes, tuned: Tuned, name: str) -> None:
    """Draw all candidates on the draws of the search, those on the front joined, start and choice marked."""
    found, quantile = tuned.found, tuned.study.goal.quantile
    scores = [one.score for one in found.candidates]
    x, y = (np.array([score.figures[key] for score in scores]) for key in (name, "rms"))
    kept = np.array([score.feasible for score in scores])
    finite = np.isfinite(x) & np.isfinite(y) & (x > 0) & (y > 0)
    ax.plot(x[finite & ~kept], 1e3 * y[finite & ~kept], ".", ms=4, color="#C9CCD3", label="violates a constraint")
    ax.plot(x[finite & kept], 1e3 * y[finite & kept], ".", ms=4, color=COLOURS[5], label="keeps the constraints")
    best = pareto(x, y, finite & (kept if kept.any() else True))
    ax.plot(x[best], 1e3 * y[best], "-", drawstyle="steps-post", color=COLOURS[0], lw=1.5, label="Pareto front")
    points = [one.point for one in found.candidates]
    at = [points.index(found.start.point), points.index(found.chosen)]
    for i, marker, label in zip(at, "s*", ("start of the search", "chosen"), strict=True):
        if finite[i]:
            ax.plot(x[i], 1e3 * y[i], marker, ms=9, color=COLOURS[1] if marker == "*" else GREY, label=label)
    ax.set(xscale="log", yscale="log", xlabel=AXES[name], ylabel="RMS error [mrad]")
    ax.set_title(f"Candidates, {percent(quantile, 0)} quantile over {tuned.study.draws} draws")
    ax.legend(loc="best", **{**LEGEND, "markerscale": 1.0})


def pareto(x: Array, y: Array, among: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the indices of the points that no other one beats in both values, by increasing x."""
    order = np.flatnonzero(among)
    order = order[np.lexsort((y[order], x[order]))]
    best: list[int] = []
    for i in order:
        if not best or y[i] < y[best[-1]]:
            best.append(int(i))
    return np.array(best, dtype=np.intp)


def _distribution(ax: Axes, scenario: Figures, chosen: Figures) -> None:
    """Draw the share of the fresh draws whose error is at most a level; lost runs are missing at the top."""
    for runs, colour, label in ((scenario, GREY, "scenario"), (chosen, COLOURS[1], "chosen")):
        rms = np.sort(runs["rms"])
        share = 100.0 * np.arange(1, len(rms) + 1) / len(rms)
        stable = np.isfinite(rms) & (rms > 0)
        ax.plot(1e3 * rms[stable], share[stable], color=colour, label=label)
    ax.set(xscale="log", xlabel="RMS error [mrad]", ylabel="fresh draws with at most this error [%]", ylim=(0, 101))
    ax.set_title("Fresh draws, cumulative")
    ax.legend(loc="lower right", **LEGEND)
