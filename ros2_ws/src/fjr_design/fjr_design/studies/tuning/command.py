# SPDX-License-Identifier: Apache-2.0
"""`fjr tune`: search gains for stated uncertainties, validate them on fresh draws, write and draw the result."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from concurrent.futures import wait
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fjr_core.config import ros_yaml
from fjr_core.config.law import TYPE
from fjr_core.files.atomic_file import write_text
from fjr_design.experiments.tuning.candidates import (
    OF_SCENARIO,
    SELECTION,
    Point,
    TuningStudy,
    run_candidate,
    with_better_start,
)
from fjr_design.experiments.tuning.coordinates import RULE, SCENARIO
from fjr_design.experiments.tuning.goal import Figures, Score
from fjr_design.experiments.tuning.search import FINALISTS, Found, search
from fjr_design.studies.monte_carlo.command import Options, check_and_warn, described, file_of
from fjr_design.studies.monte_carlo.pool import LOOK, Workers, cluster, result_of, threads
from fjr_design.studies.tuning import tuning_file
from fjr_design.studies.tuning.evaluation import Evaluation
from fjr_design.studies.tuning.picture import draw
from fjr_design.studies.tuning.store import open_store
from fjr_msgs_py.console.formatting import number, percent, plural
from fjr_msgs_py.console.interrupt import Interrupted
from fjr_msgs_py.console.progress import progress_bar
from fjr_msgs_py.console.result import Result, json_text
from fjr_msgs_py.scenarios import library

PROGRESS = "{desc}: {percentage:3.0f}% |{bar}| {n}/{total} runs, {rate_fmt}, {remaining} left"
SHOWN = {
    "rms": "RMS error",
    "peak": "largest error",
    "effort_noise": "noise in the effort",
    "effort_peak": "peak effort",
}
UNITS = {"rms": "rad", "peak": "rad", "effort_noise": "N m", "effort_peak": "N m"}
QUANTILES = (0.5, 0.95)
STARTS = {SCENARIO: "the scenario", RULE: "the rule of equal bandwidth"}


@dataclass(frozen=True)
class Tuned:
    """Result of a search and its validation: the gains of the scenario and the chosen ones on fresh draws."""

    study: TuningStudy
    found: Found
    scenario: Figures
    chosen: Figures
    scores: tuple[Score, Score]


def planned(name: str | None, options: Options, law: str | None, numbers: Mapping[str, int]) -> TuningStudy:
    """Return the study to run; law, numbers: replace those of the file. Raise FjrError."""
    path = file_of(name)
    document = ros_yaml.read(path, "sweep")
    chosen = law or tuning_file.law_of(document)
    overrides = {**options.overrides, **({TYPE.name: chosen} if chosen else {})}
    sweep, file = described(path, document, replace(options, overrides=overrides))
    return tuning_file.read(sweep, file.tune, numbers)


def tune(
    name: str | None, options: Options, law: str | None, numbers: Mapping[str, int], stop: threading.Event
) -> Result:
    """Search and validate; write result, scenario and picture; return a summary. Raise FjrError, Interrupted."""
    study = planned(name, options, law, numbers)
    check_and_warn(study.sweep)
    _ = study.coordinates
    if options.scheduler is None:
        study.sweep.loop.build()
    folder = options.output / f"{study.sweep.name}_{study.sweep.scenario.controller_values[TYPE.name]}"
    with cluster(options.scheduler) if options.scheduler else threads(options.cores) as workers:
        study = with_better_start(study, partial(_run, workers, stop))
        with open_store(folder, study, study.sweep.loop.fingerprint) as store:
            total = study.draws * study.candidates + (FINALISTS + 1) * SELECTION * study.draws + 2 * study.fresh
            line = f"{study.sweep.name}: {plural(study.candidates, 'candidate')} on {plural(workers.count, 'core')}"
            with progress_bar(line, PROGRESS, total=total, desc=study.sweep.name, unit=" runs") as bar:
                tuned = _searched(study, Evaluation(store, workers, stop, bar.update))
    return _shown(tuned, folder)


def _run(workers: Workers, stop: threading.Event, study: TuningStudy, point: Point, begin: int, end: int) -> Figures:
    """Run a part of a point on a worker; raise Interrupted when `stop` is set."""
    future = workers.executor.submit(run_candidate, study.text, point, begin, end)
    while not wait([future], timeout=LOOK).done:
        if stop.is_set():
            future.cancel()
            raise Interrupted(None)
    return result_of(future, workers.remote)


def _searched(study: TuningStudy, evaluate: Evaluation) -> Tuned:
    found = search(study, evaluate)
    points = [OF_SCENARIO, found.chosen]
    scenario, chosen = evaluate.figures(points, study.fresh_runs)
    return Tuned(study, found, scenario, chosen, (study.score(points[0], scenario), study.score(points[1], chosen)))


def _shown(tuned: Tuned, folder: Path) -> Result:
    scenario = folder / "tuned.yaml"
    values = tuned.study.coordinates.values(tuned.found.chosen)
    write_text(scenario, tuned.study.sweep.scenario_text)
    write_text(scenario, library.as_run(scenario, values)[0])
    picture = draw(tuned, folder / "overview.png")
    plain = _values(tuned, values)
    write_text(folder / "result.json", json_text(plain, indent=1) + "\n")
    lines = [*_table(tuned), f"scenario with these gains: {scenario}; picture: {picture}"]
    return Result("\n".join(lines), {**plain, "scenario": scenario, "picture": picture})


def _values(tuned: Tuned, values: Mapping[str, Any]) -> dict[str, Any]:
    scenario, chosen = tuned.scores
    axes = tuned.study.coordinates.axes
    return {
        "name": tuned.study.sweep.name,
        "law": tuned.study.sweep.scenario.controller_values[TYPE.name],
        "candidates": len(tuned.found.candidates),
        "fresh_runs": tuned.study.fresh,
        "start": tuned.study.start,
        "parameters": dict(values),
        "factors": {axis.name: float(np.exp(z)) for axis, z in zip(axes, tuned.found.chosen, strict=True)},
        "constraints_kept": chosen.feasible,
        "success": {"scenario": scenario.success, "tuned": chosen.success},
        "figures": {
            name: {
                f"{label}_{percent(q, 0).replace(' ', '')}": quantile(runs[name], q)
                for label, runs in (("scenario", tuned.scenario), ("tuned", tuned.chosen))
                for q in QUANTILES
            }
            for name in UNITS
        },
    }


def _table(tuned: Tuned) -> list[str]:
    study, (scenario, chosen) = tuned.study, tuned.scores
    law = study.sweep.scenario.controller_values[TYPE.name]
    lines = [
        f"{study.sweep.name}, {law}: best of {len(tuned.found.candidates)} candidates, on {study.fresh:,} fresh draws",
        f"  {'':32}{'scenario':>12}{'tuned':>12}{'ratio':>9}",
    ]
    for name, unit in UNITS.items():
        for q in QUANTILES:
            pair = quantile(tuned.scenario[name], q), quantile(tuned.chosen[name], q)
            what = f"{SHOWN[name]}, {'median' if q == 0.5 else percent(q, 0)}"
            lines.append(f"  {what:32}{number(pair[0]):>12}{number(pair[1]):>12}{_ratio(*pair):>9} {unit}")
    lines.append(f"  {'successful runs':32}{percent(scenario.success):>12}{percent(chosen.success):>12}")
    lines.append(f"  factors on the gains of {STARTS[study.start]}:")
    axes = zip(study.coordinates.axes, tuned.found.chosen, strict=True)
    lines += [f"  {axis.name:32}{f'× {np.exp(z):.3g}':>24}" for axis, z in axes]
    if not chosen.feasible:
        lines.append(f"  constraints are violated on the fresh draws, by {chosen.violation:.2g}; see docs/gains.md")
    return lines


def quantile(values: np.ndarray, share: float) -> float:
    """Return the quantile of a figure over runs; infinite if that share of them is lost."""
    return float(np.quantile(values, share, method="inverted_cdf"))


def _ratio(start: float, tuned: float) -> str:
    return f"{tuned / start:.3g}" if np.isfinite([start, tuned]).all() and start > 0 else ""
