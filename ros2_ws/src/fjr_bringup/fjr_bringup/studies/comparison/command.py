# SPDX-License-Identifier: Apache-2.0
"""`fjr compare SUITE`: run the missing cases, write results and page, return a summary."""

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

PAGE, RESULTS, CACHE = "comparison.html", "comparison.json", "kept"


def compare(name: str, output: Path, cores: int | None, page: Path | None, stop: threading.Event) -> str:
    """Compare the laws of a suite; return a summary. Raise FjrError, and Interrupted when `stop` is set.

    Results go to output/compare_<suite>/: comparison.html, comparison.json, and kept/ with finished jobs, which are not
    run again. page: Markdown document whose table between the markers is replaced.
    """
    chosen = suite.load(suite.find(name))
    if page is not None:
        comparison_markdown.check(page)
    jobs = comparison_job.jobs(chosen)
    folder = output / f"compare_{chosen.name}"
    results = comparison_pool.run(jobs, folder / CACHE, cores or len(os.sched_getaffinity(0)), stop)
    document = comparison_results.document(chosen, jobs, results)
    (folder / RESULTS).write_text(json.dumps(document, allow_nan=False) + "\n", encoding="utf-8")
    comparison_report.write_page(folder / PAGE, document)
    if page is not None:
        comparison_markdown.replace(page, document)
    return f"{comparison_results.extent(document)}\npage and figures: {folder / PAGE}, {RESULTS}"
