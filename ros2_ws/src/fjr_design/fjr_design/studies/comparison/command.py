# SPDX-License-Identifier: Apache-2.0
"""`fjr compare SUITE`: run the missing cases, write results and page, return a summary."""

from __future__ import annotations

import json
import os
import sys
import threading
from pathlib import Path

from fjr_core.files.importing import is_named, load
from fjr_core.law.interfaces import StaticLaw
from fjr_design.studies.comparison import job, markdown, pool, report, results, suite
from fjr_msgs_py.console.output import Result
from fjr_msgs_py.scenarios import library

PAGE, RESULTS, CACHE = "comparison.html", "comparison.json", "kept"


def compare(name: str, output: Path, cores: int | None, page: Path | None, stop: threading.Event) -> Result:
    """Compare the laws of a suite; return a summary. Raise FjrError, and Interrupted when `stop` is set.

    Results go to output/compare_<suite>/: comparison.html, comparison.json, and kept/ with finished jobs, which are not
    run again. page: Markdown document whose table between the markers is replaced.
    """
    chosen = suite.load(library.find(name, "suite"))
    if page is not None:
        markdown.check(page, chosen.name)
    for law in chosen.laws:
        if is_named(law.law) and not issubclass(load(law.law), StaticLaw):
            print(
                f"fjr: {law.law} is evaluated in Python: its runs are not compiled, so they take longer",
                file=sys.stderr,
            )
    jobs = job.jobs(chosen)
    folder = output / f"compare_{chosen.name}"
    found = pool.run(jobs, folder / CACHE, cores or len(os.sched_getaffinity(0)), stop)
    document = results.document(chosen, jobs, found)
    (folder / RESULTS).write_text(json.dumps(document, allow_nan=False) + "\n", encoding="utf-8")
    report.write_page(folder / PAGE, document)
    if page is not None:
        markdown.replace(page, document)
    lines = [results.extent(document), "", *_aligned(markdown.cells(document)), ""]
    lines += [results.best_in(document)] if chosen.tune else []
    lines.append(f"page and figures: {folder / PAGE}, {folder / RESULTS}")
    return Result("\n".join(lines), {"page": folder / PAGE, **document})


def _aligned(rows: list[list[str]]) -> list[str]:
    """Return rows of cells as lines with aligned columns."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
