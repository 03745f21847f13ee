# SPDX-License-Identifier: Apache-2.0
"""Draw overview.png: six plots of the page of a run."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

from fjr_monitor.analysis.metrics import Report
from fjr_monitor.plotting.figure import Line, Plot
from fjr_monitor.plotting.picture import STYLE, draw_plot, labels, name_lines
from fjr_monitor.report import run_figures
from fjr_monitor.report.shown import Shown

WIDTH = 68  # characters of a line over a plot


@mpl.rc_context(STYLE)
def draw_overview(name: str, data: Shown, report: Report, folder: Path) -> Path:
    """Write overview.png into the folder and return its path."""
    figure = Figure(figsize=(14.0, 8.0))
    longest = max(map(len, labels(data.run.joints))) if len(data.run.joints) > 1 else 0
    space = 0.26 + 0.03 * max(0, longest - 7)  # between the columns, for the names
    margins = {"left": 0.05, "right": 0.99, "bottom": 0.07, "top": 0.86, "wspace": space, "hspace": 0.48}
    axes = figure.subplots(2, 3, gridspec_kw=margins)  # an automatic layout takes as long as the drawing
    storage = run_figures.storage(data, report)
    plots = (
        run_figures.tracking(data),
        run_figures.error(data, report),
        _energy(data) if storage.is_empty else storage,
        run_figures.effort(data, report),
        run_figures.period(data, report),
        run_figures.latency(data, report),
    )
    for ax, plot in zip(axes.flat, plots, strict=True):
        draw_plot(ax, plot, WIDTH)
        name_lines(ax, plot)
    clock = "in lock-step" if report.lockstep else "in real time"
    rate = f"{1.0 / report.sample_period_s:g} Hz"
    title = f"{name}: plant and controller as two ROS 2 nodes, {rate} {clock}"
    figure.suptitle(title, fontsize=13, x=0.01, y=0.98, ha="left")
    path = folder / "overview.png"
    figure.savefig(path, pil_kwargs={"compress_level": 3})
    return path


def _energy(data: Shown) -> Plot:
    title = "The robot's energy (this law has no certificate)"
    return Plot("energy", title, "", data.states["t"], [Line("H", data.states["H"])], y_label="H [J]")
