# SPDX-License-Identifier: Apache-2.0
"""`fjr tune`: search gains for stated uncertainties, validate them on fresh draws, write and draw the result.

Every finished part of a candidate is kept in the folder of the study, so that a search goes on where it ended:

tuning.json          specification of the study and hash of the program
evaluations.jsonl    a line for each finished part: point, runs, figures
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Any

import numpy as np

from fjr_core.config import ros_yaml
from fjr_core.config.law import TYPE
from fjr_core.errors import ParameterError
from fjr_core.files.text_file import write_text
from fjr_msgs_py.console.ending import Interrupted
from fjr_msgs_py.console.output import Result, json_text, number, percent, plural, progress_bar
from fjr_msgs_py.scenarios import library

from . import sweep_file
from .coordinates import RULE, SCENARIO
from .study import Workers, cluster, opened, threads
from .sweep import Sweep
from .sweep_file import Options, check_keys, described, file_of
from .sweep_run import PROGRESS, check_and_warn
from .tune import (
    FINALISTS,
    OF_SCENARIO,
    SELECTION,
    Figures,
    Found,
    Goal,
    Point,
    Range,
    Score,
    TuningStudy,
    joined,
    quantile,
    run_candidate,
    search,
    with_better_start,
)
from .tune_picture import draw

NUMBERS = ("draws", "candidates", "fresh")
GOAL = ("minimise", "quantile", "success", "limits", "delay_margin")
LAW = "law"
SECTION = (LAW, *GOAL, *NUMBERS)
HERE = "'tune' "  # start of a message
DESCRIPTION, EVALUATIONS = "tuning.json", "evaluations.jsonl"
Part = tuple[Point, int, int]
SMALL, LARGE, MANY = 16, 200, 1000
"""Runs of a part: of a few draws, of at least MANY draws."""
SHOWN = {
    "rms": "RMS error",
    "peak": "largest error",
    "effort_noise": "noise in the effort",
    "effort_peak": "peak effort",
}
UNITS = {"rms": "rad", "peak": "rad", "effort_noise": "N m", "effort_peak": "N m"}
QUANTILES = (0.5, 0.95)
STARTS = {SCENARIO: "the scenario", RULE: "the rule of equal bandwidth"}


def read_section(sweep: Sweep, section: Mapping[str, Any], numbers: Mapping[str, int]) -> TuningStudy:
    """Return the study of the section `tune` of a sweep file; numbers: replace its own. Raise ParameterError."""
    check_keys(section, SECTION, HERE)
    goal: dict[str, Any] = {}
    for key in GOAL:
        if key in section:
            given = section[key]
            if key not in ("minimise", "limits"):
                goal[key] = sweep_file.number(key, given, HERE)
                continue
            if not isinstance(given, Mapping):
                raise ParameterError(
                    f"'tune' has {given!r} as '{key}'; expected figures and numbers, e.g. {{rms: 1.0}}"
                )
            goal[key] = {str(name): sweep_file.number(f"{key}.{name}", value, HERE) for name, value in given.items()}
    size: dict[str, Any] = {key: sweep_file.whole(key, section[key], HERE) for key in NUMBERS if key in section} | dict(
        numbers
    )
    return TuningStudy(sweep, Goal(**goal), **size)


def law_of(document: object) -> str | None:
    """Return the law that the section of a parsed file names, None if none; raise ParameterError."""
    section = document.get(sweep_file.TUNE) if isinstance(document, Mapping) else None
    name = section.get(LAW) if isinstance(section, Mapping) else None
    if name is not None and not isinstance(name, str):
        raise ParameterError(f"'tune' has {name!r} as '{LAW}'; expected the name of a law")
    return name


@dataclass(frozen=True)
class Evaluator:
    """Evaluates points of a study, and keeps each finished part in its folder; create it by `open_store`.

    parts: figures by (point, begin, end) of their runs. on_progress: called with the number of runs of each part, also
    of a kept one. Raises Interrupted when `stop` is set.
    """

    folder: Path
    study: TuningStudy
    file: IO[str]
    parts: dict[Part, Figures]
    workers: Workers
    stop: threading.Event
    on_progress: Callable[[int], object] = lambda runs: None

    def __call__(self, points: Sequence[Point], runs: Range) -> list[Score]:
        """Return the scores of points over a range of runs."""
        return [self.study.score(*each) for each in zip(points, self.figures(points, runs), strict=True)]

    def figures(self, points: Sequence[Point], runs: Range) -> list[Figures]:
        """Return the figures of points over a range of runs; empty if a point has no gains."""
        parts = {point: list(_parts(point, runs)) for point in points}
        text = self.study.text
        missing = [(text, *part) for each in parts.values() for part in each if part not in self.parts]
        if not self.workers.run(run_candidate, missing, lambda job, found: self._keep(job[1:], found), self.stop):
            raise Interrupted(self.folder)
        for _, begin, end in (part for each in parts.values() for part in each):
            self.on_progress(end - begin)
        return [joined([self.parts[part] for part in parts[point]]) for point in points]

    def _keep(self, part: Part, figures: Figures) -> None:
        """Add a part and write it to the file."""
        point, begin, end = part
        plain = {name: values.tolist() for name, values in figures.items()}
        self.file.write(json.dumps({"point": point, "begin": begin, "end": end, "figures": plain}) + "\n")
        self.file.flush()
        self.parts[part] = figures


def _parts(point: Point, runs: Range) -> list[Part]:
    begin, end = runs
    size = LARGE if end - begin >= MANY else SMALL
    return [(point, first, min(first + size, end)) for first in range(begin, end, size)]


@contextmanager
def open_store(
    folder: Path, study: TuningStudy, program: str, workers: Workers, stop: threading.Event
) -> Iterator[Evaluator]:
    """Open or create the folder of a study, locked for this process; program: see study.opened. Raise StoreError."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / EVALUATIONS
    with opened(folder / DESCRIPTION, json.loads(study.text), program, path.exists, "fjr tune"):
        parts, length = _read(path)
        with path.open("a", encoding="utf-8") as file:
            file.truncate(length)
            yield Evaluator(folder, study, file, parts, workers, stop)


