# SPDX-License-Identifier: Apache-2.0
"""`fjr tune`: search gains for stated uncertainties, validate them on fresh draws, write and draw the result.

Every finished part of a candidate is kept in the folder of the study (study.py), so that a search goes on where it
ended. The table has the figures of all runs with the coordinates of their point, NaN for the gains of the scenario.
"""

from __future__ import annotations

import hashlib
import json
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fjr_core.config import ros_yaml
from fjr_core.config.law import TYPE
from fjr_core.files.text_file import write_text
from fjr_core.numerics.checks import Array
from fjr_monitor.report.picture import COLOURS, GREY, LEGEND, log_ticks, write_picture
from fjr_msgs_py.console.ending import stoppable
from fjr_msgs_py.console.output import Result, aligned, json_text, percent, plural, progress_bar
from fjr_msgs_py.scenarios import library

from .coordinates import RULE, SCENARIO
from .sections import mapping, section, string
from .sensitivity import shown
from .study import Store, Workers, divided, open_store
from .sweep import OUTCOMES, TUNE, described, file_of, is_one
from .sweep_run import PROGRESS, check_and_warn, workers_of
from .tune import (
    GOAL,
    OF_SCENARIO,
    SIZE,
    Figures,
    Goal,
    Point,
    Range,
    Score,
    TuningStudy,
    quantile,
    search,
    with_better_start,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LAW = "law"
SMALL, LARGE, MANY = 16, 200, 1000  # runs of a part: of a few draws, of at least MANY draws
AXES = "effort_noise", "effort_peak"
SHOWN = ("rms", "peak", *AXES)
QUANTILES = (0.5, 0.95)
STARTS = {SCENARIO: "the scenario", RULE: "the rule of equal bandwidth"}


def kept_figures(
    study: TuningStudy,
    store: Store,
    workers: Workers,
    stop: threading.Event,
    on_progress: Callable[[int], object],
    points: Sequence[Point],
    runs: Range,
) -> list[Figures]:
    """Return the figures of points of a study over a range of runs; keep each finished part in its folder.

    on_progress: called with the number of runs of each part, also of a kept one. Raise Interrupted when `stop` is set.
    """
    parts = divided(*runs, LARGE if runs[1] - runs[0] >= MANY else SMALL)
    jobs = {_key(point, *part): (study, point, *part) for point in points for part in parts}
    store.run(workers, TuningStudy.part, jobs, stop)
    for _, _, begin, end in jobs.values():
        on_progress(end - begin)
    kept = [[store.read(_key(point, *part)) for part in parts] for point in points]
    return [{name: np.concatenate([part[name] for part in each]) for name in each[0]} for each in kept]


def _key(point: Point, begin: int, end: int) -> str:
    return f"{begin:09d}-{end:09d}-{hashlib.sha256(json.dumps(point).encode()).hexdigest()[:16]}"


@dataclass(frozen=True)
class Tuned:
    """Result of a search and its validation.

    candidates: by their points; point: the chosen one. scenario, chosen: figures on fresh draws of the gains of the
    scenario and of the chosen ones, with their scores.
    """

    study: TuningStudy
    candidates: Mapping[Point, Score]
    point: Point
    scenario: Figures
    chosen: Figures
    scores: tuple[Score, Score]


def planned(name: str | None, law: str | None, assignments: Sequence[str], numbers: Mapping[str, Any]) -> TuningStudy:
    """Return the study to run; law, numbers: replace those of the file unless they are None. Raise FjrError."""
    path, given = file_of(name), {key: value for key, value in numbers.items() if value is not None}
    document = ros_yaml.read(path, "sweep")
    own = dict(mapping(TUNE, document.get(TUNE, {}))) if is_one(document) else {}
    tuned = section(
        own | {key: given.pop(key) for key in SIZE if key in given}, {LAW: string, **GOAL, **SIZE}, "'tune': "
    )
    chosen = law or tuned.get(LAW)
    overrides = {**library.parse_assignments(assignments), **({TYPE.name: chosen} if chosen else {})}
    sweep = described(path, document, overrides, given)
    goal, size = ({key: tuned[key] for key in keys if key in tuned} for keys in (GOAL, SIZE))
    return TuningStudy(sweep, Goal(**goal), **size)


def tune(
    scenario: str | None,
    law: str | None,
    assignments: Sequence[str],
    cores: int,
    scheduler: str | None,
    output: Path,
    **numbers: float | None,
) -> Result:
    """Search and validate; write result, scenario and picture; return a summary. Raise FjrError, Interrupted.

    Arguments as of sweep_run.sweep; numbers: also SIZE.
    """
    study = planned(scenario, law, assignments, numbers)
    check_and_warn(study.sweep)
    _ = study.coordinates
    folder = output / f"{study.sweep.name}_{study.sweep.scenario.controller_values[TYPE.name]}"
    with stoppable() as stop, workers_of(study.sweep, cores, scheduler) as workers:
        study = with_better_start(study)
        with open_store(folder, study.text, study.sweep.loop.fingerprint) as store:
            total = study.searched + 2 * study.fresh
            line = f"{study.sweep.name}: {plural(study.candidates, 'candidate')} on {plural(workers.count, 'core')}"
            with progress_bar(line, PROGRESS, total=total, desc=study.sweep.name, unit=" runs") as bar:
                figures = partial(kept_figures, study, store, workers, stop, bar.update)
                candidates, point = search(study, figures)
                own, chosen = figures([OF_SCENARIO, point], study.stages[2])
            store.write_table(sorted(path.stem for path in store.folder.glob("parts/*.parquet")))
    scores = study.score(OF_SCENARIO, own), study.score(point, chosen)
    return _shown(Tuned(study, candidates, point, own, chosen, scores), folder)


def _shown(tuned: Tuned, folder: Path) -> Result:
    scenario = folder / f"{folder.name}.yaml"
    values = tuned.study.coordinates.values(tuned.point)
    write_text(scenario, library.text_with(scenario.name, tuned.study.sweep.scenario_text, values))
    picture = write_picture(folder / "overview.png", (12.0, 4.2), partial(_draw, tuned))
    plain = _values(tuned, values)
    write_text(folder / "result.json", json_text(plain, indent=1) + "\n")
    lines = [*_table(tuned), f"scenario with these gains: {scenario}{f'; picture: {picture}' if picture else ''}"]
    return Result("\n".join(lines), {**plain, "scenario": scenario, "picture": picture})


def _values(tuned: Tuned, values: Mapping[str, Any]) -> dict[str, Any]:
    scenario, chosen = tuned.scores
    axes = tuned.study.coordinates.axes
    return {
        "name": tuned.study.sweep.name,
        "law": tuned.study.sweep.scenario.controller_values[TYPE.name],
        "candidates": len(tuned.candidates),
        "fresh_runs": tuned.study.fresh,
        "start": tuned.study.start,
        "parameters": dict(values),
        "factors": {axis.name: float(np.exp(z)) for axis, z in zip(axes, tuned.point, strict=True)},
        "constraints_kept": chosen.feasible,
        "success": {"scenario": scenario.success, "tuned": chosen.success},
        "figures": {
            name: {
                f"{label}_{percent(q, 0).replace(' ', '')}": quantile(runs[name], q)
                for label, runs in (("scenario", tuned.scenario), ("tuned", tuned.chosen))
                for q in QUANTILES
            }
            for name in SHOWN
        },
    }


def _table(tuned: Tuned) -> list[str]:
    study, (scenario, chosen) = tuned.study, tuned.scores
    law = study.sweep.scenario.controller_values[TYPE.name]
    rows = [["", "scenario", "tuned", "ratio"]]
    for name, q in product(SHOWN, QUANTILES):
        words, unit = OUTCOMES[name]
        pair = quantile(tuned.scenario[name], q), quantile(tuned.chosen[name], q)
        what = f"  {words}, {'median' if q == 0.5 else percent(q, 0)}"
        ratio = f"{pair[1] / pair[0]:.3g}" if np.isfinite(pair).all() and pair[0] > 0 else ""
        rows.append([what, *(shown(value, unit, study.sweep) for value in pair), ratio])
    rows.append(["  successful runs", percent(scenario.success), percent(chosen.success), ""])
    axes = zip(study.coordinates.axes, tuned.point, strict=True)
    lines = [
        f"{study.sweep.name}, {law}: best of {len(tuned.candidates)} candidates, on {study.fresh:,} fresh draws",
        *aligned(rows),
        f"  factors on the gains of {STARTS[study.start]}:",
        *aligned([(f"  {axis.name}", f"× {np.exp(z):.3g}") for axis, z in axes]),
    ]
    if not chosen.feasible:
        lines.append(f"  constraints are violated on the fresh draws, by {chosen.violation:.2g}; see docs/gains.md")
    return lines


def _draw(tuned: Tuned, figure: Figure) -> None:
    """Draw error against noise in the effort, error against peak effort, distribution of the error."""
    axes = figure.subplots(1, 3)
    for ax, name in zip(axes, AXES, strict=False):
        _front(ax, tuned, name)
        log_ticks(ax.xaxis, ax.yaxis)
    axes[0].legend(loc="best", **{**LEGEND, "markerscale": 1.0})
    _distribution(axes[2], tuned)
    title = f"{tuned.study.sweep.name}: {len(tuned.candidates)} candidates, {tuned.study.fresh:,} fresh draws"
    figure.suptitle(title, fontsize=13, x=0.01, ha="left")


def _front(ax: Axes, tuned: Tuned, name: str) -> None:
    """Draw all candidates on the draws of the search, those on the front joined, start and choice marked."""
    scores, quantile = list(tuned.candidates.values()), tuned.study.goal.quantile
    x, y = (np.array([score.figures[key] for score in scores]) for key in (name, "rms"))
    kept = np.array([score.feasible for score in scores])
    finite = np.isfinite(x) & np.isfinite(y) & (x > 0) & (y > 0)
    ax.plot(x[finite & ~kept], 1e3 * y[finite & ~kept], ".", ms=4, color="#C9CCD3", label="violates a constraint")
    ax.plot(x[finite & kept], 1e3 * y[finite & kept], ".", ms=4, color=COLOURS[5], label="keeps the constraints")
    best = pareto(x, y, finite & (kept if kept.any() else True))
    ax.plot(x[best], 1e3 * y[best], "-", drawstyle="steps-post", color=COLOURS[0], lw=1.5, label="Pareto front")
    chosen = list(tuned.candidates).index(tuned.point)
    for i, marker, label in ((0, "s", "start of the search"), (chosen, "*", "chosen")):
        if finite[i]:
            ax.plot(x[i], 1e3 * y[i], marker, ms=9, color=COLOURS[1] if marker == "*" else GREY, label=label)
    error, effort = (tuned.study.sweep.units(unit) for unit in ("mrad", "N m"))
    ax.set(xscale="log", yscale="log", xlabel=f"{OUTCOMES[name][0]} [{effort}]", ylabel=f"RMS error [{error}]")
    ax.set_title(f"Candidates, {percent(quantile, 0)} quantile over {tuned.study.draws} draws")


def pareto(x: Array, y: Array, among: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the indices of the points that no other one beats in both values, by increasing x."""
    order = np.flatnonzero(among)
    order = order[np.lexsort((y[order], x[order]))]
    least = np.minimum.accumulate(np.append(np.inf, y[order]))[:-1]
    return order[y[order] < least]


def _distribution(ax: Axes, tuned: Tuned) -> None:
    """Draw the share of the fresh draws whose error is at most a level; lost runs are missing at the top."""
    sweep = tuned.study.sweep
    for runs, colour, label in ((tuned.scenario, GREY, "scenario"), (tuned.chosen, COLOURS[1], "chosen")):
        rms = np.sort(runs["rms"])
        share = 100.0 * np.arange(1, len(rms) + 1) / len(rms)
        stable = np.isfinite(rms) & (rms > 0)
        ax.plot(1e3 * rms[stable], share[stable], color=colour, label=label)
    ax.set(xscale="log", xlabel=f"RMS error [{sweep.units('mrad')}]", ylim=(0, 101))
    ax.set_ylabel("fresh draws with at most this error [%]")
    log_ticks(ax.xaxis)
    medians = (shown(quantile(runs["rms"], 0.5), "rad", sweep) for runs in (tuned.scenario, tuned.chosen))
    ax.set_title("Median {}, tuned {}".format(*medians))
    ax.legend(loc="lower right", **LEGEND)
