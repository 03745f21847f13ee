# SPDX-License-Identifier: Apache-2.0
"""Write report.json, report.html and overview.png of a run; format the table at the end of a command."""

from __future__ import annotations

import errno
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fjr_core.config.scenario import Scenario, load_scenario
from fjr_core.numerics.one_line import at_least
from fjr_monitor.analysis import headlines
from fjr_monitor.analysis.metrics import Metrics, Report, make_report
from fjr_monitor.analysis.run_data import Recording
from fjr_monitor.recording.reader import Bag, read_bag
from fjr_monitor.report.paper_claim import Claim
from fjr_monitor.report.shown import Shown
from fjr_msgs_py.console.provenance import Provenance, provenance
from fjr_msgs_py.console.ros2 import play_command

PAGE, METRICS, COMPARISON = "report.html", "report.json", "comparison.html"
UNWRITABLE = (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.ENOTDIR)


@dataclass(frozen=True)
class RunSummary:
    """A reported run: folder of its report, report, what its page shows and scenario. label: unique among several runs.

    has_page: whether report.html was written. notes: how the run was made, for the page that compares it.
    """

    folder: Path
    report: Report
    data: Shown
    scenario: Scenario
    label: str = ""
    has_page: bool = True
    notes: tuple[str, ...] = ()

    @property
    def files(self) -> list[Path]:
        """Return the paths of page and metrics."""
        return [self.folder / name for name in ((PAGE, METRICS) if self.has_page else (METRICS,))]

    @property
    def values(self) -> dict[str, Any]:
        """Return the run as JSON values: its files and the content of report.json."""
        page = self.folder / PAGE if self.has_page else None
        return {"name": self.label, "folder": self.folder, "page": page, **self.report.as_json()}


def report_run(
    name: str,
    folder: Path,
    duration: float | None,
    skipped: Mapping[str, str] | None = None,
    failure: str = "",
    pages: bool = True,
) -> RunSummary:
    """Write report.json, report.html and overview.png into a run's folder, also if the run diverged or ended early.

    duration: planned duration [s]; None: up to the last answered state. skipped: topics that could not be recorded.
    failure: why the run ended early. pages: false for report.json only.
    """
    scenario, bag = load_scenario(folder / "scenario.yaml", user_code=False), read_bag(folder / "bag")
    summary = report_bag(name, bag, scenario, folder, duration, skipped, failure, pages, provenance())
    if pages and summary.data.metrics.energy_known and summary.data.metrics.efforts_known:
        from fjr_monitor.report.overview import draw_overview  # matplotlib is half a second of imports

        with without_warnings():
            write_with_fallback(summary.folder, lambda place: draw_overview(name, summary.data, summary.report, place))
    return summary


def report_bag(
    name: str,
    bag: Bag,
    scenario: Scenario,
    folder: Path,
    duration: float | None = None,
    skipped: Mapping[str, str] | None = None,
    failure: str = "",
    pages: bool = True,
    recorded: Provenance | None = None,
) -> RunSummary:
    """Write report.json and report.html of any bag into a folder; for the arguments see report_run.

    recorded: provenance of the command that recorded the bag, if known.
    """
    with without_warnings():
        run = Recording(bag, scenario, duration or np.inf)
        metrics = Metrics(run)
        data = Shown(metrics)
        metrics.read(*([data.add] if pages else []))
        report = replace(
            make_report(name, metrics, duration or metrics.seconds + run.sample_period),
            not_recorded=dict(skipped or {}),
            failure=failure,
            planned_s=duration,
            provenance=recorded,
        )

        def write(place: Path) -> None:
            report.write(place / METRICS)
            if pages:
                from fjr_monitor.report.arm_replay import arm_replay
                from fjr_monitor.report.run_report import write_run_page  # Jinja2 takes a tenth of a second

                write_run_page(place / PAGE, data, report, arm_replay(data))

        folder = write_with_fallback(folder, write)
    return RunSummary(folder, report, data, scenario, name, pages)


