# SPDX-License-Identifier: Apache-2.0
"""`fjr compare`: give every law its gains, run it on every robot along all references and imperfections, report all.

Gains follow from the rule of equal bandwidth (docs/compare.md), or every law with its robust options is tuned to the
same uncertainties, with the same cost, draws and number of candidates. A job is one law on one robot; its result is
kept in a file named by a hash of everything that determines it, so that a suite with another law or robot computes only
what is new.
"""

from __future__ import annotations

import hashlib
import json
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import BrokenExecutor
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from fjr_core.config.law import TYPE
from fjr_core.config.parameter import in_python
from fjr_core.config.scenario import Scenario, parse_scenario
from fjr_core.errors import FjrError, prefixed
from fjr_core.extensions.python_code import own_law
from fjr_core.files.importing import is_named, load, source_digest
from fjr_core.files.text_file import write_text
from fjr_core.law.interfaces import SampledLaw
from fjr_core.numerics.checks import Array
from fjr_core.numerics.jit import program_digest
from fjr_core.robust.law import sampled_law
from fjr_core.robust.options import Robust
from fjr_core.stability.linearization import spectral_radius
from fjr_msgs_py.console.ending import stoppable
from fjr_msgs_py.console.output import Result, aligned, finite, percent, progress_bar, tell
from fjr_msgs_py.scenarios import library

from ..batch import scenario_loop
from ..batch.draws import FIXED, Distribution, varied
from ..tuning.equal_bandwidth import BaselineTarget, baseline_target, tune
from . import compare_page, compare_results, suite
from .study import Kept, WorkerError, processes, report_share
from .suite import LawChoice, Suite, scenario_texts
from .sweep import Sweep
from .trial import MotionDemand, Trial, directions, fields_of, motion_demand
from .tune import FEW, GOAL, SIZE, Figures, Goal, Point, Range, TuningStudy, quantile, search, with_better_start

TRACE_POINTS = 600  # of a line of the nominal run
SETTLED = 0.02  # of the motion; band of the settling time
TUNING = 0.8  # of the work on a law that is tuned to uncertainties
OUTER = 0.95  # quantile that is reported beside the median
PAGE, RESULTS, KEPT = "comparison.html", "comparison.json", "kept"
PROGRESS = "{desc}: {percentage:3.0f}% |{bar}| {n:.1f}/{total} pairs of law and robot, {elapsed} < {remaining}"
QUIET = 2.0  # s until the progress bar appears
Values = dict[str, Any]


def compare(name: str, page: Path | None, output: Path, cores: int) -> Result:
    """Compare the laws of a suite; return a summary. Raise FjrError, Interrupted.

    Results go to output/compare_<suite>/: comparison.html, comparison.json, and kept/ with finished jobs, which are not
    run again. page: Markdown document whose table between the markers is replaced.
    """
    chosen = suite.load(library.find(name, "suite"))
    if page is not None:
        compare_results.around_table(page, chosen.name)  # raises ParameterError before the long run
    for sentence in filter(None, (in_python(TYPE, {TYPE.name: law.law}) for law in chosen.laws)):
        tell(sentence)
    planned = jobs(chosen)
    folder = output / f"compare_{chosen.name}"
    with stoppable() as stop:
        found = run(planned, folder / KEPT, cores, stop)
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
    """Return a job for every law on every robot, robot by robot; raise ParameterError for an invalid robot."""
    joins = {law.join for law in suite.laws}
    texts = {(robot.label, join): scenario_texts(robot, join) for robot in suite.robots for join in joins}
    shared = replace(suite, name="", laws=(), robots=())
    return [Job(law, robot.label, texts[robot.label, law.join], shared) for robot in suite.robots for law in suite.laws]


