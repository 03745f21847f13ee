# SPDX-License-Identifier: Apache-2.0
"""`fjr sweep`: run or resume the sweep of a scenario or sweep file, and report it as table, picture and HTML page.

Beside the files of any study (study.py) its folder has summary.json, overview.png and report.html: success and error
over each drawn number, the most influential one first.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fjr_core.files.text_file import write_text
from fjr_core.model.joints import joined
from fjr_core.numerics.checks import Array
from fjr_monitor.report import html
from fjr_monitor.report.html import Line, Plot
from fjr_monitor.report.picture import COLOURS, GREY, LEGEND, draw_plot, write_picture
from fjr_msgs_py.console.ending import stoppable
from fjr_msgs_py.console.output import Result, aligned, finite, json_text, percent, plural, progress_bar, tell

from ..batch.draws import FIXED, LOG_UNIFORM, PARAMETERS
from .sensitivity import Effect, ReadColumn, Summary, shown, summarised
from .study import Store, Workers, cluster, divided, open_store, threads
from .sweep import OUTCOMES, Sweep, planned

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PROGRESS = "{desc}: {percentage:3.0f}% |{bar}| {n}/{total} runs, {rate_fmt}, {remaining} left"
IN_PYTHON = "law or plant are evaluated in Python: the runs are not compiled, and --cores does not speed them up"
ENOUGH = 200  # runs from which the sensitivities are significant
IN_TABLE = ("rms", "peak", "final", "settling", "effort_peak", "power")
LARGEST_PART, SMALLEST_PART, PARTS = 1000, 10, 200  # runs, runs; parts of a sweep, about
PLOTTED = 4  # drawn parameters
DOTS = 4000
GOOD, BAD, LOST = "c1", "c2", "bad"
BINS = 40  # of the distribution
ABOVE = 1.5  # times the largest error: where unstable runs are drawn
ERROR = "RMS error, worst joint"
WIDTH = 42  # characters of a line over a plot


def sweep(
    scenario: str | None,
    assignments: Sequence[str],
    cores: int,
    scheduler: str | None,
    output: Path,
    **numbers: float | None,
) -> Result:
    """Run or resume a sweep, write table, summary, figure and page; return a summary. Raise FjrError, Interrupted.

    scheduler: address of a Dask cluster instead of cores. output: folder of the sweep's folder. numbers: see `planned`.
    """
    plan = planned(scenario, assignments, **numbers)
    check_and_warn(plan)
    if plan.loop.in_python:
        tell(IN_PYTHON)
    with stoppable() as stop, open_store(output / plan.name, plan.text, plan.loop.fingerprint) as store:
        with workers_of(plan, cores, scheduler) as workers:
            carry_out(plan, store, workers, stop)
        summary = summarised(plan, store.column)
        write_text(store.folder / "summary.json", json_text(asdict(summary), indent=1) + "\n")
        plots, page = sweep_plots(plan, store.column, summary), store.folder / "report.html"
        write_overview(plan, summary, plots, store.folder / "overview.png")
        write_page(plan, summary, plots, page)
    text = f"{table(plan, summary)}\nopen {page}; all runs: {store.table}"
    return Result(text, {**asdict(summary), "page": page, "table": store.table})


def check_and_warn(plan: Sweep) -> None:
    """Raise ParameterError for friction that is too stiff; name identified parameters that are not drawn."""
    plan.refuse_stiff_friction()
    if plan.identified is not None and plan.identified.left_out:
        tell(f"identified, but not drawn: {', '.join(plan.identified.left_out)}")


def workers_of(plan: Sweep, cores: int, scheduler: str | None) -> AbstractContextManager[Workers]:
    """Return the workers of a sweep: a cluster, or threads of this process, for which its loop is compiled."""
    if scheduler is not None:
        return cluster(scheduler)
    plan.build()
    return threads(cores)


def jobs_of(plan: Sweep) -> dict[str, tuple[Sweep, int, int]]:
    """Return the jobs of a sweep by their keys, arguments of Sweep.part: (begin, end) of a part of its runs."""
    parts = divided(0, plan.runs, min(LARGEST_PART, max(SMALLEST_PART, plan.runs // PARTS)))
    return {f"{begin:09d}-{end:09d}": (plan, begin, end) for begin, end in parts}


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
            store.run(workers, Sweep.part, jobs, stop, lambda columns: bar.update(len(columns["run"])))
    if jobs:
        store.write_table(list(jobs))
    store.remove_parts()
    return store.table


def table(plan: Sweep, summary: Summary) -> str:
    """Format the results as a table."""
    stopped = f", a limit stopped {summary.stopped}" if summary.stopped else ""
    interval = f"(95 %: {percent(summary.low)} to {percent(summary.high)})"
    rows = [["", "median", "95 %", "99 %", "worst"]]
    rows += [[f"  {name}", *(shown(q, OUTCOMES[name][1], plan) for q in summary.quantiles[name])] for name in IN_TABLE]
    effects = [["  most influential" + " (estimate)" * (summary.runs < ENOUGH), "success", "rms error"]]
    effects += [[f"  {one.name}", percent(one.success, 0), percent(one.error, 0)] for one in summary.effects[:5]]
    first = f"{headline(plan, summary)} {interval}, {summary.stable} are stable{stopped}"
    return "\n".join([first, *aligned(rows), *aligned(effects)])


def headline(sweep: Sweep, summary: Summary) -> str:
    """Return the result of a sweep as a sentence."""
    return f"{sweep.name}: {percent(summary.succeeded / summary.runs)} of {summary.runs:,} runs succeed"


def write_page(sweep: Sweep, summary: Summary, plots: Sequence[Plot], path: Path) -> None:
    """Write the page as one self-contained file; its sentences are in the template."""
    sizes = zip(np.asarray(sweep.loop.lost), sweep.scenario.robot.units, strict=True)
    html.write_page(
        path,
        "sweep.html",
        headline(sweep, summary),
        plots,
        sweep=sweep,
        summary=summary,
        outcomes=OUTCOMES,
        shown=partial(shown, sweep=sweep),
        unit_of=partial(unit_of, sweep),
        lost=joined(f"{size:.3g} {unit.position}" for size, unit in sizes),
        fixed=[f"{name} is {one.as_yaml}" for name, one in sweep.vary.items() if one.kind == FIXED],
        json=finite(asdict(summary)),
    )


def sweep_plots(sweep: Sweep, column: ReadColumn, summary: Summary) -> list[Plot]:
    """Return the plots: of each of the PLOTTED most influential parameters, then of all runs."""
    rms = 1e3 * np.max([column(f"rms.{joint}") for joint in sweep.scenario.joints], axis=0)
    success, plots = column("success"), []
    logarithmic = {each.column for each in sweep.drawn if each.distribution.kind == LOG_UNIFORM}
    for i, effect in enumerate(summary.effects[:PLOTTED]):
        log = effect.name in logarithmic
        plots += [_share(sweep, i, effect, log), _runs(sweep, i, effect, log, column(effect.name), rms, success)]
    plots.append(_distribution(sweep, rms, success))
    return [plot for plot in plots if not plot.is_empty]


def _share(sweep: Sweep, number: int, effect: Effect, log: bool) -> Plot:
    """Plot the success rate over a parameter, in bins of equal probability."""
    lines = [
        Line("95 % interval", _held(effect.high), GOOD, 0.8, step=True),
        Line("", _held(effect.low), GOOD, 0.8, step=True),
        Line("success", _held(effect.share), GOOD, 2.0, step=True),
    ]
    return Plot(
        f"share-{number}",
        f"{effect.name} explains {percent(effect.success, 0)} of the variance of success",
        "Success rate in bins of equal probability, with its 95 % interval.",
        effect.edges,
        lines,
        x_label=_label(sweep, effect.name),
        y_label="success rate [%]",
        x_log=log,
        y_range=(-3.0, 103.0),
        time=False,
        band=(0, 1),
    )


def _held(shares: Array) -> Array:
    """Return shares of the bins as percentages at the edges."""
    return 100.0 * np.append(shares, shares[-1:])


def _runs(
    sweep: Sweep, number: int, effect: Effect, log: bool, values: Array, rms: Array, success: NDArray[np.bool_]
) -> Plot:
    """Plot the first DOTS runs as dots over a parameter."""
    order = np.argsort(values[:DOTS], kind="stable")
    drawn, error, good = values[order], rms[order], success[order]
    stable = np.isfinite(error) & (error > 0)
    edge = ABOVE * float(error[stable].max(initial=1e-12))
    lines = [
        Line("succeeds", np.where(good & stable, error, np.nan), GOOD, dots=True),
        Line("fails", np.where(~good & stable, error, np.nan), BAD, dots=True),
        Line("unstable (upper edge)", np.where(stable, np.nan, edge), LOST, dots=True),
    ]
    seen = [line for line in lines if np.isfinite(line.values).any()]
    return Plot(
        f"runs-{number}",
        f"{effect.name} explains {percent(effect.error, 0)} of the variance of log RMS error",
        f"One dot per run{f', the first {DOTS}' if len(values) > DOTS else ''}.",
        drawn,
        [Line("run", order.astype(float), "grey", unseen=True), *seen],
        x_label=_label(sweep, effect.name),
        y_label=f"{ERROR} [{sweep.units('mrad')}]",
        x_log=log,
        y_log=True,
        time=False,
    )


def _distribution(sweep: Sweep, rms: Array, success: NDArray[np.bool_]) -> Plot:
    """Plot a histogram of the errors of the stable runs."""
    stable = np.isfinite(rms) & (rms > 0)
    errors = rms[stable] if stable.any() else np.ones(1)
    edges = np.geomspace(errors.min() / 1.001, errors.max() * 1.001, BINS + 1)
    good, bad = (np.histogram(rms[which], edges)[0] for which in (stable & success, stable & ~success))
    lines = [
        Line("succeed", np.append(good, 0.0), GOOD, 1.2, step=True, fill=True),
        Line("fail", np.append(bad, 0.0), BAD, 1.2, step=True, fill=True),
    ]
    return Plot(
        "distribution",
        f"{percent(float(stable.mean()))} of the runs are stable",
        "Stable runs by their error; log axis.",
        edges,
        lines,
        x_label=f"{ERROR} [{sweep.units('mrad')}]",
        y_label="runs",
        x_log=True,
        time=False,
        y_range=(0.0, None),
        wide=True,
    )


def unit_of(sweep: Sweep, column: str) -> str:
    """Return the unit of a drawn number, NAME or NAME.JOINT; "" for factors. A direction is in rad on every arm."""
    name, _, joint = column.partition(".")
    unit = PARAMETERS[name].unit if name in PARAMETERS else ""
    return unit if name == "gravity_direction" else sweep.units(unit, joint)


def _label(sweep: Sweep, name: str) -> str:
    unit = unit_of(sweep, name)
    return f"{name} [{unit}]" if unit else f"{name} (factor)"


def write_overview(sweep: Sweep, summary: Summary, plots: Sequence[Plot], path: Path) -> None:
    """Write the picture: a column for each parameter that has plots, the most influential one first."""
    places = {plot.name: plot for plot in plots}
    columns = min(PLOTTED, len(summary.effects)) + 1
    names = [[f"{row}-{column}" for column in range(columns - 1)] for row in ("share", "runs")]

    def draw(figure: Figure) -> None:
        axes = figure.subplots(2, columns, squeeze=False)
        for row, ax in zip([*names[0], "", *names[1], "distribution"], axes.flat, strict=True):
            if row in places:
                draw_plot(ax, places[row], WIDTH)
        _indices(axes[0, -1], summary)
        title = f"{headline(sweep, summary)}, each of {sweep.duration:g} s"
        figure.suptitle(title, fontsize=13, x=0.01, ha="left")

    write_picture(path, (3.1 * columns, 7.0), draw)


def _indices(ax: Axes, summary: Summary) -> None:
    effects = summary.effects[: 2 * PLOTTED][::-1]
    rows = np.arange(len(effects))
    ax.barh(rows + 0.2, [100 * effect.success for effect in effects], 0.36, color=COLOURS[1], label="success")
    ax.barh(rows - 0.2, [100 * effect.error for effect in effects], 0.36, color=GREY, label="log RMS error")
    ax.set_yticks(rows, [effect.name for effect in effects])
    ax.set(title="What each explains alone", xlabel="share of the variance [%]", xlim=(0, 100))
    ax.grid(axis="y", visible=False)
    ax.legend(loc="lower right", **LEGEND)
