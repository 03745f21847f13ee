# SPDX-License-Identifier: Apache-2.0
"""Plots of a comparison: error over each imperfection and the nominal run over time, all laws in the same axes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from fjr_core.numerics.checks import Array
from fjr_design.studies.comparison.results import Row, law_without_additions, rows
from fjr_monitor.report.html import Line, Plot

AXIS_LABELS = {
    "stiffness": ("Wrong stiffness", "true stiffness / the model's", 1.0),
    "inertia": ("Wrong masses", "true inertia and weight / the model's", 1.0),
    "delay": ("Command delay", "delay [ms]", 1e3),
    "noise": ("Noise", "noise of the positions [mrad]", 1e3),
    "friction": ("Unknown friction", "friction [% of the motion's torque]", 100.0),
    "load": ("Unknown load", "load [% of the motion's torque]", 100.0),
}
Style = tuple[str, str, tuple[int, ...]]
HEADROOM = 3.0  # times the largest error that counts as tracking; larger errors are not drawn
DASHES: tuple[tuple[int, ...], ...] = ((), (6, 4), (2, 3), (8, 3, 2, 3))
COLOURS = 8  # --c1 .. --c8 of page.css


def comparison_plots(document: dict[str, Any]) -> list[Plot]:
    """Return all plots, robot by robot."""
    plots, found = [], rows(document)
    styles = [(str(law["title"]), *look) for law, look in zip(document["laws"], looks(document["laws"]), strict=True)]
    for number, robot in enumerate(document["robots"]):
        results = [document["results"][robot][law["label"]] for law in document["laws"]]
        laws = list(zip(styles, results, strict=True))
        place = place_of(number)
        margins = [row for row in found if row.robot == robot and row.group == "margins"]
        plots += [_trace(place, laws, "error"), _trace(place, laws, "effort")]
        for axis in document["suite"]["margins"]:
            caption = _winners([row for row in margins if row.what.startswith(axis)], [name for name, *_ in styles])
            plots.append(_curve(place, laws, axis, document["suite"]["tracks"], caption))
    return [plot for plot in plots if not plot.is_empty]


def place_of(number: int) -> str:
    """Return the id of the HTML element for the plots of a robot."""
    return f"robot-{number}"


def looks(laws: Sequence[dict[str, Any]]) -> list[tuple[str, tuple[int, ...]]]:
    """Return colour and dash pattern of each column: a colour for each law, a dash pattern for each version of it."""
    names = [law_without_additions(law) for law in laws]
    order = list(dict.fromkeys(names))
    before = [names[:i].count(name) for i, name in enumerate(names)]
    return [
        (f"c{order.index(name) % COLOURS + 1}", DASHES[times % len(DASHES)])
        for name, times in zip(names, before, strict=True)
    ]


def _trace(place: str, laws: Sequence[tuple[Style, Any]], what: str) -> Plot:
    texts = {
        "error": ("Nominal: error", "The largest |q_l − q_ld|", "error [rad]"),
        "effort": ("Nominal: effort", "The largest |u|", "|u| [N m]"),
    }
    heading, caption, label = texts[what]
    t = np.array(laws[0][1]["trace"]["t"])
    lines = [_line(style, _floats(law["trace"][what])) for style, law in laws]
    return Plot(f"{place}-{what}", heading, caption, t, lines, y_label=label, y_log=True, place=place, legend=False)


def _winners(margins: Sequence[Row], names: Sequence[str]) -> str:
    """Return the largest margins of an imperfection with the law that reaches them."""
    largest = []
    for row in margins:
        best = [i for i, best in enumerate(row.best) if best]
        if best:
            first = (min if row.less else max)(best, key=lambda i: row.values[i].number or 0.0)
            largest.append(f"{row.values[first].words} ({'several' if len(best) > 1 else names[first]})")
    return f"Largest: {', '.join(largest)}" if largest else "No law tracks."


def _curve(place: str, laws: Sequence[tuple[Style, Any]], axis: str, tracks: float, caption: str) -> Plot:
    """Plot the RMS error over the level of an imperfection; a line ends at the first level that fails."""
    heading, label, unit = AXIS_LABELS[axis]
    levels = np.unique(np.concatenate([law["curves"][axis]["levels"] for _, law in laws]))
    levels = levels[levels > 0]
    lines = [_line(style, _sampled(law["curves"][axis], levels, tracks)) for style, law in laws]
    limit = Line("", np.full(len(levels), 100 * tracks), "grey", 1.2, (3, 3))
    return Plot(
        f"{place}-{axis}",
        heading,
        caption,
        levels * unit,
        [limit, *lines],
        x_label=label,
        y_label="RMS error [%]",
        x_log=True,
        y_log=True,
        time=False,
        y_range=(None, 100 * tracks * HEADROOM),
        place=place,
        legend=False,
    )


def _sampled(curve: dict[str, Any], levels: Array, tracks: float) -> Array:
    """Return the error [%] at the levels, from the nominal one to the last before failure on either side."""
    known, error = np.array(curve["levels"]), _floats(curve["relative"])
    good = np.isfinite(error) & (error <= HEADROOM * tracks)
    start = int(np.searchsorted(known, 1.0)) if known[0] > 0 else 0
    if not good[start]:
        return np.full(len(levels), np.nan)
    first = start - int(np.argmin(np.append(good[start::-1], False))) + 1
    last = start + int(np.argmin(np.append(good[start:], False))) - 1
    inside = (levels >= known[first]) & (levels <= known[last])
    floor = np.maximum(known, levels[0] / 2)
    between = np.interp(np.log(levels), np.log(floor[first : last + 1]), np.log(error[first : last + 1] + 1e-12))
    return np.where(inside, 100 * np.exp(between), np.nan)


def _line(style: Style, values: Array) -> Line:
    title, colour, dash = style
    return Line(title, values, colour, 2.0 if colour == "c1" else 1.3, dash)


def _floats(values: Sequence[float | None]) -> Array:
    return np.array([np.nan if value is None else value for value in values])