def run(jobs: Sequence[Job], folder: Path, cores: int, stop: threading.Event) -> list[Values]:
    """Return the results in the order of the jobs; keep each in the folder as soon as it is finished.

    Raise the FjrError of a job, WorkerError if a worker died, Interrupted when `stop` is set.
    """
    folder.mkdir(parents=True, exist_ok=True)
    kept = Kept(folder)
    missing = [job for job in jobs if not kept.holds(job.key)]
    if missing:
        joints = {job.robot: parse_scenario(job.robot, job.scenarios[0][1]).robot.n for job in missing}
        missing.sort(key=lambda job: joints[job.robot], reverse=True)  # the longest first
        numbered = {job.key: (job, number) for number, job in enumerate(missing)}
        line = f"compare: {len(missing)} of {len(jobs)} pairs of law and robot to run"
        try:
            with (
                progress_bar(line, PROGRESS, total=len(missing), desc="compare", delay=QUIET) as bar,
                processes(min(cores, len(missing)), len(missing)) as (workers, done),
            ):
                kept.run(workers, work, numbered, stop, on_look=lambda: bar.update(sum(done) - bar.n))
        except BrokenExecutor:
            raise WorkerError(
                f"a worker process died (killed or out of memory). Finished results are in {folder}; "
                "run the same command again to continue, with fewer --cores if memory is short"
            ) from None
    return [kept.read(job.key) for job in jobs]


def work(job: Job, number: int = 0) -> Values:
    """Run a job, in a worker that reports its share by its number; return reproducible results as plain values."""
    on_progress = partial(report_share, number)
    scenarios = {label: parse_scenario(job.robot, text) for label, text in job.scenarios}
    first = next(iter(scenarios.values()))
    demands = {}
    for label, scenario in scenarios.items():
        with prefixed(f"'{label}' of {job.robot}: "):
            demands[label] = motion_demand(scenario.robot, scenario.reference)
    with prefixed(f"{job.law.label} on {job.robot}: ", FjrError):
        target = baseline_target(first)
        if job.suite.tune is None:
            chosen = tuned_law(job.law, first, target)
        else:
            chosen = _tuned(_study(job, first, next(iter(demands.values())), target.effort_limit), on_progress)
    cells: Values = {}
    found: Values = {}
    runs = 0
    for done, (label, scenario) in enumerate(scenarios.items(), 1):
        band = SETTLED * demands[label].motion
        loop = scenario_loop(scenario, chosen.law, job.suite.duration, settle_after=job.suite.settle_after, band=band)
        trial = Trial(loop, demands[label], target.effort_limit, job.suite.tracks)
        each = trial.metrics(list(job.suite.imperfections.values()))
        cells[label] = dict(zip(job.suite.imperfections, each, strict=True))
        found = found or {**_margins(job, trial), "trace": _trace(trial)}
        runs += len(each) + len(trial.evaluated)
        on_progress(max(done / len(scenarios), TUNING if job.suite.tune else 0.0))
    return {
        "robot": {
            "joints": list(first.joints),
            "prismatic": [unit.position == "m" for unit in first.robot.units],
            "sample_period_s": first.sample_period,
            "references": {
                label: {"motion_rad": each.motion.tolist(), "torque_nm": each.torque.tolist()}
                for label, each in demands.items()
            },
        },
        "gains": dict(chosen.gains),
        "tuning": chosen.tuning,
        "effort_limit_nm": target.effort_limit.tolist(),
        "cells": cells,
        **found,
        "uncertain": chosen.figures,
        "runs": runs,
    }


@dataclass(frozen=True, eq=False)
class TunedLaw:
    """Law with its gains, or the parameters that were chosen, as plain values, and a summary of its tuning.

    figures: on fresh draws, of a law that was tuned to uncertainties.
    """

    law: SampledLaw
    gains: Mapping[str, Any]
    tuning: str
    figures: Mapping[str, float | None] = field(default_factory=dict)


def tuned_law(chosen: LawChoice, scenario: Scenario, target: BaselineTarget) -> TunedLaw:
    """Return a law by the rule of equal bandwidth for robot, start and reference of the scenario, the target's.

    v-dPBC keeps the gains of the scenario unless it is retuned; robust options hold for the sample period. A law of the
    user is not tuned: it has its options. Raises FjrError if there is no such law or no stable gains.
    """
    hold = Robust(**chosen.robust, hold=scenario.sample_period)
    if is_named(chosen.law):
        own = own_law(chosen.law, scenario.robot, chosen.options, compile=False)
        law = sampled_law(own, hold)
        bandwidth, peak = target.bandwidth_of(own) / target.bandwidth, target.peak_of(own) / target.peak
        tuning = f"not tuned: bandwidth {bandwidth:.2g} times the target, peak effort {peak:.2g} times the target"
        return TunedLaw(law, chosen.options, tuning + _unstable(law, scenario))
    found = tune(chosen.law, target, retune=chosen.retune)
    law = sampled_law(found.law, hold)
    gains = {**_plain(found.law.gains), **_plain(found, "omega", "damping")}
    return TunedLaw(law, gains, found.sentence + _unstable(law, scenario))


