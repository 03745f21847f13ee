# SPDX-License-Identifier: Apache-2.0
"""HTML page of a comparison: plots, margins, errors and efforts of each robot, then the laws.

The plots show the error over each imperfection and the nominal run over time, all laws in the same axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from fjr_core.config.law import ROBUST
from fjr_core.files.importing import is_named
from fjr_core.numerics.checks import Array
from fjr_monitor.report import html
from fjr_monitor.report.html import Line, Plot
from fjr_msgs_py.console.output import number, plural

from .compare_results import Row, extent, law_without_additions, rows
from .trial import imperfection

HOW = (
    "Drag over a plot to enlarge it, double-click to go back. All results are in comparison.json in the same folder. "
    "Works offline."
)
NO_RANKING = (
    "Rows are facts about one quantity each, not a ranking: the rule of tuning makes bandwidths equal, but not margins "
    "or peak efforts everywhere, and v-dPBC with the gains of the scenario is the tuning target."
)
ALL_ALIKE = (
    "Every law is tuned to the same uncertainties with the same cost, draws and number of candidates. Rows are facts "
    "about one quantity each."
)
TO_UNCERTAINTIES = (
    "to the same uncertainties (docs/gains.md); every command is cut at the same limit. Gains are in comparison.json."
)
TUNED = (
    "by one rule to equal bandwidth and peak effort (docs/compare.md); every command is cut at the same "
    "limit. Gains are in comparison.json."
)
DASHED = "Green: best, or within 5 % of the best. A dash: does not track the nominal robot."
TRACES = ("error", "The largest |q_l − q_ld|", "error [mrad]", 1e3), ("effort", "The largest |u|", "|u| [N m]", 1.0)
Style = tuple[str, str, tuple[int, ...]]
HEADROOM = 3.0  # times the largest error that counts as tracking; larger errors are not drawn
DASHES: tuple[tuple[int, ...], ...] = ((), (6, 4), (2, 3), (8, 3, 2, 3))


def write_page(path: Path, document: dict[str, Any]) -> None:
    """Write the page of a comparison (results.document)."""
    found, laws, suite = rows(document), document["laws"], document["suite"]
    page = "gains" if suite["tune"] else "compare"
    html.write_page(
        path,
        "laws.html",
        f"fjr compare {suite['name']}",
        comparison_plots(document),
        kicker=f"fjr compare {suite['name']}",
        heading=f"{extent(document)[:-1]}: {', '.join(document['robots'])}",
        tiles=[
            (str(len(laws)), "versions of control laws"),
            (str(document["runs"]), f"independent runs of {suite['duration']:g} s"),
            (f"{100 * suite['tracks']:g} % of the motion", "RMS error up to which a stable run tracks"),
            ("one rule", f"of tuning for all laws{exception_to_tuning(document)}: docs/{page}.md"),
        ],
        note=ALL_ALIKE if suite["tune"] else NO_RANKING,
        laws=[
            {"title": law["title"], "colour": colour, "dash": dash}
            for law, (colour, dash) in zip(laws, looks(laws), strict=True)
        ],
        robots=[
            _robot(i, robot, [row for row in found if row.robot == robot], document)
            for i, robot in enumerate(document["robots"])
        ],
        sources_head=[
            "",
            "paper",
            "added to the paper's law",
            "measures",
            *(f"tuned on {r}" for r in document["robots"]),
        ],
        sources=[[law["title"], law["paper"], law["adds"], law["measures"], *_tunings(law, document)] for law in laws],
        sources_text=f"All{exception_to_tuning(document)} tuned {TO_UNCERTAINTIES if suite['tune'] else TUNED}",
        footer=HOW,
    )


def exception_to_tuning(document: dict[str, Any]) -> str:
    """Return the exception to the rule of tuning: the laws of the user, which keep their options."""
    titles = [law["title"] for law in document["laws"] if is_named(law["law"])]
    return f" but {', '.join(titles)}" if titles else ""


def _robot(i: int, robot: str, found: Sequence[Row], document: dict[str, Any]) -> dict[str, Any]:
    """Return heading, text, place of the plots and tables of one robot."""
    data = document["robots"][robot]
    references = "; ".join(
        f"{name}: RMS {number(each['motion_rad'], 'rad')}, torque up to {number(max(each['torque_nm']), 'N m')} RMS"
        for name, each in data["references"].items()
    )
    joints, period = plural(len(data["joints"]), "joint"), number(data["sample_period_s"] * 1e3, "ms")
    part = f"{100 * document['suite']['tracks']:g} %"
    margins = (
        "The largest model error, delay, noise, friction and load with which the law still tracks along "
        f"'{next(iter(data['references']))}': stable, with an RMS error of at most {part} of the motion. {DASHED}"
    )
    fresh = f"Fresh draws of the uncertainties that all laws are tuned to. {DASHED}"
    drawn = _groups(found, "drawn")
    return {
        "name": robot,
        "text": f"{joints}, sample period {period}. Motions: {references}.",
        "place": f"robot-{i}",
        "tables": [
            *([("Drawn plants", drawn, fresh)] if drawn else []),
            ("Robustness margins", _groups(found, "margins"), margins),
            ("RMS error [mrad]", _groups(found, "errors"), "Of the links, over time and joints, once settled."),
            ("The nominal run", _groups(found, "metrics"), "Errors in mrad; efforts from the start on."),
        ],
    }


def _tunings(law: dict[str, Any], document: dict[str, Any]) -> list[str]:
    options = ", ".join(f"{name} {number(value, ROBUST[name].unit)}" for name, value in law["robust"].items())
    tunings = [document["results"][robot][law["label"]]["tuning"] for robot in document["robots"]]
    return [f"{each}; {options}" if options else each for each in tunings]


def _groups(found: Sequence[Row], kind: str) -> list[tuple[str, list[Row]]]:
    """Return the rows of one kind, grouped by the reference that heads them."""
    chosen = groupby((row for row in found if row.kind == kind), lambda row: row.reference)
    return [(reference, list(group)) for reference, group in chosen]


def comparison_plots(document: dict[str, Any]) -> list[Plot]:
    """Return all plots, robot by robot."""
    plots, found = [], rows(document)
    styles = [(str(law["title"]), *look) for law, look in zip(document["laws"], looks(document["laws"]), strict=True)]
    for i, robot in enumerate(document["robots"]):
        results = [document["results"][robot][law["label"]] for law in document["laws"]]
        laws = list(zip(styles, results, strict=True))
        place = f"robot-{i}"
        margins = [row for row in found if row.robot == robot and row.kind == "margins"]
        plots += [_trace(place, laws, *texts) for texts in TRACES]
        for axis in document["suite"]["margins"]:
            caption = _winners([row for row in margins if row.name.startswith(axis)], [name for name, *_ in styles])
            plots.append(_curve(place, laws, axis, document["suite"]["tracks"], caption))
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
