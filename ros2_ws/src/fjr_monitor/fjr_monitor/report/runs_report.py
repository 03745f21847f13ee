# SPDX-License-Identifier: Apache-2.0
"""Page that compares several runs, with its plots: comparison.html."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fjr_core.model.robot import joined
from fjr_core.numerics.checks import Array
from fjr_core.numerics.one_line import at_least
from fjr_monitor.analysis import headlines
from fjr_monitor.analysis.metrics import Energy, Report, Storage
from fjr_monitor.analysis.timing import Distribution
from fjr_monitor.plotting.figure import DRAWN, Line, Plot, colour, decimated, drawable
from fjr_monitor.report import html
from fjr_monitor.report.paper_claim import Claim
from fjr_monitor.report.shown import Shown
from fjr_msgs_py.console.output import milliseconds, number, percent

COLOURED = {"holding": "ok", "degraded": "maybe", "violated": "no", "unknown": "maybe", "late": "maybe"}
FOOTER = (
    "Drag over a plot to enlarge it, double-click to go back; a click on a name hides its line. "
    "The names of the runs lead to their own pages. Needs no network."
)
Row = tuple[str, Callable[[Report], str]]

ROWS: dict[str, tuple[Row, ...]] = {
    "": (
        ("joints", lambda r: str(len(r.joints))),
        ("duration", lambda r: number(r.duration_s, "s")),
        ("sample period", lambda r: number(r.sample_period_s * 1e3, "ms") + (", lock-step" if r.lockstep else "")),
    ),
    "Tracking": (
        ("error at the start", headlines.initial_error),
        ("settled within 2 % after", lambda r: number(r.tracking.settling_time_2_percent_s, "s")),
        ("largest error after 2 s", headlines.steady_error),
        ("RMS error after 2 s", lambda r: number(r.tracking.rms_error_after_2s_rad, headlines.position_unit(r))),
    ),
    "Effort": (
        ("peak effort", headlines.peak_effort),
        ("largest share of a limit", lambda r: headlines.effort_share(r) or number(None)),
        ("commands at a limit", lambda r: percent(r.tracking.saturated_fraction)),
    ),
    "Certificate": (
        ("decay of V, measured", lambda r: number(_of(r.storage, "measured_decay_rate_per_s"), "1/s")),
        ("decay of V, at least", lambda r: _least(r)),
        ("V leaves its bound at", lambda r: number(_of(r.storage, "leaves_bound_at_s"), "s")),
        ("unexplained power, of that supplied", lambda r: percent(_of(r.energy, "rms_residual_of_supplied"))),
    ),
    "Timing": (
        ("states missing", lambda r: f"{max(r.counts.missing, 0)} of {r.counts.nominal}"),
        ("answered in time", lambda r: percent(r.counts.answered_in_time_fraction)),
        ("state to command, 50 %", lambda r: milliseconds(r.timing.latency_p50_us)),
        ("state to command, 99 %", lambda r: milliseconds(r.timing.latency_p99_us)),
        ("longest gap", lambda r: number(r.counts.longest_gap_s * 1e3, "ms")),
    ),
}


def write_comparison(path: Path, runs: Sequence[Compared], claim: Claim | None = None) -> None:
    """Write the page of two runs or more; claim: what the first two show together. Raises AssetError."""
    labels = " · ".join(run.label for run in runs)
    html.write_page(
        path,
        "runs.html",
        claim.title if claim and claim.title else labels,
        [*(transients(runs[:2]) if claim else []), *side_by_side_plots(runs)],
        kicker=f"Comparison of {len(runs)} runs: {labels}",
        notes=[f"{run.label}: {note}" for run in runs for note in (*run.notes, *run.report.missing)],
        claim=claim,
        runs=runs,
        links=[Path(os.path.relpath(run.page, path.parent)).as_posix() for run in runs],
        groups=ROWS.items(),
        colours=COLOURED,
        footer=FOOTER,
    )


def _of(part: Storage | Energy | None, name: str) -> float | None:
    return None if part is None else getattr(part, name)


def _least(report: Report) -> str:
    storage = report.storage
    if storage is None:
        return number(None)
    basis = "proven" if storage.guarantee_is_proven else "sampled"
    return f"{at_least(storage.guaranteed_decay_rate_per_s, 3)} 1/s ({basis})"


POINTS = 240  # of a distribution curve
SHORTEST = 1e-3  # ms
TRANSIENT = 0.6  # s


@dataclass(frozen=True)
class Compared:
    """One of several runs: unique label, data and report, path of its own page, notes on how it was made."""

    label: str
    data: Shown
    report: Report
    page: Path
    notes: tuple[str, ...] = ()


def side_by_side_plots(runs: Sequence[Compared]) -> list[Plot]:
    """Return the plots that are not empty, in the order of the page."""
    errors = [run.data.states["largest_error"] for run in runs]
    efforts = [run.data.states["largest_effort"] for run in runs]
    latencies = [run.data.metrics.clock.latencies for run in runs]
    periods = [run.data.metrics.clock.periods for run in runs]
    largest = "The largest {} of all joints at each state; log axis."
    error, effort = (f"{symbol} [{_units(runs, what)}]" for symbol, what in (("error", "position"), ("|u|", "effort")))
    drawn = [
        _over_time("error", "Tracking error", largest.format("|q_l − q_ld|"), runs, errors, error),
        _over_time("effort", "Effort", largest.format("|u|"), runs, efforts, effort),
        storages(runs),
        _distribution("latency", "From state to command", "answered later", runs, latencies),
        _distribution("period", "From state to state", "that came later", runs, periods),
    ]
    return [plot for plot in drawn if not plot.is_empty]


def transients(runs: Sequence[Compared]) -> list[Plot]:
    """Return the plots of link position and effort of one joint over the first TRANSIENT seconds, on linear axes."""
    shown = [(run, run.data.states["t"] <= TRANSIENT) for run in runs]
    times = np.unique(np.concatenate([run.data.states["t"][early] for run, early in shown]))
    reference = shown[0][0].data.states

    def lines(name: str) -> list[Line]:
        columns = [(run, run.data.states["t"], run.data.states[name][:, 0]) for run, _ in shown]
        return [
            Line(run.label, np.interp(times, t, column, np.nan, np.nan), colour(i), 2.0)
            for i, (run, t, column) in enumerate(columns)
        ]

    desired = Line("reference", np.interp(times, reference["t"], reference["q_ld"][:, 0]), "grey", 4.0)
    position, effort = (f"{symbol} [{_units(runs, what)}]" for symbol, what in (("q_l", "position"), ("u", "effort")))
    alike, apart = "Link position: both joints converge alike", "Effort: the softer joint needs far more"
    return [
        Plot("positions", alike, "The first joint.", times, [desired, *lines("q_l")], y_label=position, place="claim"),
        Plot("efforts", apart, "The first joint.", times, lines("u"), y_label=effort, place="claim"),
    ]


def _units(runs: Sequence[Compared], what: str) -> str:
    return joined(getattr(each, what) for run in runs for each in run.data.run.units)


def storages(runs: Sequence[Compared]) -> Plot:
    """Plot V / V(0), with the bounds dashed."""
    relative = [drawable(run.data.relative_storage, log=True) for run in runs]
    floor = min(float(np.nanmin(values, initial=1e-3)) for values in relative) / 30.0
    caption = "V relative to its start; dashed: the bound exp(−2βt) of each run."
    plot = _over_time("storage", "Storage V and its bound", caption, runs, relative, "V(t) / V(0)")
    decays = [run.data.metrics.decay for run in runs]
    bounds = [np.where(each.initial > 0, np.exp(-2.0 * each.beta * plot.x), np.nan) for each in decays]
    dashed = [
        Line(
            "", np.where((bound > floor) & (plot.x <= run.data.metrics.seconds), bound, np.nan), colour(i), 1.2, (6, 4)
        )
        for i, (run, bound) in enumerate(zip(runs, bounds, strict=True))
    ]
    return Plot(plot.name, plot.title, caption, plot.x, [*plot.lines, *dashed], y_label=plot.y_label, y_log=True)


def _over_time(
    name: str, title: str, caption: str, runs: Sequence[Compared], values: Sequence[Array], label: str
) -> Plot:
    """Plot values over the union of the runs' times."""
    rows = [decimated([column], DRAWN // len(runs)) for column in values]
    times = np.unique(np.concatenate([run.data.states["t"][keep] for run, keep in zip(runs, rows, strict=True)]))
    lines = [
        Line(run.label, np.interp(times, run.data.states["t"][keep], column[keep], np.nan, np.nan), colour(i), 1.3)
        for i, (run, keep, column) in enumerate(zip(runs, rows, values, strict=True))
    ]
    return Plot(name, title, caption, times, lines, y_label=label, y_log=True)


def _distribution(name: str, title: str, what: str, runs: Sequence[Compared], values: Sequence[Distribution]) -> Plot:
    """Plot the share of the states whose value [ms] is larger than a time."""
    low = max(min([1.0, *(each.least * 1e-6 for each in values)]), SHORTEST)
    high = max(SHORTEST, *(each.largest * 1e-6 for each in values))
    times = np.asarray(np.geomspace(low / 1.05, max(high, low) * 1.05, POINTS), dtype=np.float64)
    lines = [
        Line(run.label, 100.0 * each.above(times * 1e6), colour(i))
        for i, (run, each) in enumerate(zip(runs, values, strict=True))
        if each.count
    ]
    caption = f"Share of the states {what} than the time on the axis; both axes log."
    axes = {"x_label": "time [ms]", "y_label": "states [%]", "x_log": True, "y_log": True, "time": False}
    return Plot(name, title, caption, times, lines, **axes)  # type: ignore[arg-type]
