# SPDX-License-Identifier: Apache-2.0
"""`fjr compare SUITE`: run what is not yet kept, write page and figures, say how much was compared."""

from __future__ import annotations

import json
import os
import threading
from pathlib import Path

from fjr_bringup.studies.comparison import job as comparison_job
from fjr_bringup.studies.comparison import markdown as comparison_markdown
from fjr_bringup.studies.comparison import pool as comparison_pool
from fjr_bringup.studies.comparison import report as comparison_report
from fjr_bringup.studies.comparison import results as comparison_results
from fjr_bringup.studies.comparison import suite

PAGE, FIGURES, KEPT = "comparison.html", "comparison.json", "kept"


def compare(name: str, output: Path, cores: int | None, page: Path | None, stop: threading.Event) -> str:
    """Compare a suite's laws; returns what to tell. Raises FjrError, and Interrupted when `stop` is set.

    Results go to output/compare_<suite>/: comparison.html, comparison.json, and kept/ with what need not be run again.
    page: a Markdown document into which the table is written, between its marks.
    """
    chosen = suite.load(suite.find(name))
    if page is not None:
        comparison_markdown.check(page)
    jobs = comparison_job.jobs(chosen)
    folder = output / f"compare_{chosen.name}"
    results = comparison_pool.run(jobs, folder / KEPT, cores or len(os.sched_getaffinity(0)), stop)
    document = comparison_results.document(chosen, jobs, results)
    (folder / FIGURES).write_text(json.dumps(document, allow_nan=False) + "\n", encoding="utf-8")
    comparison_report.write_page(folder / PAGE, document)
    if page is not None:
        comparison_markdown.replace(page, document)
    return f"{comparison_results.extent(document)}\npage and figures: {folder / PAGE}, {FIGURES}"
