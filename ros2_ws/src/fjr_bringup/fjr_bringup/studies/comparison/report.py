# SPDX-License-Identifier: Apache-2.0
"""The page of a comparison: robot by robot small multiples, margins, errors and efforts, then the laws."""

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
    "Drag over a plot to enlarge it, double-click to go back. All figures are in comparison.json beside this page. "
    "Needs no network."
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
    told = document["robots"][robot]
    references = "; ".join(
        f"{name}: RMS {number(each['motion_rad'], 'rad')}, torque up to {number(max(each['torque_nm']), 'N m')} RMS"
        for name, each in told["references"].items()
    )
    joints, period = plural(len(told["joints"]), "joint"), number(told["sample_period_s"] * 1e3, "ms")
    laws = document["laws"]
    head = ["", *(html.swatch(*look) + escape(law["title"]) for law, look in zip(laws, looks(laws), strict=True))]
    first = next(iter(told["references"]))
    return [
        html.section(robot, f"{joints}, a sample each {period}. Motions: {references}."),
        html.figures(place_of(i), small=True),
        html.table("How much a law bears", head, _table(found, "margins"), _margins_text(first, document), kind="even"),
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
    """Where each law is from, what it measures, and what came of the rule on each robot."""
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
    told = [document["results"][robot][law["label"]]["tuning"] for robot in document["robots"]]
    return [escape(f"{each}; {options}" if options else each) for each in told]


def _margins_text(reference: str, document: dict[str, Any]) -> str:
    part = f"{100 * document['suite']['tracks']:g} %"
    return (
        f"The largest error of the model, delay, noise, friction and load with which it still tracks along "
        f"'{reference}': stable, with an RMS error of at most {part} of the motion. {DASHED}"
    )


NO_RANKING = (
    "Rows are facts about one quantity each, not a ranking: the rule of tuning makes bandwidths equal, but not margins "
    "or peak efforts everywhere, and v-dPBC with the scenario's gains is its yardstick."
)
TUNED = (
    "All tuned by one rule to equal bandwidth and peak effort (docs/baselines.md); every command is cut at the same "
    "limit. Gains are in comparison.json."
)
DASHED = "Green: best, or within 5 % of it. A dash: does not even track the nominal robot."


def _table(found: Sequence[Row], kind: str) -> list[list[str]]:
    """Rows of one kind, with a heading for each reference."""
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
    words = escape(value.words)
    if best:
        return f'<b class="ok">{words}</b>'
    return f'<span class="{COLOURED[value.state]}">{words}</span>' if value.state in COLOURED else words
