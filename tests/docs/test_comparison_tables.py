# SPDX-License-Identifier: Apache-2.0
"""Tables of laws tuned alike: README and docs/compare.md repeat numbers of docs/tables/compare.md."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
README, PAGE, TABLES = (
    (ROOT / name).read_text(encoding="utf-8") for name in ("README.md", "docs/compare.md", "docs/tables/compare.md")
)
SUITES = re.findall(r"<!-- fjr compare (\w+_tuned): begin -->\n(.*?)<!-- fjr compare", TABLES, re.DOTALL)
ERROR = "drawn: RMS error [mrad]"
LAWS = 5  # rows of the README


def cells(line: str) -> list[str]:
    return [cell.strip().strip("*") for cell in line.strip().strip("|").split("|")]


def errors() -> dict[str, dict[str, str]]:
    """Return the errors of the tables by robot and law."""
    found: dict[str, dict[str, str]] = {}
    for _, table in SUITES:
        rows = [cells(line) for line in table.splitlines() if line.startswith("|")]
        robot = ""
        for name, *values in rows[2:]:
            robot = name if not any(values) else robot
            if name == ERROR:
                found[robot] = dict(zip(rows[0][1:], values, strict=True))
    return found


def test_the_table_of_the_readme_repeats_errors_of_the_tables() -> None:
    table = README[README.index("| RMS error [mrad]") :].split("\n\n")[0]
    (_, *robots), _, *laws = (cells(line) for line in table.splitlines())
    found = errors()
    assert robots == list(found)
    assert laws == [[law, *(found[robot][law] for robot in robots)] for law, *_ in laws]
    assert len(laws) == LAWS


@pytest.mark.parametrize("page", [PAGE, README], ids=["compare", "README"])
def test_a_page_counts_the_rows_of_each_column_that_the_tables_count(page: str) -> None:
    """The three best columns of all suites, each counted alone."""
    best: Counter[str] = Counter()
    total = 0
    for _, table in SUITES:
        (counts,) = re.findall(r"of the best: (.*) of (\d+) rows", table)
        best.update({name: int(count) for name, count in re.findall(r"([^,]+?) (\d+)(?:, |$)", counts[0])})
        total += int(counts[1])
    (first, most), *others = best.most_common(3)
    text = " ".join(page.split())
    assert f"{first} is best, or within 5 % of the best, in {most} of the {total} rows" in text
    for name, count in others:
        assert f"{name} in {count}" in text
