# SPDX-License-Identifier: Apache-2.0
"""`fjr compare`: give every law its gains, run it on every robot along all references and imperfections, report all.

A job is one law on one robot; its result is kept in a file named by a hash of everything that determines it, so that a
suite with another law or robot computes only what is new.
"""

from __future__ import annotations

import hashlib
import json
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import BrokenExecutor
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from fjr_core.config.scenario import Scenario, parse_scenario
from fjr_core.errors import CompareError, FjrError, prefixed
from fjr_core.files.importing import is_named, load, source_digest
from fjr_core.files.text_file import is_sealed, read_json, write_text
from fjr_core.law.interfaces import StaticLaw
from fjr_core.numerics.jit import program_digest
from fjr_msgs_py.console.ending import Interrupted
from fjr_msgs_py.console.output import Result, aligned, finite, progress_bar, tell
from fjr_msgs_py.scenarios import library

from ..batch import scenario_loop
from . import compare_page, compare_results, suite
from .compared_law import TunedLaw, law_for, tuned_law
from .study import Processes, processes, report_share
from .suite import LawChoice, Suite, scenario_texts
from .trial import MotionDemand, Trial, directions, motion_demand

TRACE_POINTS = 600
SETTLED = 0.02  # of the motion; band of the settling time
TUNING = 0.8  # of the work on a law that is tuned to uncertainties
PAGE, RESULTS, CACHE = "comparison.html", "comparison.json", "kept"
PROGRESS = "{desc}: {percentage:3.0f}% |{bar}| {n:.1f}/{total} pairs of law and robot, {elapsed} < {remaining}"
QUIET = 2.0  # s until the progress bar appears
Values = dict[str, Any]


def compare(name: str, output: Path, cores: int, page: Path | None, stop: threading.Event) -> Result:
    """Compare the laws of a suite; return a summary. Raise FjrError, and Interrupted when `stop` is set.

    Results go to output/compare_<suite>/: comparison.html, comparison.json, and kept/ with finished jobs, which are not
    run again. page: Markdown document whose table between the markers is replaced.
    """
    chosen = suite.load(library.find(name, "suite"))
    if page is not None:
        compare_results.around_table(page, chosen.name)  # raises CompareError before the long run
    for law in chosen.laws:
        if is_named(law.law) and not issubclass(load(law.law), StaticLaw):
            tell(f"{law.law} is evaluated in Python: its runs are not compiled, so they take longer")
    planned = jobs(chosen)
    folder = output / f"compare_{chosen.name}"
    found = run(planned, folder / CACHE, cores, stop)
    document = compare_results.document(chosen, [(job.robot, job.law.label) for job in planned], found)
    write_text(folder / RESULTS, json.dumps(document, allow_nan=False) + "\n")
    compare_page.write_page(folder / PAGE, document)
    if page is not None:
        compare_results.replace(page, document)
    lines = [compare_results.extent(document), "", *aligned(compare_results.cells(document)), ""]
    lines += [compare_results.best_in(document)] if chosen.tune else []
    lines.append(f"page and figures: {folder / PAGE}, {folder / RESULTS}")
    return Result("\n".join(lines), {"page": folder / PAGE, **document})


@dataclass(frozen=True)
class Job:
    """Input of a worker process, plain values only.

    scenarios: (reference, text) each. suite: what all jobs have in common, without laws and robots.
    """

    law: LawChoice
    robot: str
    scenarios: tuple[tuple[str, str], ...]
    suite: Suite

    @cached_property
    def key(self) -> str:
        """Cache key: hash of this job, fjr_core, CasADi, this package and the sources of a law or plant of the user."""
        plant = parse_scenario(self.robot, self.scenarios[0][1]).plant_values["plant.type"]
        own = [source_digest(load(str(name))) for name in (self.law.law, plant) if is_named(name)]
        parts = [json.dumps(asdict(self)), program_digest(Path(__file__).parents[1]), *own]
        return hashlib.sha256("".join(parts).encode()).hexdigest()[:32]


def jobs(suite: Suite) -> list[Job]:
    """Return a job for every law on every robot, robot by robot; raise CompareError for an invalid robot."""
    joins = {law.join for law in suite.laws}
    texts = {(robot.label, join): scenario_texts(robot, join) for robot in suite.robots for join in joins}
    shared = replace(suite, name="", laws=(), robots=())
    return [Job(law, robot.label, texts[robot.label, law.join], shared) for robot in suite.robots for law in suite.laws]


def run(jobs: Sequence[Job], kept: Path, cores: int, stop: threading.Event) -> list[Values]:
    """Return the results in the order of the jobs; write each into the folder `kept` as soon as it is finished.

    Raise the FjrError of a job, CompareError if a worker died, Interrupted when `stop` is set.
    """
    kept.mkdir(parents=True, exist_ok=True)
    results = {job.key: read_kept(kept, job.key) for job in jobs}
    missing = [job for job in jobs if results[job.key] is None]
    if missing:
        joints = {job.robot: parse_scenario(job.robot, job.scenarios[0][1]).robot.n for job in missing}
        missing.sort(key=lambda job: joints[job.robot], reverse=True)  # the longest first
        try:
            with processes(min(cores, len(missing))) as workers:
                results |= _compute(missing, len(jobs), kept, workers, stop)
        except BrokenExecutor:
            raise CompareError(
                f"a worker process died (killed or out of memory). Finished results are in {kept}; "
                "run the same command again to continue, with fewer --cores if memory is short"
            ) from None
    return [result for job in jobs if (result := results[job.key]) is not None]


