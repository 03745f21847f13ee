# SPDX-License-Identifier: Apache-2.0
"""What a comparison found, in sentences made from its rows: above all where another law is better than ours."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from fjr_bringup.compare_rows import OURS, TIE, Row, rows
from fjr_bringup.suite import NOMINAL
from fjr_bringup.words import plural


def count(document: dict[str, Any], column: int | None = None) -> tuple[int, int]:
    """In how many rows no other law is better than a column (ours), and of how many."""
    found = rows(document)
    return _unbeaten(found, ours_of(document) if column is None else column, document), len(found)


def _unbeaten(found: Sequence[Row], column: int, document: dict[str, Any]) -> int:
    others = _others(document, column)
    return sum(row.counts(column) and row.behind(column, others) is None for row in found)


def _others(document: dict[str, Any], column: int) -> list[int]:
    """The columns of other laws: the same law with options is none."""
    laws = document["laws"]
    return [i for i, law in enumerate(laws) if law["law"] != laws[column]["law"]]


@dataclass(frozen=True)
class Finding:
    """Of one robot: how often ours is not beaten, and which law is better in what."""

    robot: str
    sentence: str
    better: Mapping[str, Sequence[str]]

    def __str__(self) -> str:
        listed = "; ".join(f"{law} in {', '.join(what)}" for law, what in self.better.items())
        return f"{self.robot}: {self.sentence}{f' Better than it: {listed}.' if listed else ''}"


def findings(document: dict[str, Any]) -> list[Finding]:
    """One for each robot."""
    found = rows(document)
    return [_finding(robot, [row for row in found if row.robot == robot], document) for robot in document["robots"]]


def _finding(robot: str, found: Sequence[Row], document: dict[str, Any]) -> Finding:
    titles, ours = [str(law["title"]) for law in document["laws"]], ours_of(document)
    ratios: dict[str, dict[str, list[float]]] = {}
    for row in found:
        beaten = row.behind(ours, _others(document, ours))
        if beaten is not None:
            ratios.setdefault(titles[beaten[0]], {}).setdefault(_named(row), []).append(beaten[1])
    better = {law: [f"{what} ({_times(each)})" for what, each in items.items()] for law, items in ratios.items()}
    return Finding(robot, _sentence(found, ours, document), better)


def _sentence(found: Sequence[Row], ours: int, document: dict[str, Any]) -> str:
    """In how many rows ours is not beaten, without options and with each."""
    laws = document["laws"]
    columns = [i for i, law in enumerate(laws) if law["law"] == laws[ours]["law"]]
    told = [f"{laws[i]['title']} in {_unbeaten(found, i, document)}" for i in columns]
    return f"Of {plural(len(found), 'row')}, no other law beats (by more than {100 * TIE:g} %) {', '.join(told)}."


def _named(row: Row) -> str:
    kind = row.group.partition(" ")[0]
    if kind == "margins":
        return row.what.removesuffix(" to")
    if kind == "errors":
        return "nominal error" if row.what == NOMINAL else f"error with {row.what}"
    return row.what


def _times(ratios: Sequence[float]) -> str:
    """How many times better: the most of all references."""
    most = max(ratios)
    if most == math.inf:
        return "ours does not track"
    words = f"{most:.2g}" if most < 100 else f"{most:.0f}"
    return f"{'up to ' if len(ratios) > 1 else ''}{words} times"


def ours_of(document: dict[str, Any]) -> int:
    """Which column is ours: the first with v-dPBC, else the first of all."""
    laws = [law["law"] for law in document["laws"]]
    return laws.index(OURS) if OURS in laws else 0
