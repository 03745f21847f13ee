# SPDX-License-Identifier: Apache-2.0
"""HTML page of a comparison: plots, margins, errors and efforts of each robot, then the laws."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

from fjr_bringup.formatting import number, plural
from fjr_bringup.report import html
from fjr_bringup.studies.comparison.report_figures import comparison_plots, looks, place_of
from fjr_bringup.studies.comparison.results import Row, Value, extent, rows

HOW = (
    "Drag over a plot to enlarge it, double-click to go back. All results are in comparison.json in the same folder. "
    "Works offline."
)
COLOURED = {"lost": "maybe", "unstable": "no"}


def write_page(path: Path, document: dict[str, Any]) -> None:
    """Write the page of a comparison (results.document)."""
    found = rows(document)
    body = [*_head(document)]
    for i, robot in enumerate(document["robots"]):
        body += _robot(i, robot, [row for row in found if row.robot == robot], document)
    body += [_laws(document), html.footer(HOW)]
    html.write_page(path, f"fjr compare {document['suite']['name']}", body, comparison_plots(document))


def _head(document: dict[str, Any]) -> list[str]:
    laws, robots, suite = document["laws"], document["robots"], document["suite"]
    figures = [
        (str(len(laws)), "versions of control laws"),
        (str(document["runs"]), f"independent runs of {suite['duration']:g} s"),
        (f"{100 * suite['tracks']:g} % of the motion", "RMS error up to which a stable run tracks"),
        ("one rule", "of tuning for all laws: docs/baselines.md"),
    ]
    return [
        html.header(f"fjr compare {suite['name']}", f"{extent(document)[:-1]}: {', '.join(robots)}", None, []),
        html.tiles(figures),
        f'<div class="notes"><p>{escape(NO_RANKING)}</p></div>',
        html.key([(colour, str(law["title"]), dash) for law, (colour, dash) in zip(laws, looks(laws), strict=True)]),
    ]


def _robot(i: int, robot: str, found: Sequence[Row], document: dict[str, Any]) -> list[str]:
    data = document["robots"][robot]
    references = "; ".join(
        f"{name}: RMS {number(each['motion_rad'], 'rad')}, torque up to {number(max(each['torque_nm']), 'N m')} RMS"
        for name, each in data["references"].items()
    )
    joints, period = plural(len(data["joints"]), "joint"), number(data["sample_period_s"] * 1e3, "ms")
    laws = document["laws"]
    head = ["", *(html.swatch(*look) + escape(law["title"]) for law, look in zip(laws, looks(laws), strict=True))]
    first = next(iter(data["references"]))
    return [
        html.section(robot, f"{joints}, sample period {period}. Motions: {references}."),
        html.figures(place_of(i), small=True),
        html.table("Robustness margins", head, _table(found, "margins"), _margins_text(first, document), kind="even"),
        html.table(
            "RMS error [mrad]",
            head,
            _table(found, "errors"),
            "Of the links, over time and joints, once settled.",
            kind="even",
        ),
        html.table(
            "The nominal run", head, _table(found, "metrics"), "Errors in mrad; efforts from the start on.", kind="even"
        ),
    ]


def _laws(document: dict[str, Any]) -> str:
    """Return the table of laws: paper, additions, measured signals, and tuning on each robot."""
    lines = [
        [
            escape(law["title"]),
            *(escape(str(text)) for text in (law["paper"], law["adds"], law["measures"])),
            *_tunings(law, document),
        ]
        for law in document["laws"]
    ]
    head = [
        "",
        "paper",
        "added to the paper's law",
        "measures",
        *(f"tuned on {escape(robot)}" for robot in document["robots"]),
    ]
    return html.table("The laws", head, lines, TUNED, "words")


def _tunings(law: dict[str, Any], document: dict[str, Any]) -> list[str]:
    options = ", ".join(f"{name} {value:g}" for name, value in law["robust"].items())
    tunings = [document["results"][robot][law["label"]]["tuning"] for robot in document["robots"]]
    return [escape(f"{each}; {options}" if options else each) for each in tunings]


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
TUNED = (
    "All tuned by one rule to equal bandwidth and peak effort (docs/baselines.md); every command is cut at the same "
    "limit. Gains are in comparison.json."
)
DASHED = "Green: best, or within 5 % of it. A dash: does not track the nominal robot."


def _table(found: Sequence[Row], kind: str) -> list[list[str]]:
    """Return the rows of one kind, with a heading for each reference."""
    lines: list[list[str]] = []
    group = ""
    for row in (row for row in found if row.group.partition(" ")[0] == kind):
        reference = row.group.partition(" ")[2]
        if reference and row.group != group:
            lines.append([escape(reference)])
        group = row.group
        lines.append([escape(row.what), *(_cell(v, best) for v, best in zip(row.values, row.best, strict=True))])
    return lines


def _cell(value: Value, best: bool) -> str:
    text = escape(value.words)
    if best:
        return f'<b class="ok">{text}</b>'
    return f'<span class="{COLOURED[value.state]}">{text}</span>' if value.state in COLOURED else text
