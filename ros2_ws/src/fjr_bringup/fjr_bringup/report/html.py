# SPDX-License-Identifier: Apache-2.0
"""One self-contained HTML file: text made here, plots drawn in the browser by uPlot, nothing fetched from anywhere."""

from __future__ import annotations

import json
from collections.abc import Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template

from fjr_bringup.analysis.controller_stop import ControllerStop
from fjr_bringup.analysis.verdicts import Verdict
from fjr_bringup.atomic_file import write_text
from fjr_bringup.report.figure import Plot, Pool

PARTS = {"css": "page.css", "script": "page.js", "uplot": "uPlot.iife.min.js", "uplot_css": "uPlot.min.css"}
HEADINGS = {
    "holding": "The certificate holds",
    "degraded": "Degraded",
    "violated": "Violated",
    "unknown": "No verdict",
}


def write_page(path: Path, title: str, body: Sequence[str], plots: Sequence[Plot]) -> None:
    """Write the page: its title, pieces of HTML with an element of id `figures` among them, and what is drawn there."""
    pool = Pool()
    packed = [plot.packed(pool) for plot in plots]
    drawn = json.dumps({"arrays": pool.arrays, "plots": packed}).replace("<", "\\u003c")
    parts = {name: _part(file) for name, file in PARTS.items()}
    page = Template(_part("page.html")).substitute(parts, title=escape(title), body="\n".join(body), plots=drawn)
    write_text(path, page)


def _part(name: str) -> str:
    return (files("fjr_bringup") / "report" / "templates" / name).read_text(encoding="utf-8")


def header(
    kicker: str, title: str, verdict: Verdict | None, notes: Sequence[str], stop: ControllerStop | None = None
) -> str:
    """The head of the page: what it is, why the controller stopped or else the verdict, what is missing."""
    said = stop_line(stop) if stop else "" if verdict is None else verdict_line(verdict)
    listed = "".join(f"<li>{escape(note)}</li>" for note in notes)
    notes_block = f'<ul class="notes">{listed}</ul>' if notes else ""
    return f'<header><p class="kicker">{escape(kicker)}</p><h1>{escape(title)}</h1>{said}{notes_block}</header>'


def stop_line(stop: ControllerStop) -> str:
    """Why the controller stopped, in the colour of a violation."""
    return f'<p class="verdict violated"><b>{escape(stop.heading)}</b> <span>{escape(stop.reason)}</span></p>'


def verdict_line(verdict: Verdict) -> str:
    """The verdict, in its colour."""
    heading = HEADINGS[verdict.kind] + (f": {verdict.detail}" if verdict.detail else "")
    return f'<p class="verdict {verdict.kind}"><b>{escape(heading)}</b> <span>{escape(verdict.sentence)}</span></p>'


def tiles(figures: Sequence[tuple[str, str]]) -> str:
    """Figures with what they are."""
    each = "".join(
        f'<div class="tile"><b>{escape(value)}</b><span>{escape(what)}</span></div>' for value, what in figures
    )
    return f'<div class="tiles">{each}</div>'


def figures(place: str = "figures", small: bool = False) -> str:
    """The place of the plots, or of those of that place; small: three in a row where there is room."""
    return f'<div class="plots{" small" if small else ""}" id="{escape(place, quote=True)}"></div>'


def section(title: str, text: str = "") -> str:
    """A heading of a part of the page, with a sentence or two below it."""
    said = f'<p class="said">{escape(text)}</p>' if text else ""
    return f'<h2 class="part">{escape(title)}</h2>{said}'


def key(entries: Sequence[tuple[str, str, Sequence[int]]]) -> str:
    """Names beside their colours and dashes, for plots without a legend; stays in sight."""
    each = "".join(f"<span>{swatch(colour, dash)}{escape(name)}</span>" for colour, name, dash in entries)
    return f'<p class="key">{each}</p>'


def table(title: str, head: Sequence[str], rows: Sequence[Sequence[str]], text: str = "", kind: str = "") -> str:
    """A table of figures; a row of one cell is the heading of those after it. Cells are HTML.

    text: a sentence above it; kind: `even` for columns of one width, `words` for cells of text.
    """
    top = "".join(f"<th>{cell}</th>" for cell in head)
    body = "".join(_row(row, len(head)) for row in rows)
    said = f'<p class="said">{escape(text)}</p>' if text else ""
    return (
        f'<h2 class="section">{escape(title)}</h2>{said}<div class="scroll"><table class="figures {kind}">'
        f"<thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def _row(row: Sequence[str], columns: int) -> str:
    if len(row) == 1:
        return f'<tr class="group"><th colspan="{columns}">{row[0]}</th></tr>'
    cells = "".join(f"<td>{cell}</td>" for cell in row[1:])
    return f"<tr><th>{row[0]}</th>{cells}</tr>"


def swatch(colour: str, dash: Sequence[int] = ()) -> str:
    """A joint's, a bag's or a law's colour beside its name; with dashes a piece of the line."""
    own = f"var(--{colour})"
    lines = (
        f"repeating-linear-gradient(90deg, {own} 0 {dash[0]}px, transparent {dash[0]}px {sum(dash[:2])}px)"
        if dash
        else own
    )
    return f'<span class="{"swatch line" if dash else "swatch"}" style="background:{lines}"></span>'


def everything(title: str, value: object) -> str:
    """All figures as JSON, folded."""
    text = escape(json.dumps(value, indent=2, ensure_ascii=False))
    return f"<details><summary>{escape(title)}</summary><pre>{text}</pre></details>"


def footer(sentence: str) -> str:
    """The last line."""
    return f"<footer>{escape(sentence)}</footer>"
