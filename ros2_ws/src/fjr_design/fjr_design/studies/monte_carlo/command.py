# SPDX-License-Identifier: Apache-2.0
"""`fjr sweep`: run or resume a Monte-Carlo study of a scenario or sweep file, and report it."""

from __future__ import annotations

import json
import os
import sys
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fjr_core.config import ros_yaml
from fjr_core.errors import ParameterError
from fjr_design.experiments.monte_carlo.sensitivity import Summary, summarised
from fjr_design.experiments.monte_carlo.sweep import Sweep
from fjr_design.posterior.identification_file import read_identification
from fjr_design.studies.monte_carlo import sweep_file
from fjr_design.studies.monte_carlo.picture import draw
from fjr_design.studies.monte_carlo.pool import Workers, cluster, run_missing, threads
from fjr_design.studies.monte_carlo.report import write_page
from fjr_design.studies.monte_carlo.report_figures import sweep_plots
from fjr_design.studies.monte_carlo.store import Store, open_store
from fjr_design.studies.monte_carlo.sweep_file import SweepFile
from fjr_msgs_py.console.ending import Interrupted
from fjr_msgs_py.console.output import Result, number, percent, plural, progress_bar
from fjr_msgs_py.scenarios import library
from fjr_msgs_py.scenarios.installed import installed

PROGRESS = "{desc}: {percentage:3.0f}% |{bar}| {n}/{total} runs, {rate_fmt}, {remaining} left"
IN_PYTHON = "law or plant are evaluated in Python: the runs are not compiled, and --cores does not speed them up"


@dataclass(frozen=True)
class Options:
    """Cores, or address of a Dask scheduler; output folder; parameters and numbers set on the command line."""

    cores: int
    scheduler: str | None
    output: Path
    overrides: Mapping[str, Any]
    numbers: Mapping[str, Any]


def planned(name: str | None, options: Options) -> Sweep:
    """Return the study to run; raise FjrError."""
    path = file_of(name)
    return described(path, ros_yaml.read(path, "sweep"), options)[0]


def described(path: Path, document: Any, options: Options) -> tuple[Sweep, SweepFile]:
    """Return the study of a parsed file and its description, the usual one for a scenario; raise FjrError."""
    if not sweep_file.is_one(document):
        text, loaded = library.as_run(path, options.overrides)
        usual = sweep_file.usual(path.stem, loaded.sample_period)
        return _sweep(path.stem, text, usual, options), usual
    try:
        file = sweep_file.read(document)
        neighbour = path.parent / file.scenario
        scenario = neighbour if os.path.isfile(neighbour) else library.find(file.scenario)
        text, _ = library.as_run(scenario, {**file.changes, **options.overrides})
        posterior = read_identification(path.parent / file.posterior).as_dict() if file.posterior else None
        return _sweep(path.stem, text, file, options, posterior), file
    except ParameterError as error:
        raise ParameterError(f"sweep {path.stem} {error}") from None


def sweep(name: str | None, options: Options, stop: threading.Event) -> Result:
    """Run the study, write table, summary, figure and page; return a summary. Raise FjrError, Interrupted."""
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


def _shown(store: Store) -> Result:
    summary = summarised(store.sweep, store.column)
    figures = store.folder / "summary.json"
    figures.write_text(json.dumps(summary.as_json(), indent=1) + "\n", encoding="utf-8")
    plots = sweep_plots(store, summary)
    draw(store, summary, plots, store.folder / "overview.png")
    page = write_page(store, summary, plots, store.folder / "report.html")
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


ENOUGH = 200
"""Number of runs from which the sensitivities are significant."""
UNITS = {"rms": "rad", "peak": "rad", "final": "rad", "settling": "s", "effort_peak": "N m", "power": "W"}


def file_of(name: str | None) -> Path:
    """Return the path of an installed sweep or scenario, given its name, or of a file."""
    sweeps = installed("sweeps")
    if name in sweeps:
        return sweeps[name]
    try:
        return library.find(name)
    except library.ScenarioError as error:
        raise library.ScenarioError(f"{error}; or of the sweeps {', '.join(sweeps)}") from None


def _sweep(
    name: str, text: str, file: SweepFile, options: Options, posterior: Mapping[str, Any] | None = None
) -> Sweep:
    numbers = {"runs": sweep_file.RUNS, **file.numbers, **options.numbers}
    return Sweep(name, text, vary=file.vary, success=file.success, posterior=posterior, **numbers)
