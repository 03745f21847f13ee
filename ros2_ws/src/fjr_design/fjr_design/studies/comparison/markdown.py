# SPDX-License-Identifier: Apache-2.0
"""Write the table of a comparison in Markdown between two marks of a document (docs/tables/compare.md)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fjr_core.errors import CompareError
from fjr_design.studies.comparison.results import Row, best_in, extent, table_rows
from fjr_msgs_py.console.output import DASH

BEGIN, END = "<!-- fjr compare: begin -->", "<!-- fjr compare: end -->"


def check(path: Path, suite: str) -> None:
    """Check that a file has the marks of a suite; raise CompareError otherwise."""
    _parts(path, suite)


def marks(suite: str) -> tuple[str, str]:
    """Return the lines between which the table of this suite stands in a file with several tables."""
    return f"<!-- fjr compare {suite}: begin -->", f"<!-- fjr compare {suite}: end -->"


def replace(path: Path, document: dict[str, Any]) -> None:
    """Write the table of a comparison between its marks in a file, else between those without a name.

    Raise CompareError if the file lacks them.
    """
    before, begin, end, after = _parts(path, document["suite"]["name"])
    path.write_text(f"{before}{begin}\n{markdown(document)}{end}{after}", encoding="utf-8")


def _parts(path: Path, suite: str) -> tuple[str, str, str, str]:
    """Return the text before the first mark, both marks, and the text after the second."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise CompareError(f"cannot read {path}: {error.strerror}") from None
    for first, last in (marks(suite), (BEGIN, END)):
        before, begin, rest = text.partition(first)
        _, end, after = rest.partition(last)
        if begin and end:
            return before, begin, end, after
    raise CompareError(f"{path} lacks the lines '{BEGIN}' and '{END}'; expected both, in this order")


def markdown(document: dict[str, Any]) -> str:
    """Return the extent of the comparison and one table: a row for each metric of each robot, a column for each law."""
    head, *body = cells(document)
    bold = [[f"**{first}**", *rest] if not any(rest) else [first, *rest] for first, *rest in body]
    lines = [_line(head), _line(["---"] * len(head)), *map(_line, bold)]
    command = f"`fjr compare {document['suite']['name']}`"
    legend = f"*{command}. {DASH}: does not track the nominal robot.*"
    counts = ["", best_in(document)] if document["suite"]["tune"] else []
    return "\n".join([extent(document), "", *lines, "", legend, *counts, ""])


def cells(document: dict[str, Any]) -> list[list[str]]:
    """Return the cells of the table: a head with the laws, and for each robot its name alone and its rows."""
    names = [str(law["title"]) for law in document["laws"]]
    found = [["", *names]]
    for robot in document["robots"]:
        found.append([robot, *[""] * len(names)])
        found += [_row(row) for row in table_rows(document) if row.robot == robot]
    return found


def _row(row: Row) -> list[str]:
    what = "RMS error [mrad]" if row.group.startswith("errors") else row.what
    return [what, *(value.words for value in row.values)]


def _line(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"