def _read(path: Path) -> tuple[dict[Part, Figures], int]:
    """Return the finished parts and the length of their lines [bytes]; a line cut off by a crash ends them."""
    found: dict[Part, Figures] = {}
    length = 0
    for line in path.read_bytes().splitlines(keepends=True) if path.exists() else ():
        try:
            values = json.loads(line)
            part = tuple(values["point"]), values["begin"], values["end"]
            figures = {name: np.array(each) for name, each in values["figures"].items()}
        except (ValueError, KeyError, TypeError):
            break
        if not line.endswith(b"\n"):
            break
        found[part] = figures
        length += len(line)
    return found, length


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
    chosen = law or law_of(document)
    overrides = {**options.overrides, **({TYPE.name: chosen} if chosen else {})}
    sweep, file = described(path, document, replace(options, overrides=overrides))
    return read_section(sweep, file.tune, numbers)


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

        def run(one: TuningStudy, point: Point, begin: int, end: int) -> Figures:
            found: list[Figures] = []
            job = (one.text, point, begin, end)
            if not workers.run(run_candidate, [job], lambda _, figures: found.append(figures), stop):
                raise Interrupted(None)
            return found[0]

        study = with_better_start(study, run)
        with open_store(folder, study, study.sweep.loop.fingerprint, workers, stop) as evaluate:
            total = study.draws * study.candidates + (FINALISTS + 1) * SELECTION * study.draws + 2 * study.fresh
            line = f"{study.sweep.name}: {plural(study.candidates, 'candidate')} on {plural(workers.count, 'core')}"
            with progress_bar(line, PROGRESS, total=total, desc=study.sweep.name, unit=" runs") as bar:
                tuned = _searched(study, replace(evaluate, on_progress=bar.update))
    return _shown(tuned, folder)


def _searched(study: TuningStudy, evaluate: Evaluator) -> Tuned:
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


def _ratio(start: float, tuned: float) -> str:
    return f"{tuned / start:.3g}" if np.isfinite([start, tuned]).all() and start > 0 else ""
