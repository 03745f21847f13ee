# SPDX-License-Identifier: Apache-2.0
"""The PNG files of a run, drawn from what its bag holds."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fjr_bringup import panels
from fjr_bringup.report import Report
from fjr_bringup.tracking_data import TrackingData

STYLE = {
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": panels.GREY,
    "axes.grid": True,
    "grid.color": "#E6E6E6",
    "grid.linewidth": 0.7,
    "axes.axisbelow": True,
    "savefig.dpi": 150,
}


def draw_all(name: str, data: TrackingData, report: Report, folder: Path) -> list[Path]:
    """Write overview.png and one picture per subject into the folder; returns their paths."""
    with mpl.rc_context(STYLE):
        single = {
            "tracking": lambda ax: panels.tracking(ax, data),
            "error": lambda ax: panels.error(ax, data, report),
            "storage": lambda ax: panels.storage(ax, data, report),
            "effort": lambda ax: panels.effort(ax, data, report),
        }
        paths = [_single(draw, folder / f"{subject}.png") for subject, draw in single.items()]
        return [*paths, _timing(data, report, folder / "timing.png"), _overview(name, data, report, folder)]


def _single(draw: Callable[[Axes], None], path: Path) -> Path:
    figure = Figure(figsize=(7.0, 4.0), layout="constrained")
    draw(figure.subplots())
    figure.savefig(path)
    return path


def _timing(data: TrackingData, report: Report, path: Path) -> Path:
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    panels.period(left, data, report)
    panels.latency(right, data, report)
    figure.savefig(path)
    return path


def _overview(name: str, data: TrackingData, report: Report, folder: Path) -> Path:
    """The whole story in one look."""
    figure = Figure(figsize=(14.0, 7.2), layout="constrained")
    axes = figure.subplots(2, 3)
    panels.tracking(axes[0, 0], data)
    panels.error(axes[0, 1], data, report)
    panels.storage(axes[0, 2], data, report)
    panels.effort(axes[1, 0], data, report)
    panels.period(axes[1, 1], data, report)
    panels.latency(axes[1, 2], data, report)
    clock = "in lock-step" if report.lockstep else "in real time"
    rate = f"{1.0 / data.sample_period:g} Hz"
    figure.suptitle(f"{name}: plant and controller as two ROS 2 nodes, {rate} {clock}", fontsize=13, x=0.01, ha="left")
    path = folder / "overview.png"
    figure.savefig(path)
    return path
