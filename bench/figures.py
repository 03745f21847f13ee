# SPDX-License-Identifier: Apache-2.0
"""Measured figures with their bounds, as a table, and tables between the markers of a page."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

TABLES = Path(__file__).resolve().parents[1] / "docs" / "tables"

FIELDS = ("name", "value", "unit", "bound", "aim", "at_least", "parts")
HEADINGS = ("figure", "measured", "bound", "aim", "holds", "from")


@dataclass(frozen=True)
class Figure:
    """A measured value with an optional required bound and desired aim.

    parts: the values from which it was computed, by name with unit, e.g. {"law [us]": 2.4}.
    """

    name: str
    value: float
    unit: str
    bound: float | None = None
    aim: float | None = None
    at_least: bool = False
    parts: dict[str, float] = field(default_factory=dict)

    @property
    def holds(self) -> bool:
        """Return whether the bound is met; True without a bound."""
        return self._reaches(self.bound)

    def as_json(self) -> dict[str, object]:
        """Return the figure as plain values."""
        holds = None if self.bound is None else self.holds
        limits = {"bound": self.bound, "aim": self.aim, "at_least": self.at_least, "holds": holds}
        return {"name": self.name, "value": self.value, "unit": self.unit, **limits, "parts": self.parts}

    def row(self) -> tuple[str, ...]:
        """Return the cells below HEADINGS."""
        measured = f"{self.value:.3g} {self.unit}".strip()
        parts = ", ".join(f"{name} {value:.3g}" for name, value in self.parts.items())
        return (self.name, measured, self._limit(self.bound), self._limit(self.aim), self._verdict(), parts)

    def _verdict(self) -> str:
        if self.bound is None:
            return ""
        if not self.holds:
            return "NO"
        return "yes" if self.aim is None or self._reaches(self.aim) else "yes, not the aim"

    def _reaches(self, limit: float | None) -> bool:
        return limit is None or (self.value >= limit if self.at_least else self.value <= limit)

    def _limit(self, limit: float | None) -> str:
        return "" if limit is None else f"{'>=' if self.at_least else '<='} {limit:g}"


def page(document: Mapping[str, Any]) -> str:
    """Format the figures of bench.json as a page in Markdown."""
    figures = [Figure(**{name: each[name] for name in FIELDS}) for each in document["figures"]]
    processor, cores, _, python = document["machine"].rsplit(", ", 3)
    said = f"{processor}, {cores}, {python}, {document['date'][:10]}."
    lines = markdown(HEADINGS, [figure.row() for figure in figures])
    return "\n".join(["# Benchmark figures", "", f"Written by `make bench`. {said}", "", *lines, ""])


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]], right: Collection[str] = ()) -> list[str]:
    """Return the lines of a Markdown table; right: columns that are aligned on the right."""
    rule = ["---:" if name in right else "---" for name in head]
    return [f"| {' | '.join(row)} |" for row in (head, rule, *rows)]


def table(figures: Sequence[Figure]) -> str:
    """Format all figures as a table, one per line."""
    rows = [HEADINGS, *(figure.row() for figure in figures)]
    widths = [max(len(row[i]) for row in rows) for i in range(len(HEADINGS))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    return "\n".join([lines[0], "  ".join("-" * width for width in widths), *lines[1:]])


def put(lines: Sequence[str], page: str, begin: str, end: str) -> None:
    """Replace what is between two markers of a page of docs/tables; raise ValueError without the markers."""
    path = TABLES / page
    before, rest = path.read_text(encoding="utf-8").split(begin)
    _, after = rest.split(end, 1)
    path.write_text("\n".join([before + begin, *lines, end + after]), encoding="utf-8")
