# SPDX-License-Identifier: Apache-2.0
"""From a recorded run to its report and pictures, and the short table at the end of the command."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fjr_bringup.bag import read_bag
from fjr_bringup.pictures import draw_all
from fjr_bringup.report import Report, make_report
from fjr_bringup.tracking_data import tracking_data
from fjr_core.scenario import load_scenario


@dataclass(frozen=True)
class RunSummary:
    """A finished run: where it is and what it showed."""

    folder: Path
    report: Report


def summarise(
    name: str, folder: Path, duration: float | None, skipped: Mapping[str, str] | None = None, failure: str = ""
) -> RunSummary:
    """Write report.json and the pictures into a run's folder, also of a run that diverged or hardly began.

    duration: how long it was to run [s], None for as long as it was recorded; skipped: topics that could not be
    recorded; failure: why it ended early.
    """
    scenario = load_scenario(folder / "scenario.yaml")
    bag = read_bag(folder / "bag")
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of numpy and matplotlib, about values that are not finite
        data = tracking_data(bag, scenario, duration or np.inf)
        lasted = duration or float(data.t[-1]) + data.sample_period
        report = replace(
            make_report(name, bag, scenario, data, lasted), not_recorded=dict(skipped or {}), failure=failure
        )
        report.write(folder / "report.json")
        draw_all(name, data, report, folder)
    return RunSummary(folder, report)


def table(summaries: list[RunSummary]) -> str:
    """The figures that matter, one line per run."""
    head = (
        "scenario",
        "peak effort",
        "error after 2 s",
        "answered in time",
        "V decays at (at least)",
        "V within bound",
    )
    rows = [head, *(_row(summary.report) for summary in summaries)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(head))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    return "\n".join(["", lines[0], "-" * len(lines[0]), *lines[1:]])


def _row(report: Report) -> tuple[str, ...]:
    tracking, storage, counts = report.tracking, report.storage, report.counts
    basis = "proven" if storage.guarantee_is_proven else "sampled"
    return (
        report.scenario + (" (lock-step)" if report.lockstep else ""),
        f"{_plain(tracking.peak_effort_nm)} N m" + _share(tracking.largest_share_of_effort_limit),
        _number(tracking.max_error_after_2s_rad, "{:.1e} rad"),
        f"{100 * counts.answered_in_time_fraction:.2f} % of {counts.nominal}",
        _number(storage.measured_decay_rate_per_s, "{:.1f}")
        + f" ({basis}: {storage.guaranteed_decay_rate_per_s:.1f}) 1/s",
        _until(storage.leaves_bound_at_s, storage.relative_where_it_leaves),
    )


def _plain(value: float) -> str:
    return f"{value:.2f}" if value < 1e6 else f"{value:.1e}"


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)


def _share(value: float | None) -> str:
    return "" if value is None else f", {100 * value:.0f} % of a limit"


def _until(instant: float | None, relative: float | None) -> str:
    return "always" if instant is None else f"until {instant:.2f} s, down to {relative:.0e} V(0)"


def where_to_look(summaries: list[RunSummary]) -> str:
    """Paths of what was written, and how to play a bag."""
    lines = [""]
    for summary in summaries:
        lines.append(f"{summary.report.scenario}: {summary.folder / 'overview.png'}, {summary.folder / 'report.json'}")
    bag = summaries[0].folder / "bag"
    storage = next(bag.glob("*.mcap"), bag)
    lines.append(f"play a bag: ros2 bag play {bag}   (or open {storage} in Foxglove or PlotJuggler)")
    return "\n".join(lines)
