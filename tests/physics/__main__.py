# SPDX-License-Identifier: Apache-2.0
"""Identify arms whose physics the product does not share and print the coverage: `python -m tests.physics [WORD ...]`.

    python -m tests.physics [--draws 30] [--joints 1 2 3] [--seed 0] [--processes 2] [--causes] [WORD ...]

The workspace must be sourced. With words, only cases whose name contains one of them. 30 draws of two joints take about
half a minute on one core. --causes prints which cause of a lack of fit is named instead, which takes a second a draw.
"""

from __future__ import annotations

import argparse
import os
import sys
from multiprocessing import get_context
from pathlib import Path
from typing import Any

TESTS = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(TESTS))
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

from fjr_msgs_py.console.output import progress_bar  # noqa: E402
from physics import coverage, named  # noqa: E402
from physics.coverage import CASES  # noqa: E402

FORM = "{desc}: {percentage:3.0f}% |{bar}| {elapsed}"
BATCH = 40  # draws that one process integrates together, in little more time than one


def main(words: list[str]) -> int:
    """Print the table; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.physics", description="Coverage on physics of our own.")
    parser.add_argument("--draws", type=int, default=30, help="records of each case and number of joints")
    parser.add_argument("--joints", type=int, nargs="+", default=[2], help="numbers of joints (default: 2)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--causes", action="store_true", help="print which cause of a lack of fit is named")
    parser.add_argument("words", nargs="*", metavar="WORD", help="only cases whose name contains one of these")
    given = parser.parse_args(words)
    names = [name for name in CASES if not given.words or any(word in name for word in given.words)]
    batches = [min(BATCH, given.draws - first) for first in range(0, given.draws, BATCH)]
    table = named if given.causes else coverage
    print(named.head(given.joints) if given.causes else coverage.head(), flush=True)
    with (
        get_context("spawn").Pool(given.processes) as pool,
        progress_bar("identifying", FORM, total=len(names) * len(given.joints) * given.draws) as bar,
    ):
        for name in names:
            jobs = [(name, n, count, given.seed + k) for n in given.joints for k, count in enumerate(batches)]
            results: dict[int, list[Any]] = {n: [] for n in given.joints}
            bar.set_description(name)
            for (_, n, _, _), batch in zip(jobs, pool.imap(table.of_batch, jobs), strict=True):
                results[n] += batch
                bar.update(len(batch))
            print(table.line(name, list(results.values())), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
