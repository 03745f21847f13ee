# SPDX-License-Identifier: Apache-2.0
"""HTML page of a comparison: plots, margins, errors and efforts of each robot, then the laws."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

from fjr_core.files.python_class import is_named
from fjr_design.studies.comparison.report_figures import comparison_plots, looks, place_of
from fjr_design.studies.comparison.results import Row, Value, extent, rows
from fjr_monitor.report import html
from fjr_msgs_py.console.formatting import number, plural

HOW = (
    "Drag over a plot to enlarge it, double-click to go back. All results are in comparison.json in the same folder. "
    "Works offline."
)
COLOURED = {"lost": "maybe", "unstable": "no"}


def write_page(path: Path, document: dict[str, Any]) -> None:
    """Write the page of a comparison (results.document)."""
    found, laws, suite = rows(document), document["laws"], document["suite"]
    html.write_page(
        path,
        "laws.html",
        f"fjr compare {suite['name']}",
        comparison_plots(document),
        kicker=f"fjr compare {suite['name']}",
        heading=f"{extent(document)[:-1]}: {', '.join(document['robots'])}",
        tiles=_tiles(document),
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


def _tiles(document: dict[str, Any]) -> list[tuple[str, str]]:
    suite = document["suite"]
    return [
        (str(len(document["laws"])), "versions of control laws"),
        (str(document["runs"]), f"independent runs of {suite['duration']:g} s"),
        (f"{100 * suite['tracks']:g} % of the motion", "RMS error up to which a stable run tracks"),
        ("one rule", f"of tuning for all laws{exception_to_tuning(document)}: {_page(suite)}"),
    ]


def _page(suite: dict[str, Any]) -> str:
    return "docs/tuning.md" if suite["tune"] else "docs/compare.md"


def _robot(i: int, robot: str, found: Sequence[Row], document: dict[str, Any]) -> dict[str, Any]:
    """Return heading, text, place of the plots and tables of one robot."""
    data = document["robots"][robot]
    references = "; ".join(
        f"{name}: RMS {number(each['motion_rad'], 'rad')}, torque up to {number(max(each['torque_nm']), 'N m')} RMS"
        for name, each in data["references"].items()
    )
    joints, period = plural(len(data["joints"]), "joint"), number(data["sample_period_s"] * 1e3, "ms")
    first = next(iter(data["references"]))
    return {
        "name": robot,
        "text": f"{joints}, sample period {period}. Motions: {references}.",
        "place": place_of(i),
        "tables": [
            *_uncertain(found),
            ("Robustness margins", _groups(found, "margins"), _margins_text(first, document)),
            ("RMS error [mrad]", _groups(found, "errors"), "Of the links, over time and joints, once settled."),
            ("The nominal run", _groups(found, "metrics"), "Errors in mrad; efforts from the start on."),
        ],
    }


def _uncertain(found: Sequence[Row]) -> list[Any]:
    """Return the table of the drawn plants, if the laws were tuned to uncertainties."""
    groups = _groups(found, "uncertain")
    return [("Drawn plants", groups, f"Fresh draws of the uncertainties that all laws are tuned to. {DASHED}")] * bool(
        groups
    )


def _tunings(law: dict[str, Any], document: dict[str, Any]) -> list[str]:
    options = ", ".join(f"{name} {value:g}" for name, value in law["robust"].items())
    tunings = [document["results"][robot][law["label"]]["tuning"] for robot in document["robots"]]
    return [f"{each}; {options}" if options else each for each in tunings]


def _margins_text(reference: str, document: dict[str, Any]) -> str:
    part = f"{100 * document['suite']['tracks']:g} %"
    return (
        f"The largest model error, delay, noise, friction and load with which the law still tracks along "
        f"'{reference}': stable, with an RMS error of at most {part} of the motion. {DASHED}"
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
    "to the same uncertainties (docs/tuning.md); every command is cut at the same limit. Gains are in comparison.json."
)
TUNED = (
    "by one rule to equal bandwidth and peak effort (docs/compare.md); every command is cut at the same "
    "limit. Gains are in comparison.json."
)
DASHED = "Green: best, or within 5 % of the best. A dash: does not track the nominal robot."


Cell = tuple[str, str]
"""Text of a cell, and `best` or its CSS class."""


def _groups(found: Sequence[Row], kind: str) -> list[tuple[str, list[tuple[str, list[Cell]]]]]:
    """Return the rows of one kind, grouped by the reference that heads them."""
    chosen = [row for row in found if row.group.partition(" ")[0] == kind]
    return [
        (group.partition(" ")[2], [(row.what, list(map(_cell, row.values, row.best))) for row in rows_of_group])
        for group, rows_of_group in groupby(chosen, lambda row: row.group)
    ]


def _cell(value: Value, best: bool) -> Cell:
    return value.words, "best" if best else COLOURED.get(value.state, "")