def _compute(missing: list[Job], jobs: int, kept: Path, workers: Processes, stop: threading.Event) -> dict[str, Values]:
    results: dict[str, Values] = {}
    shares = {job.key: 0.0 for job in missing}
    line = f"compare: {len(missing)} of {jobs} pairs of law and robot to run"
    with progress_bar(line, PROGRESS, total=len(missing), desc="compare", delay=QUIET) as bar:

        def keep(key: str, result: Values) -> None:
            write_text(kept / f"{key}.json", json.dumps(result, allow_nan=False), sealed=True)
            results[key] = result

        def look() -> None:
            shares.update(workers.shares())
            shares.update(dict.fromkeys(results, 1.0))
            bar.update(sum(shares.values()) - bar.n)

        if not workers.run(work, {job.key: (job,) for job in missing}, keep, stop, look):
            raise Interrupted(kept if any(kept.glob("*.json")) else None)
    return results


def read_kept(kept: Path, key: str) -> Values | None:
    """Return the kept result of a job; None if it is missing or changed."""
    path = kept / f"{key}.json"
    try:
        return read_json(path) if is_sealed(path) else None
    except (OSError, ValueError):
        return None


def work(job: Job) -> Values:
    """Run a job, in a worker that reports its share; return reproducible results as plain values."""
    on_progress = partial(report_share, job.key)
    scenarios = {label: parse_scenario(job.robot, text) for label, text in job.scenarios}
    first = next(iter(scenarios.values()))
    demands = {label: _demand(job, label, scenario) for label, scenario in scenarios.items()}
    chosen = _chosen(job, first, next(iter(demands.values())), on_progress)
    cells: Values = {}
    found: Values = {}
    runs = 0
    for done, (label, scenario) in enumerate(scenarios.items(), 1):
        band = SETTLED * demands[label].motion
        loop = scenario_loop(scenario, chosen.law, job.suite.duration, settle_after=job.suite.settle_after, band=band)
        trial = Trial(loop, demands[label], chosen.effort_limit, job.suite.tracks)
        each = trial.metrics(list(job.suite.imperfections.values()))
        cells[label] = {name: asdict(cell) for name, cell in zip(job.suite.imperfections, each, strict=True)}
        found = found or {**_margins(job, trial), "trace": _trace(trial)}
        runs += len(each) + len(trial.evaluated)
        on_progress(max(done / len(scenarios), TUNING if job.suite.tune else 0.0))
    return {
        "robot": {
            "joints": list(first.joints),
            "sample_period_s": first.sample_period,
            "references": {
                label: {"motion_rad": each.motion, "torque_nm": each.torque.tolist()} for label, each in demands.items()
            },
        },
        "gains": dict(chosen.gains),
        "tuning": chosen.tuning,
        "effort_limit_nm": chosen.effort_limit.tolist(),
        "cells": cells,
        **found,
        "uncertain": chosen.figures,
        "runs": runs,
    }


def _demand(job: Job, label: str, scenario: Scenario) -> MotionDemand:
    """Compute the demand of a reference; raise CompareError for one that stands still."""
    with prefixed(f"'{label}' of {job.robot}: ", CompareError, CompareError):
        return motion_demand(scenario.robot, scenario.reference)


def _chosen(job: Job, first: Scenario, demand: MotionDemand, on_progress: Callable[[float], None]) -> TunedLaw:
    """Return the law with its gains, by the rule or tuned to uncertainties."""
    law = job.law
    with prefixed(f"{law.label} on {job.robot}: ", FjrError, CompareError):
        ruled = tuned_law(law.law, law.robust, first, law.retune, law.options)
        if job.suite.tune is None:
            return ruled
        n = first.robot.n
        values: Values = {"law.type": law.law, "robust.hold": first.sample_period}
        values |= {
            f"robust.{name}": [value] * n if name.endswith("gain") else value for name, value in law.robust.items()
        }
        text = library.text_with(job.robot, job.scenarios[0][1], values)
        given = job.suite.tune, demand, ruled.effort_limit, job.suite.tracks
        return law_for(text, *given, lambda share: on_progress(TUNING * share))


def _margins(job: Job, trial: Trial) -> Values:
    """Return the margins and the RMS errors evaluated in their search."""
    edges = trial.margins(directions(job.suite.margins))
    curves = {}
    for name in job.suite.margins:
        levels, cells = trial.curve(name)
        curves[name] = {"levels": levels.tolist(), "relative": [cell.relative for cell in cells]}
    return {"margins": {name: asdict(edge) for name, edge in edges.items()}, "curves": curves}


def _trace(trial: Trial) -> Values:
    """Return largest error and effort over time of the nominal run; None after its end."""
    loop, (_, run) = trial.loop, trial.loop.recorded(trial.draws([{}]))
    error = run.x[0, :, : loop.robot.n] - loop.reference.jets(run.t)[:, 0]
    rows = np.unique(np.linspace(0, len(run.t) - 1, TRACE_POINTS).astype(int))
    found: Values = {"t": run.t[rows].tolist()}
    for name, values in (("error", error), ("effort", run.u[0])):
        found[name] = finite(np.abs(values).max(axis=1)[rows])
    return found
