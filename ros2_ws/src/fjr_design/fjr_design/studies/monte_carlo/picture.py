# SPDX-License-Identifier: Apache-2.0
"""Picture of a Monte-Carlo study: the plots of its page, and the part of each parameter in the variance."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fjr_design.experiments.monte_carlo.sensitivity import Summary
from fjr_design.studies.monte_carlo.report import headline
from fjr_design.studies.monte_carlo.report_figures import SHOWN
from fjr_design.studies.monte_carlo.store import Store
from fjr_monitor.report.html import Plot
from fjr_monitor.report.picture import COLOURS, GREY, LEGEND, STYLE, draw_plot

WIDTH = 42  # characters of a line over a plot


@mpl.rc_context(STYLE)
def draw(store: Store, summary: Summary, plots: Sequence[Plot], path: Path) -> Path:
    """Write the picture: a column for each parameter that has plots, the most influential one first."""
    places = {plot.name: plot for plot in plots}
    columns = min(SHOWN, len(summary.effects)) + 1
    figure = Figure(figsize=(3.1 * columns, 7.0), layout="constrained")
    axes = figure.subplots(2, columns, squeeze=False)
    names = [[f"{row}-{column}" for column in range(columns - 1)] for row in ("share", "runs")]
    for row, ax in zip([*names[0], "", *names[1], "distribution"], axes.flat, strict=True):
        if row in places:
            draw_plot(ax, places[row], WIDTH)
    _indices(axes[0, -1], summary)
    title = f"{headline(store, summary)}, each of {store.sweep.duration:g} s"
    figure.suptitle(title, fontsize=13, x=0.01, ha="left")
    figure.savefig(path)
    return path


def _indices(ax: Axes, summary: Summary) -> None:
    shown = summary.effects[: 2 * SHOWN][::-1]
    rows = np.arange(len(shown))
    ax.barh(rows + 0.2, [effect.success for effect in shown], 0.36, color=COLOURS[1], label="success")
    ax.barh(rows - 0.2, [effect.error for effect in shown], 0.36, color=GREY, label="log RMS error")
    ax.set_yticks(rows, [effect.name for effect in shown])
    ax.set(title="Part of the variance", xlim=(0, 1))
    ax.grid(axis="y", visible=False)
    ax.legend(loc="lower right", **LEGEND)
