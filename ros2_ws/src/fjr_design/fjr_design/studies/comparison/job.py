# SPDX-License-Identifier: Apache-2.0
"""One job of a comparison: one law on one robot, along all references and imperfections, with its margins."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from fjr_core.config.scenario import Scenario, parse_scenario
from fjr_core.errors import CompareError, FjrError
from fjr_core.files.importing import is_named, load, source_digest
from fjr_core.numerics.jit import program_digest
from fjr_design.experiments.comparison import MotionDemand, Trial, directions, motion_demand
from fjr_design.experiments.comparison.tuned_law import TunedLaw, tuned_law
from fjr_design.experiments.comparison.uncertainties import Uncertainties, law_for
from fjr_design.experiments.scenario_loop import scenario_loop
from fjr_design.studies.comparison.suite import LawChoice, Suite, scenario_texts
from fjr_msgs_py.scenarios import library

TRACE_POINTS = 600
SETTLED = 0.02  # of the motion; band of the settling time
TUNING = 0.8  # of the work on a law that is tuned to uncertainties
Result = dict[str, Any]
OnProgress = Callable[[float], None]


@dataclass(frozen=True)
class Job:
    """Input of a worker process, plain values only. scenarios: (reference, text) each."""

    law: LawChoice
    robot: str
    scenarios: tuple[tuple[str, str], ...]
    imperfections: Mapping[str, Mapping[str, float]]
    margins: tuple[str, ...]
    duration: float
    settle_after: float
    tracks: float
    tune: Mapping[str, Any] | None = None

    @property
    def name(self) -> str:
        """Name for messages."""
        return f"{self.law.label} on {self.robot}"

    @property
    def key(self) -> str:
        """Cache key: hash of this job, fjr_core, CasADi, this module and that of a law of the user."""
        own = source_digest(load(self.law.law)) if is_named(self.law.law) else ""
        return hashlib.sha256((json.dumps(asdict(self)) + _source() + own).encode()).hexdigest()[:32]


def jobs(suite: Suite) -> list[Job]:
    """Return a job for every law on every robot, robot by robot; raise CompareError for an invalid robot."""
    texts = [(robot.label, scenario_texts(robot)) for robot in suite.robots]
    shared = (suite.imperfections, suite.margins, suite.duration, suite.settle_after, suite.tracks, suite.tune)
    return [Job(law, robot, found, *shared) for robot, found in texts for law in suite.laws]


def work(job: Job, on_progress: OnProgress) -> Result:
    """Run a job; return reproducible results as plain values. on_progress: called with the share done, 0 to 1."""
    scenarios = {label: parse_scenario(job.robot, text) for label, text in job.scenarios}
    first = next(iter(scenarios.values()))
    wanted = {label: _needs(job, label, scenario) for label, scenario in scenarios.items()}
    chosen, uncertain = _chosen(job, first, next(iter(wanted.values())), on_progress)
    cells: Result = {}
    found: Result = {}
    runs = 0
    for done, (label, scenario) in enumerate(scenarios.items(), 1):
        trial = _trial(job, scenario, chosen, wanted[label])
        each = trial.metrics(list(job.imperfections.values()))
        cells[label] = {name: asdict(cell) for name, cell in zip(job.imperfections, each, strict=True)}
        found = found or {**_margins(job, trial), "trace": _trace(trial)}
        runs += len(each) + len(trial.evaluated)
        on_progress(max(done / len(scenarios), TUNING if job.tune else 0.0))
    return {
        "robot": _robot(first, wanted),
        "gains": dict(chosen.gains),
        "tuning": chosen.tuning,
        "effort_limit_nm": chosen.effort_limit.tolist(),
        "cells": cells,
        **found,
        "uncertain": uncertain,
        "runs": runs,
    }


def _chosen(
    job: Job, first: Scenario, demand: MotionDemand, on_progress: OnProgress
) -> tuple[TunedLaw, Mapping[str, float | None]]:
    """Return the law with its gains, and its figures on fresh draws if it was tuned to uncertainties."""
    law = job.law
    try:
        ruled = tuned_law(law.law, law.robust, first, law.retune, law.options)
        if job.tune is None:
            return ruled, {}
        n = first.robot.n
        values: dict[str, Any] = {"law.type": law.law, "robust.hold": first.sample_period}
        values |= {
            f"robust.{name}": [value] * n if name.endswith("gain") else value for name, value in law.robust.items()
        }
        text = library.text_with(job.robot, job.scenarios[0][1], values)
        bounds = {"effort_limit": ruled.effort_limit.tolist(), "tracks": job.tracks}
        found = law_for(
            text, Uncertainties(**job.tune), demand, **bounds, on_progress=lambda s: on_progress(TUNING * s)
        )
    except FjrError as error:
        raise CompareError(f"{job.name}: {error}") from None
    return TunedLaw(found.law, ruled.effort_limit, found.parameters, found.sentence), found.figures


def _margins(job: Job, trial: Trial) -> Result:
    """Return the margins and the RMS errors evaluated in their search."""
    edges = trial.margins(directions(job.margins))
    curves = {}
    for axis in job.margins:
        levels, cells = trial.curve(axis)
        curves[axis] = {"levels": levels.tolist(), "relative": [cell.relative for cell in cells]}
    return {"margins": {name: asdict(edge) for name, edge in edges.items()}, "curves": curves}


def _needs(job: Job, label: str, scenario: Scenario) -> MotionDemand:
    """Compute the motion demand of a reference; raise CompareError for one that stands still."""
    try:
        return motion_demand(scenario.robot, scenario.reference)
    except CompareError as error:
        raise CompareError(f"'{label}' of {job.robot}: {error}") from None


def _trial(job: Job, scenario: Scenario, chosen: TunedLaw, wanted: MotionDemand) -> Trial:
    band = SETTLED * wanted.motion
    loop = scenario_loop(scenario, chosen.law, job.duration, settle_after=job.settle_after, band=band)
    return Trial(loop, wanted, chosen.effort_limit, job.tracks)


def _robot(first: Scenario, wanted: Mapping[str, MotionDemand]) -> Result:
    """Return the data that all laws on a robot share."""
    return {
        "joints": list(first.joints),
        "sample_period_s": first.sample_period,
        "references": {
            label: {"motion_rad": each.motion, "torque_nm": each.torque.tolist()} for label, each in wanted.items()
        },
    }


def _trace(trial: Trial) -> Result:
    """Return largest error and effort over time of the nominal run."""
    loop, run = trial.loop, trial.recorded()
    error = run.x[0, :, : loop.robot.n] - loop.reference.jets(run.t)[:, 0]
    rows = np.unique(np.linspace(0, len(run.t) - 1, TRACE_POINTS).astype(int))
    return {
        "t": run.t[rows].tolist(),
        "error": _numbers(np.abs(error).max(axis=1)[rows]),
        "effort": _numbers(np.abs(run.u[0]).max(axis=1)[rows]),
    }


def _numbers(values: np.ndarray) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in values]


@cache
def _source() -> str:
    return program_digest(Path(__file__).parents[2])
