# SPDX-License-Identifier: Apache-2.0
"""`fjr sweep`: run or resume the sweep of a scenario or sweep file, and report it.

Its folder holds finished parts as Parquet files, written atomically, and finally one table:

campaign.json      specification of the sweep and hash of the program
parts/             <begin>-<end>.parquet of finished parts
table.parquet      all runs in order, once all parts are finished
"""

from __future__ import annotations

import json
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from fjr_core.files.text_file import is_sealed, whole_file
from fjr_msgs_py.console.ending import Interrupted
from fjr_msgs_py.console.output import Result, number, percent, plural, progress_bar

from .sensitivity import Summary, summarised
from .study import StoreError, Workers, cluster, opened, threads
from .sweep import Columns, Sweep, run_part
from .sweep_file import Options, planned
from .sweep_page import draw, sweep_plots, write_page

PROGRESS = "{desc}: {percentage:3.0f}% |{bar}| {n}/{total} runs, {rate_fmt}, {remaining} left"
IN_PYTHON = "law or plant are evaluated in Python: the runs are not compiled, and --cores does not speed them up"
ENOUGH = 200
"""Number of runs from which the sensitivities are significant."""
UNITS = {"rms": "rad", "peak": "rad", "final": "rad", "settling": "s", "effort_peak": "N m", "power": "W"}
LARGEST_PART, SMALLEST_PART, PARTS = 1000, 10, 200