def write_with_fallback(folder: Path, write: Callable[[Path], object]) -> Path:
    """Create the folder and call `write` with it, or with a new temporary folder if the first cannot be written.

    Return the folder that was written. Raises OSError if neither can be.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write(folder)
        return folder
    except OSError as error:
        if error.errno not in UNWRITABLE:
            raise
        other = Path(tempfile.mkdtemp(prefix=f"fjr-{folder.name}-"))
        print(f"fjr: cannot write to {folder} ({error.strerror}); the report is in {other}", file=sys.stderr)
    write(other)
    return other


@contextmanager
def without_warnings() -> Iterator[None]:
    """Suppress warnings of NumPy and Matplotlib about values that are not finite; a report shows them."""
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def compare(summaries: Sequence[RunSummary], folder: Path, claim: Claim | None = None) -> Path:
    """Write comparison.html of several runs into a folder; claim: what they show together."""
    from fjr_monitor.report.runs_report import Compared, write_comparison

    with without_warnings():
        runs = [Compared(each.label, each.data, each.report, each.folder / PAGE, each.notes) for each in summaries]
        return write_with_fallback(folder, lambda place: write_comparison(place / COMPARISON, runs, claim)) / COMPARISON


def table(summaries: Sequence[RunSummary]) -> str:
    """Return why controllers stopped, a table with one line per run, and the faults found."""
    head = ("scenario", "peak effort", "error after 2 s", "answered in time", "V decays at (at least)", "verdict")
    rows = [head, *(_row(summary.label, summary.report) for summary in summaries)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(head))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    found = [f"{each.label}: {fault.sentence}" for each in summaries for fault in each.report.verdict.findings]
    advised = [f"{each.label}: {each.report.advice}" for each in summaries if each.report.advice]
    return "\n".join([*stops(summaries), "", lines[0], "-" * len(lines[0]), *lines[1:], *found, *advised])


def stops(summaries: Sequence[RunSummary]) -> list[str]:
    """Return a sentence for each run in which the controller stopped."""
    return [f"{each.label}: {each.report.stop.sentence}" for each in summaries if each.report.stop]


def _row(label: str, report: Report) -> tuple[str, ...]:
    counts = report.counts
    in_time = _number(counts.answered_in_time_fraction and 100 * counts.answered_in_time_fraction, "{:.2f} %")
    return (
        label + (" (lock-step)" if report.lockstep else ""),
        headlines.peak_effort_and_share(report, _effort),
        headlines.steady_error(report, _error),
        f"{in_time} of {counts.nominal}",
        _decay(report),
        _verdict(report),
    )


def _verdict(report: Report) -> str:
    if report.status == "stopped":
        return "stopped"
    if report.status == "late":
        return "none: the machine was late"
    return report.verdict.kind + (f": {report.verdict.detail}" if report.verdict.detail else "")


def _decay(report: Report) -> str:
    storage = report.storage
    if storage is None:
        return "-"
    basis = "proven" if storage.guarantee_is_proven else "sampled"
    measured = _number(storage.measured_decay_rate_per_s, "{:.1f}")
    return f"{measured} ({basis}: {at_least(storage.guaranteed_decay_rate_per_s, 3)}) 1/s"


def _effort(value: float, unit: str) -> str:
    if not np.isfinite(value):
        return "-"
    return f"{value:.2f} {unit}" if value < 1e6 else f"{value:.1e} {unit}"


def _error(value: float, unit: str) -> str:
    return f"{value:.1e} {unit}" if np.isfinite(value) else "-"


def _number(value: float | None, form: str) -> str:
    return "-" if value is None or not np.isfinite(value) else form.format(value)


def output_paths(summaries: Sequence[RunSummary]) -> str:
    """Return the paths of the pages and the JSON files."""
    return "\n".join(["", *(f"{each.label}: {', '.join(map(str, each.files))}" for each in summaries)])


def play_hint(bag: Path) -> str:
    """Return a line with the command that plays a bag."""
    storage = next(bag.glob("*.mcap"), bag)
    return f"play a bag: {play_command(bag)}   (or open {storage} in Foxglove or PlotJuggler)"
