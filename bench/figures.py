# SPDX-License-Identifier: Apache-2.0
"""Figures with their bounds, calls timed alternately (A B A B ...), results of long studies, tables of docs/tables."""

from __future__ import annotations

import gc
import json
import os
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from timeit import timeit
from typing import Any

import numpy as np

from fjr_core.numerics.checks import Array
from fjr_msgs_py.console.output import aligned

ROOT = Path(__file__).resolve().parents[1]
TABLES = ROOT / "docs" / "tables"
HEADINGS = ("figure", "measured", "bound", "aim", "holds", "from")
REPEATS = 41
BLOCK = 5e-3  # s; approximate duration of a block of calls
Call = Callable[[], object]


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
        return {**asdict(self), "holds": None if self.bound is None else self.holds}

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


def table(figures: Sequence[Figure]) -> str:
    """Format all figures as a table, one per line."""
    heading, *lines = aligned([HEADINGS, *(figure.row() for figure in figures)])
    return "\n".join([heading, "-" * len(heading), *lines])


def page(document: Mapping[str, Any]) -> str:
    """Format the figures of bench.json as a page in Markdown."""
    figures = [{name: each[name] for name in each if name != "holds"} for each in document["figures"]]
    processor, cores, _, python = document["machine"].rsplit(", ", 3)
    said = f"{processor}, {cores}, {python}, {document['date'][:10]}."
    lines = markdown(HEADINGS, [Figure(**each).row() for each in figures])
    return "\n".join(["# Benchmark figures", "", f"Written by `make bench`. {said}", "", *lines, ""])


@contextmanager
def one_core() -> Iterator[None]:
    """Pin this process to one core, if the system allows it, and disable the garbage collector."""
    allowed = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
    if allowed:
        os.sched_setaffinity(0, {max(allowed)})
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        if allowed:
            os.sched_setaffinity(0, allowed)


def in_turns(calls: Mapping[str, Call], repeats: int = REPEATS) -> dict[str, Array]:
    """Return seconds per call of each, one entry per repeat.

    Blocks of the calls alternate, so that a slower machine affects all of them.
    """
    with one_core():
        counts = {name: _block_size(call) for name, call in calls.items()}
        rounds = [
            [timeit(call, number=counts[name]) / counts[name] for name, call in calls.items()] for _ in range(repeats)
        ]
    return dict(zip(calls, np.array(rounds).T, strict=True))


def ratio(ours: Array, theirs: Array) -> float:
    """Return the median over the repeats of ours / theirs."""
    return float(np.median(ours / theirs))


def microseconds(times: Mapping[str, Array]) -> dict[str, float]:
    """Return the medians [us]."""
    return {f"{name} [us]": 1e6 * float(np.median(seconds)) for name, seconds in times.items()}


def _block_size(call: Call) -> int:
    """Return the number of calls that take about BLOCK, after a warm-up call."""
    call()
    count = 1
    while timeit(call, number=count) < BLOCK:
        count *= 2
    return count


def kept(file: Path, result: Callable[[], Any]) -> Any:
    """Return the result in a JSON file; compute and write it, whole or not at all, if there is none.

    A study of such files goes on where it ended, and any number of processes share its work.
    """
    if not file.exists():
        file.parent.mkdir(parents=True, exist_ok=True)
        part = file.with_suffix(f".{os.getpid()}")
        part.write_text(json.dumps(result()), encoding="utf-8")
        part.replace(file)
    return json.loads(file.read_text(encoding="utf-8"))


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]], right: Collection[str] = ()) -> list[str]:
    """Return the lines of a Markdown table; right: columns that are aligned on the right."""
    rule = ["---:" if name in right else "---" for name in head]
    return [f"| {' | '.join(row)} |" for row in (head, rule, *rows)]


def placed(page: str, name: str) -> str:
    """Return what stands between `<!-- NAME: ... -->` and `<!-- end of NAME -->` on a page of docs/tables."""
    return _parted(page, name)[1]


def put(page: str, name: str, lines: Iterable[str]) -> None:
    """Replace what stands between the marks of a name on a page of docs/tables; raise ValueError without them."""
    before, _, after = _parted(page, name)
    (TABLES / page).write_text("\n".join([before, "", *lines, "", after]), encoding="utf-8")


def _parted(page: str, name: str) -> tuple[str, str, str]:
    """Return a page up to the first mark, between both, and from the second on."""
    pattern = rf"(.*<!-- {re.escape(name)}: [^\n]*-->)\n(.*)(<!-- end of {re.escape(name)} -->.*)"
    found = re.fullmatch(pattern, (TABLES / page).read_text(encoding="utf-8"), re.DOTALL)
    if found is None:
        raise ValueError(f"{page} lacks '<!-- {name}: ... -->' and '<!-- end of {name} -->'; expected both")
    return found[1], found[2], found[3]