def _unstable(law: SampledLaw, scenario: Scenario) -> str:
    """Return a note if the sampled loop is unstable along the reference, else an empty string."""
    where, period = scenario.configurations(FEW), scenario.sample_period
    radius = spectral_radius(law, period, scenario.loop_delay, where, scenario.plant).max()
    return "" if radius < 1 else f"; unstable as sampled: spectral radius {radius:.4g}"


def _plain(value: Any, *names: str) -> dict[str, Any]:
    """Return the finite arrays and numbers of a dataclass as plain values."""
    arrays = {name: np.asarray(getattr(value, name)) for name in names or [field.name for field in fields(value)]}
    return {name: array.tolist() for name, array in arrays.items() if np.isfinite(array).all()}


def _tuned(study: TuningStudy, on_progress: Callable[[float], None]) -> TunedLaw:
    """Return the law of a study, tuned to its uncertainties. Raises FjrError."""
    study, done = with_better_start(study), 0

    def figures(points: Sequence[Point], runs: Range) -> list[Figures]:
        nonlocal done
        done += len(points) * (runs[1] - runs[0])
        found = [study.run(point, *runs) for point in points]
        on_progress(TUNING * min(1.0, done / study.searched))
        return found

    candidates, chosen = search(study, figures)
    fresh = study.run(chosen, *study.stages[2])
    score = study.score(chosen, fresh)
    summary = {"rms": score.figures["rms"], "rms_outer": quantile(fresh["rms"], OUTER), "success": score.success}
    summary |= {name: score.figures[name] for name in ("effort_noise", "effort_peak")}
    tracking = f"on {study.fresh} fresh draws {percent(score.success, 1)} track"
    return TunedLaw(
        study.coordinates.controller(chosen)[0],
        study.coordinates.values(chosen),
        f"best of {len(candidates)} candidates; {tracking}",
        finite(summary),
    )


def _study(job: Job, first: Scenario, demand: MotionDemand, effort_limit: Array) -> TuningStudy:
    """Return the study of a law: draws vary as the suite states, its imperfections have fixed levels.

    A run succeeds if its error is at most the fraction `tracks` of the motion, at every joint.
    """
    law, wanted = job.law, job.suite.tune or {}
    values: Values = {"law.type": law.law, "robust.hold": first.sample_period}
    for name, value in law.robust.items():
        values[f"robust.{name}"] = [value] * first.robot.n if name.endswith("gain") else value
    text = library.text_with(job.robot, job.scenarios[0][1], values)
    levels = fields_of(wanted["imperfections"], demand, first.sample_period / first.inner_steps)
    fixed = {"effort_limit": effort_limit, **levels}
    vary = varied(wanted["vary"])
    vary |= {name: Distribution(FIXED, tuple(np.atleast_1d(value).tolist())) for name, value in fixed.items()}
    numbers, size = ({name: wanted[name] for name in names} for names in (suite.NUMBERS, SIZE))
    sweep = Sweep("tuned", text, 1, vary, success={"rms": (job.suite.tracks * demand.motion).tolist()}, **numbers)
    return TuningStudy(sweep, Goal(**{name: wanted[name] for name in GOAL}), **size)


def _margins(job: Job, trial: Trial) -> Values:
    """Return the margins and the RMS errors evaluated in their search."""
    edges = trial.margins(directions(job.suite.margins))
    curves = {}
    for name in job.suite.margins:
        levels, cells = trial.curve(name)
        curves[name] = {"levels": levels.tolist(), "relative": [cell["relative"] for cell in cells]}
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
