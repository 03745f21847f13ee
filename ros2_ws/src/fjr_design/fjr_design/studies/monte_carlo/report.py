# SPDX-License-Identifier: Apache-2.0
"""HTML page of a Monte-Carlo study."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from fjr_core.simulation.batch.draws import UNITS
from fjr_design.experiments.monte_carlo.distributions import FIXED
from fjr_design.experiments.monte_carlo.sensitivity import Summary
from fjr_design.experiments.monte_carlo.sweep import Sweep
from fjr_design.studies.monte_carlo.store import Store
from fjr_monitor.report import html
from fjr_monitor.report.html import Plot
from fjr_msgs_py.console.output import number, percent

ROWS = {
    "rms": ("RMS error", "rad"),
    "peak": ("largest error", "rad"),
    "final": ("mean error of the last second", "rad"),
    "settling": ("settling time", "s"),
    "effort_rms": ("RMS effort", "N m"),
    "effort_peak": ("peak effort", "N m"),
    "power": ("mean power", "W"),
}
INFLUENCE = (
    "Share of the variance of success, and of log RMS error, that each parameter explains alone (first-order "
    "sensitivity)."
)
HOW = (
    "Drag over a plot to enlarge it, double-click to go back; a click on a name hides its line. The same runs are in "
    "table.parquet and summary.json in the same folder. Needs no network."
)


def headline(store: Store, summary: Summary) -> str:
    """Return the result of a study as a sentence."""
    return f"{store.sweep.name}: {percent(summary.succeeded / summary.runs)} of {summary.runs:,} runs succeed"


def write_page(store: Store, summary: Summary, plots: Sequence[Plot], path: Path) -> Path:
    """Write the page as one self-contained file."""
    sweep = store.sweep
    outcomes = [
        [what, *(number(value, unit) for value in summary.quantiles[name])] for name, (what, unit) in ROWS.items()
    ]
    html.write_page(
        path,
        "monte_carlo.html",
        headline(store, summary),
        plots,
        kicker=f"Monte-Carlo study of {summary.runs:,} runs",
        notes=_notes(sweep),
        tiles=_tiles(summary),
        tables=[("Stable runs, worst joint", ["", "median", "95 %", "99 %", "worst"], outcomes)],
        effects=_drawn(summary),
        influence_text=INFLUENCE,
        json=html.as_json(summary.as_json()),
        footer=HOW,
    )
    return path


def _notes(sweep: Sweep) -> list[str]:
    limits = "".join(f", {ROWS[name][0]} at most {limit:g} {ROWS[name][1]}" for name, limit in sweep.success.items())
    wanted = f"a run succeeds when it is stable, not stopped by a limit of the controller{limits}"
    fixed = [f"{name} is {one.as_yaml}" for name, one in sweep.vary.items() if one.kind == FIXED]
    return [
        wanted,
        f"errors are evaluated from {sweep.settle_after:g} s on; unstable: beyond {sweep.lost:.3g} rad",
        *fixed,
    ]


def _tiles(summary: Summary) -> list[tuple[str, str]]:
    interval = f"{percent(summary.low)} to {percent(summary.high)}"
    return [
        (percent(summary.succeeded / summary.runs), "succeed"),
        (interval, "95 % interval of that share"),
        (percent(summary.stable / summary.runs), "are stable"),
        (number(summary.quantiles["rms"][1], "rad"), "RMS error that 95 % of the stable runs keep"),
    ]


def _unit(name: str) -> str:
    return UNITS.get(name.partition(".")[0], "")


def _drawn(summary: Summary) -> list[tuple[str, str, str, float, float]]:
    """Return name, range and influence on success and error of each parameter."""
    return [
        (
            effect.name,
            number(float(effect.edges[0]), _unit(effect.name)),
            number(float(effect.edges[-1]), _unit(effect.name)),
            effect.success,
            effect.error,
        )
        for effect in summary.effects
    ]
