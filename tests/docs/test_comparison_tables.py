# SPDX-License-Identifier: Apache-2.0
"""Tables of laws tuned alike: the README repeats docs/compare.md, and the page counts what its tables count."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE, README = ((ROOT / name).read_text(encoding="utf-8") for name in ("docs/compare.md", "README.md"))
SUITES = re.findall(r"<!-- fjr compare (\w+_tuned): begin -->\n(.*?)<!-- fjr compare", PAGE, re.DOTALL)
ERROR = "drawn: RMS error [mrad]"


def cells(line: str) -> list[str]:
    return [cell.strip().strip("*") for cell in line.strip().strip("|").split("|")]


def errors() -> dict[str, dict[str, str]]:
    """Return the errors of the page by robot and law."""
    found: dict[str, dict[str, str]] = {}
    for _, table in SUITES:
        rows = [cells(line) for line in table.splitlines() if line.startswith("|")]
        robot = ""
        for name, *values in rows[2:]:
            robot = name if not any(values) else robot
            if name == ERROR:
                found[robot] = dict(zip(rows[0][1:], values, strict=True))
    return found


def test_the_table_of_the_readme_repeats_the_errors_of_the_page() -> None:
    table = README[README.index("| all tuned alike") :].split("\n\n")[0]
    (_, *robots), _, *laws = (cells(line) for line in table.splitlines())
    found = errors()
    assert robots == list(found)
    everywhere = [law for law in found[robots[0]] if all(law in found[robot] for robot in robots)]
    assert laws == [[law, *(found[robot][law] for robot in robots)] for law in everywhere]


def test_the_page_and_the_readme_count_the_rows_that_the_tables_count() -> None:
    lines = [re.search(r"of the best, .*v-dPBC (\d+),.* of (\d+) rows", table) for _, table in SUITES]
    best, rows = (sum(int(line[i]) for line in lines if line) for i in (1, 2))
    assert f"{best} of the {rows} rows" in " ".join(PAGE.split())
    assert f"{best} of the {rows} rows" in " ".join(README.split())
