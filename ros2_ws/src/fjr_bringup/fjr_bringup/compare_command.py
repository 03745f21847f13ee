# SPDX-License-Identifier: Apache-2.0
"""`fjr compare SUITE`: run what is not yet kept, write page and figures, say how much was compared."""

from __future__ import annotations

import json
import os
import threading
from pathlib import Path

from fjr_bringup import (
    compare_document,
    compare_job,
    compare_page,
    compare_readme,
    compare_run,
    suite,
)

PAGE, FIGURES, KEPT = "comparison.html", "comparison.json", "kept"


def compare(name: str, output: Path, cores: int | None, page: Path | None, stop: threading.Event) -> str:
    """Compare a suite's laws; returns what to tell. Raises FjrError, and Interrupted when `stop` is set.

    Results go to output/compare_<suite>/: comparison.html, comparison.json, and kept/ with what need not be run again.
    page: a Markdown document into which the table is written, between its marks.
    """
    chosen = suite.load(suite.find(name))
    if page is not None:
        compare_readme.check(page)
    jobs = compare_job.jobs(chosen)
    folder = output / f"compare_{chosen.name}"
    results = compare_run.run(jobs, folder / KEPT, cores or len(os.sched_getaffinity(0)), stop)
    document = compare_document.document(chosen, jobs, results)
    (folder / FIGURES).write_text(json.dumps(document, allow_nan=False) + "\n", encoding="utf-8")
    compare_page.write_page(folder / PAGE, document)
    if page is not None:
        compare_readme.replace(page, document)
    return f"{compare_document.extent(document)}\npage and figures: {folder / PAGE}, {FIGURES}"
