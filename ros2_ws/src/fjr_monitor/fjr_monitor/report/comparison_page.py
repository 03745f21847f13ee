# SPDX-License-Identifier: Apache-2.0
"""Page that compares several runs, comparison.html, with its plots and the claim of the paper's simulations.

Paper, section 4: with K = 3.1 in place of 31 N m/rad the loop still converges and the transient time is maintained, but
the effort overshoots considerably more.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from fjr_core.config.scenario import Scenario
from fjr_core.model.joints import joined
from fjr_core.numerics.checks import Array
from fjr_core.numerics.one_line import at_least
from fjr_monitor.recording.files import Times
from fjr_monitor.recording.signals import END
from fjr_monitor.report import html
from fjr_monitor.report.html import DRAWN, Line, Plot, colour, decimated, drawable
from fjr_monitor.report.metrics import Report
from fjr_monitor.report.shown import PAGE, RunSummary
from fjr_msgs_py.console.output import DASH, number

SAME = 0.2  # largest relative difference of two settling times that count as equal
COLOURED = {"holding": "ok", "degraded": "maybe", "violated": "no", "unknown": "maybe", "late": "maybe"}
POINTS = 240  # of a distribution curve
SHORTEST = 1e-3  # ms
TRANSIENT = 0.6  # s
DIFFERING, LONGEST = 12, 80  # parameters that differ, characters of a value


@dataclass(frozen=True)
class Claim:
    """The paper's claim in one sentence. kind: holding if the runs show it, else unknown. title: of the page, if so."""

    kind: str
    heading: str
    sentence: str
    title: str = ""


def paper_claim(stiff: Report, soft: Report, stiffness: tuple[float, float]) -> Claim:
    """Return the claim for two runs with the same law and gains; stiffness of their joints [N m/rad], stiff first."""
    reasons = [*_reasons(stiff, soft)]
    storages = [each.storage for each in (stiff, soft) if each.storage is not None]
    if reasons or len(storages) < 2:
        return Claim("unknown", "The paper's claim is not shown", f"{'; '.join(reasons)}.")
    softer = number(stiffness[0] / stiffness[1], digits=2)
    efforts = f"from {stiff.peak_effort()} to {soft.peak_effort()}"
    settled = _both([each.tracking.settling_time_2_percent_s for each in (stiff, soft)], "s")
    decay = _both([each.measured_decay_rate_per_s for each in storages], "1/s")
    least = f"{at_least(min(each.guaranteed_decay_rate_per_s for each in storages), 3)} 1/s"
    basis = "proven" if all(each.guarantee_is_proven for each in storages) else "sampled"
    sentence = (
        f"The same law with the same gains tracks with a joint {softer} times softer: with "
        f"{_both(stiffness, 'N m/rad')} the link error settles within 2 % of its start in {settled}, V decays at "
        f"{decay} ({basis}: at least {least}), and the peak effort rises {efforts}."
    )
    title = f"A joint {softer} times softer: the link moves alike, the effort rises {efforts}"
    return Claim("holding", "The paper's claim", sentence, title)


def _both(values: Sequence[float | None], unit: str) -> str:
    """Format two values as 40.6 and 72.3 1/s, or one if they read the same."""
    texts = list(dict.fromkeys(map(number, values)))
    return f"{' and '.join(texts)} {unit}"


def _reasons(stiff: Report, soft: Report) -> Iterator[str]:
    """Yield why the runs do not show the claim."""
    for each in (stiff, soft):
        storage, settled = each.storage, each.tracking.settling_time_2_percent_s
        if each.stop:
            yield f"{each.scenario}: {each.stop.heading}"
        elif each.advice:
            yield f"{each.scenario}: {each.advice}"
        elif each.status not in ("holding", "degraded"):
            yield f"{each.scenario}: {each.verdict.sentence.rstrip('.')}"
        elif settled is None:
            yield f"{each.scenario}: the link error does not settle within {number(each.duration_s, 's')}"
        elif storage is None or (storage.measured_decay_rate_per_s or 0.0) < storage.guaranteed_decay_rate_per_s:
            yield f"{each.scenario}: V does not decay at the guaranteed rate"
    times = [each.tracking.settling_time_2_percent_s for each in (stiff, soft)]
    if None not in times and abs(times[0] - times[1]) > SAME * max(times):  # type: ignore[operator,type-var]
        yield f"the transients differ: {number(times[0], 's')} and {number(times[1], 's')}"


