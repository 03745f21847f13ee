# SPDX-License-Identifier: Apache-2.0
"""`fjr sweep`: run or resume the sweep of a scenario or sweep file, and report it.

Beside the files of any study (study.py) its folder has summary.json, overview.png and report.html.
"""

from __future__ import annotations

import sys
import threading
from dataclasses import asdict
from pathlib import Path

from fjr_core.files.text_file import write_text
from fjr_msgs_py.console.output import Result, json_text, number, percent, plural, progress_bar

from .sensitivity import Summary, summarised
from .study import Store, Workers, divided, open_store
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
            carry_out(plan, store, workers, stop)
        return _shown(plan, store)


def check_and_warn(plan: Sweep) -> None:
    """Raise ParameterError for friction that is too stiff; name identified parameters that are not drawn."""
    plan.refuse_stiff_friction()
    if plan.identified is not None and plan.identified.left_out:
        print(f"fjr: identified, but not drawn: {', '.join(plan.identified.left_out)}", file=sys.stderr)


def jobs_of(plan: Sweep) -> dict[str, tuple[str, int, int]]:
    """Return the jobs of a sweep by their keys: its text, and (begin, end) of a part of its runs."""
    parts = divided(0, plan.runs, min(LARGEST_PART, max(SMALLEST_PART, plan.runs // PARTS)))
    return {f"{begin:09d}-{end:09d}": (plan.text, begin, end) for begin, end in parts}


def carry_out(plan: Sweep, store: Store, workers: Workers, stop: threading.Event) -> Path:
    """Run the jobs of a sweep that are not finished and merge all into its table; return its path.

    Raise Interrupted if `stop` is set.
    """
    jobs = {} if store.table.exists() else jobs_of(plan)
    left = sum(end - begin for key, (_, begin, end) in jobs.items() if not store.holds(key))
    done = plan.runs - left
    if done:
        print(f"{plan.name}: {done} of {plan.runs} runs are finished already", file=sys.stderr, flush=True)
    if left:
        line = f"{plan.name}: {plural(left, 'run')} on {plural(workers.count, 'core')}"
        with progress_bar(line, PROGRESS, total=plan.runs, initial=done, desc=plan.name, unit=" runs") as bar:
            store.run(workers, run_part, jobs, stop, bar.update)
    if jobs:
        store.write_table(list(jobs))
    store.remove_parts()
    return store.table


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
