# SPDX-License-Identifier: Apache-2.0
"""Draw the plots of a page with Matplotlib, which may be missing, for a picture in a file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from fjr_core.errors import PIP
from fjr_monitor.report.html import Line, Plot, drawable
from fjr_msgs_py.console.output import SUPERSCRIPT, tell

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

# Okabe and Ito's palette, distinguishable by colour-blind readers, and brown
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#7A5230")
GREY = "#666666"
SHADES = {**{f"c{i}": shade for i, shade in enumerate(COLOURS, 1)}, "grey": "#A6A9B1", "bad": "#C0243C"}
"""By the names of page.css."""
SMALL = 8  # font size of captions and legends
FEW = 6  # ticks of a logarithmic axis; with more, powers of ten only
LEGEND: dict[str, Any] = {"fontsize": SMALL, "framealpha": 0.8, "edgecolor": "none", "markerscale": 3.0}
STYLE = {
    "font.size": 9,
    "text.parse_math": False,  # a name with dollars is no formula
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": GREY,
    "axes.grid": True,
    "grid.color": "#E6E6E6",
    "grid.linewidth": 0.7,
    "axes.axisbelow": True,
    "figure.dpi": 150,
}


def write_picture(path: Path, size: tuple[float, float], draw: Callable[[Figure], None]) -> Path | None:
    """Write a figure of this size [inch] that `draw` fills; return its path, or None and say so without Matplotlib."""
    try:
        import matplotlib as mpl  # half a second of imports
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        tell(f"{path} is left out: Matplotlib is not installed; expected it from: {PIP} matplotlib")
        return None
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=size, layout="constrained")
        draw(figure)
        FigureCanvasAgg(figure).print_png(str(path), pil_kwargs={"compress_level": 3})  # savefig draws twice
    return path


def draw_plot(ax: Axes, plot: Plot, width: int) -> None:
    """Draw a plot with title and caption, in lines of `width` characters, and a legend of what is not a plain line."""
    ax.set(xlabel=plot.x_label, ylabel=plot.y_label)
    ax.set_xscale("log" if plot.x_log else "linear")
    ax.set_yscale("log" if plot.y_log else "linear")
    for line in plot.lines:
        if not line.unseen:
            _draw_line(ax, plot, line)
    if plot.band is not None:
        upper, lower = (plot.lines[i].values for i in plot.band)
        ax.fill_between(plot.x, lower, upper, step="post", color=COLOURS[0], alpha=0.25, lw=0)
    caption = fill(plot.caption, width)
    ax.text(0.0, 1.02, caption, transform=ax.transAxes, va="bottom", fontsize=SMALL, color=GREY)
    ax.set_title(fill(plot.title, 4 * width // 5), pad=6 + 1.35 * SMALL * (1 + caption.count("\n")))
    ax.set_ylim(*plot.y_range)
    if plot.x_log:
        log_ticks(ax.xaxis)
    if plot.y_log:  # in plain text: Matplotlib's own formulas take a tenth of the drawing
        ax.yaxis.set_major_formatter(lambda value, _: f"10{str(round(np.log10(value))).translate(SUPERSCRIPT)}")
    ax.yaxis.get_offset_text().set_horizontalalignment("right")  # beside the caption
    ax.minorticks_off()  # on log axes each is drawn by five artists, a third of the drawing time
    if any(artist.get_label()[:1] not in ("", "_") for artist in (*ax.lines, *ax.collections)):
        ax.legend(loc="lower right" if any(line.dots for line in plot.lines) else "upper right", **LEGEND)


def log_ticks(*axes: Axis) -> None:
    """Set few ticks with plain numbers on logarithmic axes."""
    for axis in axes:
        low, high = axis.get_view_interval()
        ticks = [digit * 10.0**power for power in range(-12, 13) for digit in (1, 2, 5)]
        shown = [tick for tick in ticks if low <= tick <= high]
        shown = shown if len(shown) <= FEW else [tick for tick in ticks[::3] if low <= tick <= high]
        axis.set_ticks(shown or [low], labels=[f"{tick:g}" for tick in shown or [low]])
        axis.set_ticks([], minor=True)


def _draw_line(ax: Axes, plot: Plot, line: Line) -> None:
    values, colour = drawable(line.values, plot.y_log), SHADES[line.colour]
    label = line.label if line.dash or line.dots or (line.fill and len(plot.lines) > 1) else ""
    if line.fill:
        ax.fill_between(plot.x, plot.y_range[0] or 0.0, values, step="post", color=colour, lw=0, label=label)
    elif line.dots:
        ax.plot(plot.x, values, ".", ms=2.2, color=colour, alpha=0.5, rasterized=True, label=label)
    else:
        style = {"drawstyle": "steps-post"} if line.step else {}
        dashes = {"dashes": tuple(pixels / line.width for pixels in line.dash)} if line.dash else {}
        ax.plot(plot.x, values, color=colour, lw=line.width, label=label, **style, **dashes)
