# SPDX-License-Identifier: Apache-2.0
"""HTML page of a comparison: plots, margins, errors and efforts of each robot, then the laws.

The plots show the error over each imperfection and the nominal run over time, all laws in the same axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from fjr_core.config.law import ROBUST
from fjr_core.files.importing import is_named
from fjr_core.numerics.checks import Array
from fjr_monitor.report import html
from fjr_monitor.report.html import Line, Plot

from .compare_results import Row, extent, in_units_of, law_without_additions, rows
from .trial import imperfection

TRACES = ("error", "The largest |q_l − q_ld|", "error [mrad]", 1e3), ("effort", "The largest |u|", "|u| [N m]", 1.0)
Style = tuple[str, str, tuple[int, ...]]
HEADROOM = 3.0  # times the largest error that counts as tracking; larger errors are not drawn
DASHES: tuple[tuple[int, ...], ...] = ((), (6, 4), (2, 3), (8, 3, 2, 3))


def write_page(path: Path, document: dict[str, Any]) -> None:
    """Write the page of a comparison (results.document), whose sentences are in the template."""
    found = rows(document)
    html.write_page(
        path,
        "laws.html",
        f"fjr compare {document['suite']['name']}",
        comparison_plots(document),
        document=document,
        extent=extent(document),
        own=laws_of_the_user(document),
        looks=looks(document["laws"]),
        units={name: parameter.unit for name, parameter in ROBUST.items()},
        said=partial(in_units_of, document),
        groups={
            robot: {kind: _groups(found, robot, kind) for kind in ("drawn", "margins", "errors", "metrics")}
            for robot in document["robots"]
        },
    )


def laws_of_the_user(document: dict[str, Any]) -> list[str]:
    """Return the titles of the laws of the user, which are not tuned: they keep their options."""
    return [law["title"] for law in document["laws"] if is_named(law["law"])]


def _groups(found: Sequence[Row], robot: str, kind: str) -> list[tuple[str, list[Row]]]:
    """Return the rows of one robot and kind, grouped by the reference that heads them."""
    chosen = groupby((row for row in found if (row.robot, row.kind) == (robot, kind)), lambda row: row.reference)
    return [(reference, list(group)) for reference, group in chosen]


def comparison_plots(document: dict[str, Any]) -> list[Plot]:
    """Return all plots, robot by robot."""
    plots: list[Plot] = []
    found = rows(document)
    styles = [(str(law["title"]), *look) for law, look in zip(document["laws"], looks(document["laws"]), strict=True)]
    for i, robot in enumerate(document["robots"]):
        results = [document["results"][robot][law["label"]] for law in document["laws"]]
        laws = list(zip(styles, results, strict=True))
        place = f"robot-{i}"
        margins = [row for row in found if row.robot == robot and row.kind == "margins"]
        of_robot = [_trace(place, laws, *texts) for texts in TRACES]
        for axis in document["suite"]["margins"]:
            caption = _winners([row for row in margins if row.name.startswith(axis)], [name for name, *_ in styles])
            of_robot.append(_curve(place, laws, axis, document["suite"]["tracks"], caption))
        for plot in of_robot:
            x_label, y_label = (in_units_of(document, robot, label) for label in (plot.x_label, plot.y_label))
            plots.append(replace(plot, x_label=x_label, y_label=y_label))
    return [plot for plot in plots if not plot.is_empty]


def looks(laws: Sequence[dict[str, Any]]) -> list[tuple[str, tuple[int, ...]]]:
    """Return colour and dash pattern of each column: a colour for each law, a dash pattern for each version of it."""
    names = [law_without_additions(law) for law in laws]
    order = list(dict.fromkeys(names))
    before = [names[:i].count(name) for i, name in enumerate(names)]
    return [
        (html.colour(order.index(name)), DASHES[times % len(DASHES)]) for name, times in zip(names, before, strict=True)
    ]


def _trace(place: str, laws: Sequence[tuple[Style, Any]], what: str, caption: str, label: str, scale: float) -> Plot:
    t, axes = np.array(laws[0][1]["trace"]["t"]), {"y_label": label, "y_log": True, "place": place, "legend": False}
    lines = [_line(style, scale * np.array(law["trace"][what], dtype=float)) for style, law in laws]
    return Plot(f"{place}-{what}", f"Nominal: {what}", caption, t, lines, **axes)  # type: ignore[arg-type]


def _winners(margins: Sequence[Row], names: Sequence[str]) -> str:
    """Return the widest margins of an imperfection with the law that reaches them."""
    largest = []
    for row in margins:
        best = [i for i, best in enumerate(row.best) if best]
        if best:
            first = (min if row.less else max)(best, key=lambda i: row.values[i].number or 0.0)
            largest.append(f"{row.values[first].words} ({'several' if len(best) > 1 else names[first]})")
    return f"Widest: {', '.join(largest)}" if largest else "No law tracks."


def _curve(place: str, laws: Sequence[tuple[Style, Any]], axis: str, tracks: float, caption: str) -> Plot:
    """Plot the RMS error over the level of an imperfection; a line ends at the first level that fails."""
    one = imperfection(axis)
    levels = np.unique(np.concatenate([law["curves"][axis]["levels"] for _, law in laws]))
    levels = levels[levels > 0]
    lines = [_line(style, _sampled(law["curves"][axis], levels, tracks)) for style, law in laws]
    limit = Line("", np.full(len(levels), 100 * tracks), "grey", 1.2, (3, 3))
    return Plot(
        f"{place}-{axis}",
        one.heading,
        caption,
        levels * one.scale,
        [limit, *lines],
        x_label=one.axis,
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
    known, error = np.array(curve["levels"]), np.array(curve["relative"], dtype=float)
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