def write_comparison(path: Path, runs: Sequence[RunSummary], claim: Claim | None = None) -> None:
    """Write the page of two runs or more; claim: what the first two show together. Raises AssetError."""
    labels = " · ".join(run.label for run in runs)
    plots = [*(transients(runs[:2]) if claim else []), *side_by_side_plots(runs)]
    links = [quote(Path(os.path.relpath(run.folder / PAGE, path.parent)).as_posix()) for run in runs]
    notes = [f"{run.label}: {note}" for run in runs for note in (*run.notes, *run.report.missing)]
    title = claim.title if claim and claim.title else labels
    given: dict[str, Any] = {"labels": labels, "claim": claim, "runs": runs, "links": links, "colours": COLOURED}
    given["differences"] = differences(runs)
    html.write_page(path, "runs.html", title, plots, notes=notes, **given)


def differences(runs: Sequence[RunSummary]) -> list[tuple[str, ...]]:
    """Return name and value in each run of the parameters that differ; the last row counts those after DIFFERING."""
    scenarios = [run.data.run.scenario for run in runs]
    names = dict.fromkeys(name for each in scenarios for name in (*each.controller_values, *each.plant_values))
    rows = [(name, *(_value(each, name) for each in scenarios)) for name in names]
    rows = [row for row in rows if len(set(row[1:])) > 1]
    shown = [(row[0], *_cut(row[1:])) for row in rows[:DIFFERING]]
    more = len(rows) - len(shown)
    return [*shown, (f"and {more} more", *("" for _ in runs))] if more else shown


