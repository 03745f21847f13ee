# SPDX-License-Identifier: Apache-2.0
"""Page of one run: report.html."""

from __future__ import annotations

from pathlib import Path

from fjr_core.numerics.one_line import at_least
from fjr_monitor.analysis import headlines
from fjr_monitor.analysis.metrics import Report
from fjr_monitor.report import html
from fjr_monitor.report.arm_replay import ArmReplay
from fjr_monitor.report.run_figures import run_plots
from fjr_monitor.report.shown import Shown
from fjr_msgs_py.console.output import milliseconds, number, percent, sentence
from fjr_msgs_py.console.provenance import without_home

FOOTER = (
    "Drag over a plot to enlarge it, double-click to go back; a click on a name hides its line. "
    "All plots over time zoom together. Computed by fjr report from the bag and the scenario alone; needs no network."
)


def write_run_page(path: Path, data: Shown, report: Report, arm: ArmReplay | None = None) -> None:
    """Write the page of a run, with the arm in 3D if it is given; raises AssetError."""
    html.write_page(
        path,
        "run.html",
        f"{report.scenario}: {report.stop.heading if report.stop else html.HEADINGS[report.status]}",
        run_plots(data, report),
        arm,
        report=report,
        kicker=f"Tracking report · {without_home(report.bag)} · {number(report.duration_s, 's')}",
        heading=title(report),
        notes=[
            *([f"The run ended early: {report.failure}"] if report.failure else []),
            *report.missing,
            *map(sentence, report.guesses),
        ],
        tiles=tiles(report),
        position=headlines.position_unit(report),
        effort=headlines.effort_unit(report),
        json=html.as_json(report.as_json()),
        footer=FOOTER,
    )


def title(report: Report) -> str:
    """Return scenario, number of joints, sample rate and clock."""
    clock = "in lock-step" if report.lockstep else "in real time"
    joints = "one joint" if len(report.joints) == 1 else f"{len(report.joints)} joints"
    return f"{report.scenario}: {joints}, {number(1.0 / report.sample_period_s, 'Hz', 4)} {clock}"


def tiles(report: Report) -> list[tuple[str, str]]:
    """Return the most important results, each with its meaning."""
    tracking, storage, timing, counts = report.tracking, report.storage, report.timing, report.counts
    shown = [
        (number(tracking.settling_time_2_percent_s, "s"), "settled within 2 % of the initial error"),
        (number(tracking.rms_error_after_2s_rad, headlines.position_unit(report)), "RMS error after 2 s"),
        (headlines.peak_effort(report), ", ".join(filter(None, ("peak effort", headlines.effort_share(report))))),
    ]
    if storage is not None:
        basis = "proven" if storage.guarantee_is_proven else "sampled"
        least = f"decay of V; {basis}: at least {at_least(storage.guaranteed_decay_rate_per_s, 3)} 1/s"
        shown.append((number(storage.measured_decay_rate_per_s, "1/s"), least))
    return [
        *shown,
        (percent(counts.answered_in_time_fraction), f"answered in time, of {counts.nominal}"),
        (
            f"{milliseconds(timing.latency_p50_us)}",
            f"state to command; 99\N{NO-BREAK SPACE}%: {milliseconds(timing.latency_p99_us)}",
        ),
    ]
