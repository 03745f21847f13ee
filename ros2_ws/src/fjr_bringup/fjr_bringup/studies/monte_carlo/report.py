# SPDX-License-Identifier: Apache-2.0
"""HTML page of a Monte-Carlo study."""

from __future__ import annotations

from base64 import b64encode
from pathlib import Path

from fjr_bringup.formatting import number, percent
from fjr_bringup.report import html
from fjr_bringup.studies.monte_carlo.store import Store
from fjr_core.experiments.monte_carlo.distributions import FIXED
from fjr_core.experiments.monte_carlo.sensitivity import Summary
from fjr_core.experiments.monte_carlo.sweep import Sweep
from fjr_core.simulation.batch.draws import UNITS

ROWS = {
    "rms": ("RMS error", "rad"),
    "peak": ("largest error", "rad"),
    "final": ("mean error of the last second", "rad"),
    "settling": ("settling time", "s"),
    "effort_rms": ("RMS effort", "N m"),
    "effort_peak": ("peak effort", "N m"),
    "power": ("mean power", "W"),
}
HOW = (
    "Top row of the figure: success rate over the range of a drawn parameter, with its 95 % interval. Below: one dot "
    "per run, blue if it succeeds; crosses at the upper edge are unstable runs. Right: share of the variance of "
    "success and of log RMS error that each parameter explains alone (first-order sensitivity)."
)


def write_page(store: Store, summary: Summary, picture: Path, path: Path) -> Path:
    """Write the page as one self-contained file."""
    sweep = store.sweep
    title = f"{sweep.name}: {percent(summary.succeeded / summary.runs)} of {summary.runs:,} runs succeed"
    image = b64encode(picture.read_bytes()).decode()
    outcomes = [
        [what, *(number(value, unit) for value in summary.quantiles[name])] for name, (what, unit) in ROWS.items()
    ]
    html.write_page(
        path,
        "monte_carlo.html",
        title,
        [],
        kicker=f"Monte-Carlo study of {summary.runs:,} runs",
        notes=_notes(sweep),
        tiles=_tiles(summary),
        picture=image,
        tables=[
            ("Stable runs, worst joint", ["", "median", "95 %", "99 %", "worst"], outcomes),
            (
                "Drawn parameters and their influence",
                ["", "from", "to", "success", "log RMS error"],
                _drawn(sweep, summary),
            ),
        ],
        json=html.as_json(summary.as_json()),
        footer=HOW,
    )
    return path


def _notes(sweep: Sweep) -> list[str]:
    limits = "".join(f", {ROWS[name][0]} at most {limit:g} {ROWS[name][1]}" for name, limit in sweep.success.items())
    wanted = f"a run succeeds when it is stable{limits}"
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


def _drawn(sweep: Sweep, summary: Summary) -> list[list[str]]:
    return [
        [
            effect.name,
            number(float(effect.edges[0]), _unit(effect.name)),
            number(float(effect.edges[-1]), _unit(effect.name)),
            percent(effect.success, 1),
            percent(effect.error, 1),
        ]
        for effect in summary.effects
    ]