def _cut(values: Sequence[str]) -> list[str]:
    """Return at most LONGEST characters of each value; of longer ones from shortly before the first difference on."""
    same = len(os.path.commonprefix(values)) if max(map(len, values)) > LONGEST else 0
    start = max(0, same - LONGEST // 4)
    return [value[start : start + LONGEST] for value in values]


def _value(scenario: Scenario, name: str) -> str:
    """Return the value of a parameter, of both nodes if it differs between them; a dash if the scenario has none."""
    nodes = scenario.controller_values, scenario.plant_values
    found = [values[name] for values in nodes if name in values]
    texts = (f"[{', '.join(map(str, each))}]" if isinstance(each, (tuple, list)) else str(each) for each in found)
    return ", plant: ".join(dict.fromkeys(" ".join(text.split()) for text in texts)) or DASH


def side_by_side_plots(runs: Sequence[RunSummary]) -> list[Plot]:
    """Return the plots that are not empty, in the order of the page."""
    errors = [1e3 * run.data.states["largest_error"] for run in runs]
    efforts = [run.data.states["largest_effort"] for run in runs]
    latencies = [run.data.run.signals.latencies for run in runs]
    periods = [run.data.run.signals.periods for run in runs]
    largest = "The largest {} of all joints at each state; log axis."
    error, effort = f"error [{_units(runs, 'position', 'm')}]", f"|u| [{_units(runs, 'effort')}]"
    drawn = [
        _over_time("error", "Tracking error", largest.format("|q_l − q_ld|"), runs, errors, error),
        _over_time("effort", "Effort", largest.format("|u|"), runs, efforts, effort),
        storages(runs),
        _distribution("latency", "From state to command", "answered later", runs, latencies),
        _distribution("period", "From state to state", "that came later", runs, periods),
    ]
    return [plot for plot in drawn if not plot.is_empty]


def transients(runs: Sequence[RunSummary]) -> list[Plot]:
    """Return the plots of link position and effort of one joint over the first TRANSIENT seconds, on linear axes."""
    times = np.unique(np.concatenate([run.data.states["t"] for run in runs]))
    times = times[times <= TRANSIENT]
    links, efforts = (_lines(runs, times, [run.data.states[name][:, 0] for run in runs], 2.0) for name in ("q_l", "u"))
    reference = runs[0].data.states
    desired = Line("reference", np.interp(times, reference["t"], reference["q_ld"][:, 0]), "grey", 4.0)
    position, effort = (f"{symbol} [{_units(runs, what)}]" for symbol, what in (("q_l", "position"), ("u", "effort")))
    alike, apart = "Link position: both joints converge alike", "Effort: the softer joint needs far more"
    return [
        Plot("positions", alike, "The first joint.", times, [desired, *links], y_label=position, place="claim"),
        Plot("efforts", apart, "The first joint.", times, efforts, y_label=effort, place="claim"),
    ]


def _units(runs: Sequence[RunSummary], what: str, prefix: str = "") -> str:
    return joined(prefix + getattr(each, what) for run in runs for each in run.data.run.units)


def storages(runs: Sequence[RunSummary]) -> Plot:
    """Plot V / V(0), with the bounds dashed."""
    relative = [drawable(run.data.relative_storage, log=True) for run in runs]
    floor = min(float(np.nanmin(values, initial=1e-3)) for values in relative) / 30.0
    caption = "V relative to its start; dashed: the bound exp(−2βt) of each run."
    plot = _over_time("storage", "Storage V and its bound", caption, runs, relative, "V(t) / V(0)")
    lines = [*plot.lines]
    for i, data in enumerate(run.data for run in runs):
        bound = np.exp(-2.0 * data.metrics.beta * plot.x)
        shown = (data.states["V"][0] > 0) & (bound > floor) & (plot.x <= data.run.seconds)
        lines.append(Line("", np.where(shown, bound, np.nan), colour(i), 1.2, (6, 4)))
    return replace(plot, lines=lines)


def _over_time(
    name: str, title: str, caption: str, runs: Sequence[RunSummary], values: Sequence[Array], label: str
) -> Plot:
    """Plot values over the union of the runs' times."""
    rows = [decimated([column], DRAWN // len(runs)) for column in values]
    times = np.unique(np.concatenate([run.data.states["t"][keep] for run, keep in zip(runs, rows, strict=True)]))
    return Plot(name, title, caption, times, _lines(runs, times, values, 1.3), y_label=label, y_log=True)


def _lines(runs: Sequence[RunSummary], times: Array, values: Sequence[Array], width: float) -> list[Line]:
    """Return the lines of the runs' values at times (k,); gaps outside of a run."""
    return [
        Line(run.label, np.interp(times, run.data.states["t"], column, np.nan, np.nan), colour(i), width)
        for i, (run, column) in enumerate(zip(runs, values, strict=True))
    ]


def _distribution(name: str, title: str, what: str, runs: Sequence[RunSummary], values: Sequence[Times]) -> Plot:
    """Plot the share of the states whose value [ns] is larger than a time."""
    low = max(min(1.0, *(1e-6 * each.min(initial=END) for each in values)), SHORTEST)
    high = max(SHORTEST, *(1e-6 * each.max(initial=0) for each in values))
    times = np.asarray(np.geomspace(low / 1.05, max(high, low) * 1.05, POINTS), dtype=np.float64)
    lines = [
        Line(run.label, 100.0 - 100.0 * np.searchsorted(np.sort(each), times * 1e6, "right") / len(each), colour(i))
        for i, (run, each) in enumerate(zip(runs, values, strict=True))
        if len(each)
    ]
    caption = f"Share of the states {what} than the time on the axis; both axes log."
    axes = {"x_label": "time [ms]", "y_label": "states [%]", "x_log": True, "y_log": True, "time": False}
    return Plot(name, title, caption, times, lines, **axes)  # type: ignore[arg-type]
