# SPDX-License-Identifier: Apache-2.0
"""The picture of a run, drawn from what its bag holds."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

from fjr_bringup.analysis.metrics import Report
from fjr_bringup.analysis.run_data import TrackingData
from fjr_bringup.plotting import panels

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


def draw_overview(name: str, data: TrackingData, report: Report, folder: Path) -> Path:
    """Write overview.png into the folder: the whole story in one look, where no browser is."""
    with mpl.rc_context(STYLE):
        return _overview(name, data, report, folder)


def _overview(name: str, data: TrackingData, report: Report, folder: Path) -> Path:
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
