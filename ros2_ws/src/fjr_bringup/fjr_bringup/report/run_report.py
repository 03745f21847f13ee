# SPDX-License-Identifier: Apache-2.0
"""The page of one run: report.html."""

from __future__ import annotations

from html import escape
from pathlib import Path

from fjr_bringup.analysis import headlines
from fjr_bringup.analysis.joint_metrics import JointFigures
from fjr_bringup.analysis.metrics import Report
from fjr_bringup.analysis.power_balance import Power
from fjr_bringup.analysis.run_data import TrackingData
from fjr_bringup.formatting import milliseconds, number, percent
from fjr_bringup.report import html
from fjr_bringup.report.figure import colour
from fjr_bringup.report.run_figures import run_plots

HEAD = (
    "joint",
    "error at start<br>[{position}]",
    "peak error<br>[{position}]",
    "RMS error<br>[{position}]",
    "peak after 2 s<br>[{position}]",
    "RMS after 2 s<br>[{position}]",
    "settled within<br>2 % after [s]",
    "peak effort<br>[{effort}]",
    "RMS effort<br>[{effort}]",
    "limit<br>[{effort}]",
    "at the limit",
)
HOW = (
    "Drag over a plot to enlarge it, double-click to go back; a click on a name hides its line. "
    "All plots over time move together. Made by fjr report from the bag and the scenario alone; needs no network."
)


def write_run_page(path: Path, data: TrackingData, report: Report, flow: Power) -> None:
    """Write the page of a run."""
    body = [
        html.header(kicker(report), title(report), report.verdict, (*failed(report), *report.missing), report.stop),
        html.tiles(tiles(report)),
        html.figures(),
        html.table("Joint by joint", _head(report), [_row(each, j, report) for j, each in enumerate(report.joints)]),
        html.everything("All figures (report.json)", report.as_json()),
        html.footer(HOW),
    ]
    html.write_page(path, f"{report.scenario}: {_heading(report)}", body, run_plots(data, report, flow))


def _heading(report: Report) -> str:
    return report.stop.heading if report.stop else html.HEADINGS[report.verdict.kind]


def title(report: Report) -> str:
    """What ran, at which rate."""
    clock = "in lock-step" if report.lockstep else "in real time"
    joints = "one joint" if len(report.joints) == 1 else f"{len(report.joints)} joints"
    return f"{report.scenario}: {joints}, {number(1.0 / report.sample_period_s, 'Hz', 4)} {clock}"


def kicker(report: Report) -> str:
    """Where it comes from."""
    return f"Tracking report · {report.bag} · {number(report.duration_s, 's')}"


def failed(report: Report) -> tuple[str, ...]:
    """Why the run ended early."""
    return (f"The run ended early: {report.failure}",) if report.failure else ()


def tiles(report: Report) -> list[tuple[str, str]]:
    """The figures that matter."""
    tracking, storage, timing, counts = report.tracking, report.storage, report.timing, report.counts
    shown = [
        (number(tracking.settling_time_2_percent_s, "s"), "settled within 2 % of the initial error"),
        (number(tracking.rms_error_after_2s_rad, headlines.position_unit(report)), "RMS error after 2 s"),
        (headlines.peak_effort(report), ", ".join(filter(None, ("peak effort", headlines.effort_share(report))))),
    ]
    if storage is not None:
        basis = "proven" if storage.guarantee_is_proven else "sampled"
        least = f"decay of V; {basis}: at least {number(storage.guaranteed_decay_rate_per_s, '1/s')}"
        shown.append((number(storage.measured_decay_rate_per_s, "1/s"), least))
    return [
        *shown,
        (percent(counts.answered_in_time_fraction), f"answered in time, of {counts.nominal}"),
        (
            f"{milliseconds(timing.latency_p50_us)}",
            f"state to command; 99\N{NO-BREAK SPACE}%: {milliseconds(timing.latency_p99_us)}",
        ),
    ]


def _head(report: Report) -> list[str]:
    position, effort = headlines.position_unit(report), headlines.effort_unit(report)
    return [title.format(position=position, effort=effort) for title in HEAD]


def _row(each: JointFigures, j: int, report: Report) -> list[str]:
    """Figures of one joint; where units differ between the joints, its own follow its name."""
    mixed = headlines.position_unit(report) != each.position_unit
    unit = f" [{each.position_unit}, {each.effort_unit}]" if mixed else ""
    figures = (
        each.initial_error_rad,
        each.peak_error_rad,
        each.rms_error_rad,
        each.peak_error_after_2s_rad,
        each.rms_error_after_2s_rad,
        each.settling_time_2_percent_s,
        each.peak_effort_nm,
        each.rms_effort_nm,
        each.effort_limit_nm,
    )
    name = html.swatch(colour(j)) + escape(each.joint + unit)
    return [name, *(number(value) for value in figures), percent(each.saturated_fraction)]
