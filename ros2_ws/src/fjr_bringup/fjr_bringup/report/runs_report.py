# SPDX-License-Identifier: Apache-2.0
"""The page that shows several runs side by side: comparison.html."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path

from fjr_bringup.analysis import headlines
from fjr_bringup.analysis.metrics import Energy, Report, Storage
from fjr_bringup.formatting import milliseconds, number, percent
from fjr_bringup.report import html
from fjr_bringup.report.figure import colour
from fjr_bringup.report.runs_figures import Compared, side_by_side_plots

COLOURED = {"holding": "ok", "degraded": "maybe", "violated": "no", "unknown": "maybe"}
HOW = (
    "Drag over a plot to enlarge it, double-click to go back; a click on a name hides its line. "
    "The names of the runs lead to their own pages. Needs no network."
)
Row = tuple[str, Callable[[Report], str]]

ROWS: tuple[Row, ...] = (
    ("verdict", lambda r: _verdict(r)),
    ("joints", lambda r: str(len(r.joints))),
    ("duration", lambda r: number(r.duration_s, "s")),
    ("sample period", lambda r: number(r.sample_period_s * 1e3, "ms") + (", lock-step" if r.lockstep else "")),
    ("Tracking", str),
    ("error at the start", headlines.initial_error),
    ("settled within 2 % after", lambda r: number(r.tracking.settling_time_2_percent_s, "s")),
    ("largest error after 2 s", headlines.steady_error),
    ("RMS error after 2 s", lambda r: number(r.tracking.rms_error_after_2s_rad, headlines.position_unit(r))),
    ("Effort", str),
    ("peak effort", headlines.peak_effort),
    ("largest share of a limit", lambda r: headlines.effort_share(r) or number(None)),
    ("commands at a limit", lambda r: percent(r.tracking.saturated_fraction)),
    ("Certificate", str),
    ("decay of V, measured", lambda r: number(_of(r.storage, "measured_decay_rate_per_s"), "1/s")),
    ("decay of V, at least", lambda r: _least(r)),
    ("V leaves its bound at", lambda r: number(_of(r.storage, "leaves_bound_at_s"), "s")),
    ("power left over, of that supplied", lambda r: percent(_of(r.energy, "rms_residual_of_supplied"))),
    ("Timing", str),
    ("states missing", lambda r: f"{r.counts.missing} of {r.counts.nominal}"),
    ("answered in time", lambda r: percent(r.counts.answered_in_time_fraction)),
    ("state to command, 50 %", lambda r: milliseconds(r.timing.latency_p50_us)),
    ("state to command, 99 %", lambda r: milliseconds(r.timing.latency_p99_us)),
    ("longest gap", lambda r: number(r.counts.longest_gap_s * 1e3, "ms")),
)


def write_comparison(path: Path, runs: Sequence[Compared]) -> None:
    """Write the page of two runs or more."""
    title = " · ".join(run.label for run in runs)
    body = [
        html.header(f"Comparison of {len(runs)} runs", title, None, _notes(runs)),
        html.table("Side by side", ["", *(_name(run, i, path.parent) for i, run in enumerate(runs))], _rows(runs)),
        '<h2 class="section">In the same axes</h2>',
        html.figures(),
        html.footer(HOW),
    ]
    html.write_page(path, title, body, side_by_side_plots(runs))


def _rows(runs: Sequence[Compared]) -> list[list[str]]:
    return [[what] if of is str else [what, *(of(run.report) for run in runs)] for what, of in ROWS]


def _notes(runs: Sequence[Compared]) -> list[str]:
    return [f"{run.label}: {note}" for run in runs for note in run.report.missing]


def _name(run: Compared, number: int, folder: Path) -> str:
    link = escape(Path(os.path.relpath(run.page, folder)).as_posix(), quote=True)
    return f'{html.swatch(colour(number))}<a href="{link}">{escape(run.label)}</a>'


def _verdict(report: Report) -> str:
    if report.stop:
        return (
            f'<span class="no" title="{escape(report.stop.sentence, quote=True)}">{escape(report.stop.heading)}</span>'
        )
    verdict = report.verdict
    words = html.HEADINGS[verdict.kind] + (f":<br>{escape(verdict.detail)}" if verdict.detail else "")
    return f'<span class="{COLOURED[verdict.kind]}" title="{escape(verdict.sentence, quote=True)}">{words}</span>'


def _of(part: Storage | Energy | None, name: str) -> float | None:
    return None if part is None else getattr(part, name)


def _least(report: Report) -> str:
    storage = report.storage
    if storage is None:
        return number(None)
    basis = "proven" if storage.guarantee_is_proven else "sampled"
    return f"{number(storage.guaranteed_decay_rate_per_s, '1/s')} ({basis})"
