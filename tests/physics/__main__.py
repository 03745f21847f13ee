# SPDX-License-Identifier: Apache-2.0
"""Identify arms whose physics the product does not share and print a table: `python -m tests.physics [WORD ...]`.

    python -m tests.physics [--coverage | --causes | --sysid] [--draws 30] [--joints 2] [--out FILE] [WORD ...]

The workspace must be sourced. With words, only cases whose name contains one of them. A draw takes a second to a
minute, of --causes a second, of --sysid ten. With --out, each batch is added to the file as it ends, one of each case
before the second of any. The same command goes on with what the present estimator has not done.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from contextlib import ExitStack
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT)]
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import fjr_identification  # noqa: E402
from fjr_core.numerics.jit import program_digest  # noqa: E402
from fjr_msgs_py.console.output import progress_bar  # noqa: E402
from physics.coverage import CASES, Interval  # noqa: E402

FORM = "{desc}: {percentage:3.0f}% |{bar}| {elapsed}"
BATCH = 5  # draws that one process integrates together, in little more time than one

CODE = program_digest(*(Path(name).parent for name in (fjr_identification.__file__, __file__)))
"""Of estimator and physics: results of other code do not count."""
Job = tuple[str, int, int, int]
"""Name of a case, number of joints, number of draws, and seed."""


def main(words: list[str]) -> int:
    """Print the table; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.physics", description="Physics that is not our own.")
    tables = parser.add_mutually_exclusive_group()
    for module, text in (
        ("coverage", "how many intervals contain the truth (default)"),
        ("causes", "which cause of a lack of fit is named"),
        ("sysid", "the same beside mujoco.sysid"),
    ):
        tables.add_argument(f"--{module}", dest="table", action="store_const", const=module, help=text)
    parser.add_argument("--draws", type=int, default=30, help="records of each case and number of joints")
    parser.add_argument("--joints", type=int, nargs="+", default=[2], help="numbers of joints (default: 2)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=2, help="0: print what --out has")
    parser.add_argument("--out", type=Path, metavar="FILE", help="results, from which the same command goes on")
    parser.add_argument("words", nargs="*", metavar="WORD", help="only cases whose name contains one of these")
    given = parser.parse_args(words)
    names = [name for name in CASES if not given.words or any(word in name for word in given.words)]
    batches = [min(BATCH, given.draws - first) for first in range(0, given.draws, BATCH)]
    jobs = [(name, n, count, given.seed + k) for k, count in enumerate(batches) for name in names for n in given.joints]
    kind = given.table or "coverage"
    table, results = import_module(f"physics.{kind}"), _finished(given.out, kind)
    left = [job for job in jobs if job not in results] if given.processes else []
    with ExitStack() as stack:
        compute = stack.enter_context(get_context("spawn").Pool(given.processes)).imap if given.processes > 1 else map
        bar = stack.enter_context(progress_bar("identifying", FORM, total=len(left)))
        for job, result in zip(left, compute(table.of_batch, left), strict=True):
            results[job] = result
            bar.update()
            if given.out:
                text = json.dumps({"code": CODE, "kind": kind, "job": job, "of": result}, default=vars)
                with given.out.open("a", encoding="utf-8") as file:
                    file.write(f"{text}\n")
    done = {name: [_of(results, jobs, name, n) for n in given.joints] for name in names}
    done = {name: of_number for name, of_number in done.items() if any(of_number)}
    print(table.head(given.joints))
    for name, of_number in done.items():
        print(table.line(name, of_number))
    if len(done) > 1:
        print(table.line("together", [sum(of_n, []) for of_n in zip(*done.values(), strict=True)]))
    return 0


def _of(results: dict[Job, list[Any]], jobs: list[Job], name: str, n: int) -> list[Any]:
    """Return what is done of the draws of a case with n joints."""
    return [result for job in jobs if job[:2] == (name, n) for result in results.get(job, [])]


def _finished(file: Path | None, kind: str) -> dict[Job, list[Any]]:
    """Return what the present estimator has done of a table."""
    if file is None or not file.exists():
        return {}
    lines = [json.loads(line, object_hook=_interval) for line in file.read_text(encoding="utf-8").splitlines()]
    return {tuple(line["job"]): line["of"] for line in lines if (line["code"], line["kind"]) == (CODE, kind)}


def _interval(values: dict[str, Any]) -> Any:
    return Interval(**values) if "away" in values else values


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
