# SPDX-License-Identifier: Apache-2.0
"""`fjr sweep`: run or resume the sweep of a scenario or sweep file, and report it.

Beside the files of any study (study.py) its folder has summary.json, overview.png and report.html.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

from fjr_core.files.text_file import write_text
from fjr_msgs_py.console.ending import Interrupted
from fjr_msgs_py.console.output import Result, json_text, number, percent, plural, progress_bar

from .sensitivity import Summary, summarised
from .study import Columns, Store, Workers, divided, open_store
from .sweep import OUTCOMES, Sweep, run_part
from .sweep_file import Options, planned
from .sweep_page import sweep_plots, write_overview, write_page

PROGRESS = "{desc}: {percentage:3.0f}% |{bar}| {n}/{total} runs, {rate_fmt}, {remaining} left"
IN_PYTHON = "law or plant are evaluated in Python: the runs are not compiled, and --cores does not speed them up"
ENOUGH = 200
"""Number of runs from which the sensitivities are significant."""
SHOWN = ("rms", "peak", "final", "settling", "effort_peak", "power")
LARGEST_PART, SMALLEST_PART, PARTS = 1000, 10, 200


def sweep(name: str | None, options: Options, stop: threading.Event) -> Result:
    """Run or resume a sweep, write table, summary, figure and page; return a summary. Raise FjrError, Interrupted."""
    plan = planned(name, options)
    check_and_warn(plan)
    if plan.loop.in_python:
        print(f"fjr: {IN_PYTHON}", file=sys.stderr)
    with open_store(options.output / plan.name, plan.text, plan.loop.fingerprint) as store:
        with options.workers(plan) as workers:
            _carry_out(plan, store, workers, stop)
        return _shown(plan, store)


def check_and_warn(plan: Sweep) -> None:
    """Raise ParameterError for friction that is too stiff; name identified parameters that are not drawn."""
    plan.refuse_stiff_friction()
    if plan.identified is not None and plan.identified.left_out:
        print(f"fjr: identified, but not drawn: {', '.join(plan.identified.left_out)}", file=sys.stderr)


def _carry_out(plan: Sweep, store: Store, workers: Workers, stop: threading.Event) -> None:
    left = sum(end - begin for begin, end in missing_parts(plan, store))
    if left < plan.runs:
        print(f"{plan.name}: {plan.runs - left} of {plan.runs} runs are finished already", file=sys.stderr, flush=True)
    if left:
        line = f"{plan.name}: {plural(left, 'run')} on {plural(workers.count, 'core')}"
        done = plan.runs - left
        with progress_bar(line, PROGRESS, total=plan.runs, initial=done, desc=plan.name, unit=" runs") as bar:
            if not run_missing(plan, store, workers, bar.update, stop):
                raise Interrupted(store.folder)
    complete(plan, store)


def parts_of(plan: Sweep) -> list[tuple[int, int]]:
    """Return (begin, end) of the parts into which a sweep is divided."""
    return divided(0, plan.runs, min(LARGEST_PART, max(SMALLEST_PART, plan.runs // PARTS)))


def missing_parts(plan: Sweep, store: Store) -> list[tuple[int, int]]:
    """Return the parts that are not finished, in their order."""
    return [] if store.table.exists() else [part for part in parts_of(plan) if not store.holds(_key(*part))]


def run_missing(
    plan: Sweep, store: Store, workers: Workers, on_progress: Callable[[int], object], stop: threading.Event
) -> bool:
    """Run the missing parts and store each when finished; return whether all are stored (not if `stop` was set).

    on_progress: called with the number of runs of each stored part.
    """

    def keep(job: tuple[str, int, int], columns: Columns) -> None:
        _, begin, end = job
        store.keep(_key(begin, end), columns)
        on_progress(end - begin)

    return workers.run(run_part, [(plan.text, *part) for part in missing_parts(plan, store)], keep, stop)


def complete(plan: Sweep, store: Store) -> Path:
    """Merge the parts of a finished sweep into its table and remove them; return its path."""
    if not store.table.exists():
        store.write_table([_key(*part) for part in parts_of(plan)])
    store.remove_parts()
    return store.table


def _key(begin: int, end: int) -> str:
    return f"{begin:09d}-{end:09d}"


def _shown(plan: Sweep, store: Store) -> Result:
    summary = summarised(plan, store.column)
    write_text(store.folder / "summary.json", json_text(asdict(summary), indent=1) + "\n")
    plots = sweep_plots(plan, store.column, summary)
    write_overview(plan, summary, plots, store.folder / "overview.png")
    page = write_page(plan, summary, plots, store.folder / "report.html")
    text = f"{table(plan, summary)}\nopen {page}; all runs: {store.table}"
    return Result(text, {**asdict(summary), "page": page, "table": store.table})


def table(plan: Sweep, summary: Summary) -> str:
    """Format the results as a table."""
    share = f"{percent(summary.succeeded / summary.runs)} of {summary.runs} succeed"
    stopped = f", a limit stopped {summary.stopped}" if summary.stopped else ""
    interval = f"(95 %: {percent(summary.low)} to {percent(summary.high)})"
    lines = [
        f"{plan.name}: {share} {interval}, {summary.stable} are stable{stopped}",
        f"  {'':14}{'median':>12}{'95 %':>12}{'99 %':>12}{'worst':>12}",
    ]
    for name in SHOWN:
        values = "".join(f"{number(value):>12}" for value in summary.quantiles[name])
        lines.append(f"  {name:14}{values} {OUTCOMES[name][1]}")
    hint = "most influential" if summary.runs >= ENOUGH else "most influential (estimate)"
    lines.append(f"  {hint:28}{'success':>10}{'rms error':>12}")
    for effect in summary.effects[:5]:
        lines.append(f"  {effect.name:28}{percent(effect.success, 0):>10}{percent(effect.error, 0):>12}")
    return "\n".join(lines)