@dataclass(frozen=True)
class Store:
    """Folder of a sweep; create it by `open_store`."""

    folder: Path
    sweep: Sweep

    @property
    def table(self) -> Path:
        """Path of the table of all runs."""
        return self.folder / "table.parquet"

    def parts(self) -> list[tuple[int, int]]:
        """Return (begin, end) of the parts into which the sweep is divided."""
        runs = self.sweep.runs
        size = min(LARGEST_PART, max(SMALLEST_PART, runs // PARTS))
        return [(begin, min(begin + size, runs)) for begin in range(0, runs, size)]

    def missing(self) -> Iterator[tuple[int, int]]:
        """Yield the missing parts (begin, end) in order."""
        all_parts = [] if self.table.exists() else self.parts()
        return (part for part in all_parts if not is_sealed(self._file(*part)))

    def finished(self) -> int:
        """Return the number of finished runs."""
        if self.table.exists():
            return self.sweep.runs
        return sum(end - begin for begin, end in self.parts() if is_sealed(self._file(begin, end)))

    def keep(self, begin: int, end: int, columns: Columns) -> None:
        """Write a part atomically."""
        path = self._file(begin, end)
        with whole_file(path, sealed=True) as scratch:
            pq.write_table(pa.table(columns), scratch, compression="zstd")

    def complete(self) -> Path:
        """Merge all parts into one table and remove them; return its path."""
        if not self.table.exists():
            files = [self._file(*part) for part in self.parts()]
            with (
                whole_file(self.table, sealed=True) as scratch,
                pq.ParquetWriter(scratch, pq.read_schema(files[0]), compression="zstd") as writer,
            ):
                for file in files:
                    writer.write_table(pq.read_table(file))
        for file in (self.folder / "parts").glob("*"):
            file.unlink()
        return self.table

    def column(self, name: str) -> NDArray[Any]:
        """Return a column of the table (runs,)."""
        return np.asarray(pq.read_table(self.table, columns=[name]).column(0).to_numpy())

    def _file(self, begin: int, end: int) -> Path:
        return self.folder / "parts" / f"{begin:09d}-{end:09d}.parquet"


@contextmanager
def open_store(folder: Path, sweep: Sweep, program: str) -> Iterator[Store]:
    """Open or create the store of a sweep, locked for this process.

    program: hash of the code that computes the results. Raise StoreError.
    """
    (folder / "parts").mkdir(parents=True, exist_ok=True)

    def holds_runs() -> bool:
        return any(folder.glob("*.parquet")) or any(folder.glob("parts/*.parquet"))

    with opened(folder / "campaign.json", json.loads(sweep.text), program, holds_runs, "fjr sweep"):
        for left in folder.rglob("*.part"):
            left.unlink()
        store = Store(folder, sweep)
        if store.table.exists() and not is_sealed(store.table):
            raise StoreError(
                f"{store.table} is not what `fjr sweep` wrote (its SHA-256 digest differs); expected it unchanged, or "
                "removed to compute it again"
            )
        yield store


def sweep(name: str | None, options: Options, stop: threading.Event) -> Result:
    """Run or resume a sweep, write table, summary, figure and page; return a summary. Raise FjrError, Interrupted."""
    plan = planned(name, options)
    check_and_warn(plan)
    if options.scheduler is None:
        plan.loop.build()
    if plan.loop.in_python:
        print(f"fjr: {IN_PYTHON}", file=sys.stderr)
    folder = options.output / plan.name
    with open_store(folder, plan, plan.loop.fingerprint) as store:
        with cluster(options.scheduler) if options.scheduler else threads(options.cores) as workers:
            _carry_out(store, workers, stop)
        store.complete()
        return _shown(store)


def check_and_warn(plan: Sweep) -> None:
    """Raise ParameterError for friction that is too stiff; name identified parameters that are not drawn."""
    plan.refuse_stiff_friction()
    if plan.identified is not None and plan.identified.left_out:
        print(f"fjr: identified, but not drawn: {', '.join(plan.identified.left_out)}", file=sys.stderr)


def _carry_out(store: Store, workers: Workers, stop: threading.Event) -> None:
    total, there = store.sweep.runs, store.finished()
    if there:
        print(f"{store.sweep.name}: {there} of {total} runs are finished already", file=sys.stderr, flush=True)
    if there == total:
        return
    line = f"{store.sweep.name}: {plural(total - there, 'run')} on {plural(workers.count, 'core')}"
    with progress_bar(line, PROGRESS, total=total, initial=there, desc=store.sweep.name, unit=" runs") as bar:
        whole = run_missing(store, workers, bar.update, stop)
    if not whole:
        raise Interrupted(store.folder)


def run_missing(store: Store, workers: Workers, on_progress: Callable[[int], object], stop: threading.Event) -> bool:
    """Run the missing parts and store each when finished; return whether all are stored (not if `stop` was set).

    on_progress: called with the number of runs of each stored part.
    """

    def keep(job: tuple[str, int, int], columns: Columns) -> None:
        _, begin, end = job
        store.keep(begin, end, columns)
        on_progress(end - begin)

    text = store.sweep.text
    return workers.run(run_part, ((text, *part) for part in store.missing()), keep, stop)


def _shown(store: Store) -> Result:
    summary = summarised(store.sweep, store.column)
    figures = store.folder / "summary.json"
    figures.write_text(json.dumps(summary.as_json(), indent=1) + "\n", encoding="utf-8")
    plots = sweep_plots(store.sweep, store.column, summary)
    draw(store.sweep, summary, plots, store.folder / "overview.png")
    page = write_page(store.sweep, summary, plots, store.folder / "report.html")
    text = f"{table(store.sweep, summary)}\nopen {page}; all runs: {store.table}"
    return Result(text, {**summary.as_json(), "page": page, "table": store.table})


def table(plan: Sweep, summary: Summary) -> str:
    """Format the results as a table."""
    share = f"{percent(summary.succeeded / summary.runs)} of {summary.runs} succeed"
    stopped = f", a limit stopped {summary.stopped}" if summary.stopped else ""
    interval = f"(95 %: {percent(summary.low)} to {percent(summary.high)})"
    lines = [
        f"{plan.name}: {share} {interval}, {summary.stable} are stable{stopped}",
        f"  {'':14}{'median':>12}{'95 %':>12}{'99 %':>12}{'worst':>12}",
    ]
    for name, unit in UNITS.items():
        values = "".join(f"{number(value):>12}" for value in summary.quantiles[name])
        lines.append(f"  {name:14}{values} {unit}")
    hint = "most influential" if summary.runs >= ENOUGH else "most influential (estimate)"
    lines.append(f"  {hint:28}{'success':>10}{'rms error':>12}")
    for effect in summary.effects[:5]:
        lines.append(f"  {effect.name:28}{percent(effect.success, 0):>10}{percent(effect.error, 0):>12}")
    return "\n".join(lines)
