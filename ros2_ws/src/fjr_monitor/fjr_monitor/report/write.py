# SPDX-License-Identifier: Apache-2.0
"""Write report.json, report.html and overview.png of runs; `fjr report` does so from bags of any robot."""

from __future__ import annotations

import csv
import errno
import os
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from fjr_core.config.scenario import Scenario, load_scenario
from fjr_core.errors import FjrError, RecordError
from fjr_core.files import importing
from fjr_core.files.text_file import read_json, whole_file, write_text
from fjr_core.numerics.checks import Array
from fjr_monitor.recording.bag import Bag, bag_folder, read_bag
from fjr_monitor.recording.files import files_of
from fjr_monitor.recording.run import Recording
from fjr_monitor.report.comparison_page import Claim, differences, write_comparison
from fjr_monitor.report.metrics import Metrics, Report
from fjr_monitor.report.picture import write_picture
from fjr_monitor.report.run_page import draw_overview, write_run_page
from fjr_monitor.report.shown import METRICS, PAGE, RunSummary, Shown, arm_replay
from fjr_msgs_py.console.ending import Exit
from fjr_msgs_py.console.output import DASH, Result, aligned, json_text, number, percent, tell
from fjr_msgs_py.console.provenance import Provenance, provenance
from fjr_msgs_py.console.ros2 import play_command
from fjr_msgs_py.scenarios import library

SCENARIO, COMPARISON = "scenario.yaml", "comparison.html"
UNWRITABLE = (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.ENOTDIR)
CSV, PARQUET = TABLES = ".csv", ".parquet"
OF_ALL = {"t": "s", "V": "J", "H": "J", "latency": "s"}
OF_JOINTS = dict.fromkeys(("q_l", "q_m"), "position") | dict.fromkeys(("dq_l", "dq_m"), "velocity")
OF_JOINTS |= {"q_ld": "position", "dq_ld": "velocity", "u": "effort", "external_torque": "effort"}
"""Columns of the time series with their units, and those of each joint with the quantity."""
LARGE = 50e6  # bytes: reading a larger bag is announced
KNOWN: dict[str, Any] = {
    "scenario": str,
    "planned_s": (int, float),
    "not_recorded": dict,
    "failure": str,
    "provenance": dict,
}
"""Entries of an earlier report that the bag lacks, with their types."""
Source = tuple[str, Path, Path, dict[str, Any]]
"""Name, scenario file, report folder, and entries of the earlier report of the run that a bag belongs to."""


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
    failure: why the run ended early. pages: false for report.json only. Without Matplotlib there is no overview.png:
    report.html has every plot.
    """
    scenario, bag = load_scenario(folder / SCENARIO, user_code=False), read_bag(folder / "bag")
    known = {"not_recorded": dict(skipped or {}), "failure": failure, "provenance": provenance()}
    summary = report_bag(name, bag, scenario, folder, duration, pages, **known)
    metrics = summary.data.metrics
    if pages and find_spec("matplotlib") and metrics.energy_known and metrics.efforts_known:
        draw = partial(draw_overview, name, summary.data, summary.report)
        with without_warnings():
            write_with_fallback(summary.folder, lambda place: write_picture(place / "overview.png", (14.0, 8.0), draw))
    return summary


def report_bag(
    name: str,
    bag: Bag,
    scenario: Scenario,
    folder: Path,
    duration: float | None = None,
    pages: bool = True,
    **known: Any,
) -> RunSummary:
    """Write report.json and report.html of any bag into a folder; duration, pages: as of report_run.

    known: entries of the report that the bag lacks: not_recorded, failure, provenance of the command that recorded it.
    """
    with without_warnings():
        run = Recording(bag, scenario, duration or np.inf)
        metrics = Metrics(run)
        data = Shown(metrics)
        length = duration or run.seconds + run.sample_period
        report = metrics.report(name, length, planned_s=duration, **known)

        def write(place: Path) -> None:
            write_text(place / METRICS, json_text(report.as_json(), indent=2) + "\n")
            if pages:
                write_run_page(place / PAGE, data, report, arm_replay(data))

        folder = write_with_fallback(folder, write)
    return RunSummary(folder, report, data, name, pages)


def compare(summaries: Sequence[RunSummary], folder: Path, claim: Claim | None = None) -> Path:
    """Write comparison.html of several runs into a folder; claim: what they show together."""
    with without_warnings():
        written = write_with_fallback(folder, lambda place: write_comparison(place / COMPARISON, summaries, claim))
    return written / COMPARISON


def write_table(metrics: Metrics, file: Path) -> None:
    """Write the time series of a run, with a row for each state; raises MissingPackageError without pyarrow."""
    blocks = time_series(metrics)
    file.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(file) as scratch, without_warnings():
        if file.suffix == CSV:
            with scratch.open("w", encoding="utf-8", newline="") as stream:
                writer = csv.writer(stream, lineterminator="\n")
                for number, columns in enumerate(blocks):
                    writer.writerows([] if number else [columns])
                    writer.writerows(np.column_stack(list(columns.values())).tolist())
            return
        tables = map(importing.module("pyarrow").table, blocks)
        first = next(tables)
        with importing.module("pyarrow.parquet").ParquetWriter(scratch, first.schema, compression="zstd") as writer:
            for each in chain([first], tables):
                writer.write_table(each)


def time_series(metrics: Metrics) -> Iterator[dict[str, Array]]:
    """Yield the columns (k,) of a table of a run, block by block, by name, joint and unit: `q_l.joint1 [rad]`."""
    run = metrics.run
    for signals, powers in zip(run.columns.parts(), metrics.columns.parts(), strict=True):
        block = signals | powers
        columns = {f"{name} [{unit}]": block[name] for name, unit in OF_ALL.items()}
        for name, quantity in OF_JOINTS.items():
            for joint, units, column in zip(run.joints, run.units, block[name].T, strict=True):
                columns[f"{name}.{joint} [{getattr(units, quantity)}]"] = column
        yield columns


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
        tell(f"cannot write to {folder} ({error.strerror}); the report is in {other}")
    write(other)
    return other


@contextmanager
def without_warnings() -> Iterator[None]:
    """Suppress warnings of NumPy and Matplotlib about values that are not finite; a report shows them."""
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def table(summaries: Sequence[RunSummary]) -> str:
    """Return why controllers stopped, a table with one line per run, and the faults found."""
    head = ("scenario", "peak effort", "error after 2 s", "answered in time", "V decays at (at least)", "verdict")
    lines = aligned([head, *(_row(summary.label, summary.report) for summary in summaries)])
    found = [f"{each.label}: {fault.sentence}" for each in summaries for fault in each.report.verdict.findings]
    advised = [f"{each.label}: {each.report.advice}" for each in summaries if each.report.advice]
    touched = [f"{each.label}: {each.report.contact.sentence}" for each in summaries if each.report.contact]
    return "\n".join([*stops(summaries), "", *lines, *found, *touched, *advised])


def stops(summaries: Sequence[RunSummary]) -> list[str]:
    """Return a sentence for each run in which the controller stopped."""
    return [f"{each.label}: {each.report.stop.sentence}" for each in summaries if each.report.stop]


def output_paths(summaries: Sequence[RunSummary]) -> str:
    """Return the paths of the pages and the JSON files."""
    return "\n".join(["", *(f"{each.label}: {', '.join(map(str, each.files))}" for each in summaries)])


def play_hint(bag: Path) -> str:
    """Return a line with the command that plays a bag."""
    return f"play a bag: {play_command(bag)}   (or open {next(bag.glob('*.mcap'), bag)} in Foxglove or PlotJuggler)"


def _row(label: str, report: Report) -> tuple[str, ...]:
    counts, storage, verdict = report.counts, report.storage, report.verdict
    decay, kind = DASH, verdict.kind + (f": {verdict.detail}" if verdict.detail else "")
    if storage is not None:
        decay = f"{number(storage.measured_decay_rate_per_s)} ({storage.basis}: {storage.least}) 1/s"
    return (
        label + (" (lock-step)" if report.lockstep else ""),
        report.peak_effort_and_share(),
        report.steady_error(),
        f"{percent(counts.answered_in_time_fraction)} of {counts.published}",
        decay,
        {"stopped": "stopped", "late": "none: states or answers were late"}.get(report.status, kind),
    )


def report(
    bags: Sequence[Path],
    scenario: str | None,
    output: Path | None,
    namespace: str,
    film: Path | None = None,
    series: Path | None = None,
    force: bool = False,
) -> Result:
    """Report each bag, and compare them if there are several; the result has failed if any bag failed.

    scenario: of the robot; None: that next to each bag. output: folder of the reports; None: next to each bag.
    film, series: files of a moving picture and of the time series of the only bag. force: series may exist.
    """
    if (film or series) and len(bags) > 1:
        raise RecordError(f"{'--film shows' if film else '--table is of'} one bag; {len(bags)} are given; expected one")
    if series is not None and series.suffix not in TABLES:
        raise RecordError(f"{series} is no table; expected a name that ends with {' or '.join(TABLES)}")
    if series is not None and series.exists() and not force:
        raise RecordError(f"{series} exists; expected a new file, or --force")
    if film is not None:
        importing.module("fjr_engines.film").check(film)
    summaries: list[RunSummary] = []
    failures: list[str] = []
    namespace = f"/{namespace}" if (namespace := namespace.strip("/")) else ""
    for given in bags:  # a link, such as that to the newest run: the report names a folder that does not change
        path = given.parent / given.readlink() if given.is_symlink() else given
        try:
            name, file, folder, known = source_of(path, scenario, output, [each.folder for each in summaries])
            size = sum(each.stat().st_size for each in files_of(bag_folder(path)) if each.is_file())
            if size > LARGE:
                tell(f"reading {path}, {size / 1e6:.0f} MB")
            known["provenance"] = Provenance.read(known.get("provenance"))
            bag, robot = read_bag(path, namespace), load_scenario(file, user_code=False)
            summaries.append(report_bag(name, bag, robot, folder, known.pop("planned_s", None), **known))
        except (FjrError, OSError) as error:
            failures.append(str(error) if str(path) in str(error) else f"{given}: {error}")
    if not summaries:
        for failure in failures[:-1]:
            tell(failure)
        raise RecordError(failures[-1])
    if film is not None:
        importing.module("fjr_engines.film").film(summaries[0].data, film)
    if series is not None:
        write_table(summaries[0].data.metrics, series)
    names = [each.label for each in summaries]  # or the folder if two runs have the same scenario
    summaries = [replace(each, label=str(each.folder)) if names.count(each.label) > 1 else each for each in summaries]
    missing = [f"{each.label}: {note}" for each in summaries for note in each.report.missing]
    for loss in (*failures, *missing):
        tell(loss)
    page = None
    if len(summaries) > 1:
        common = Path(os.path.commonpath([each.folder.resolve().parent for each in summaries]))
        page = compare(summaries, output or common)
    rows = differences(summaries)
    differ = ["", *aligned([("parameter", *(each.label for each in summaries)), *rows])] if rows else []
    more = [f"{what}: {file}" for what, file in (("time series", series), ("side by side", page)) if file]
    lines = [table(summaries), *differ, output_paths(summaries), *more]
    values = {"runs": [each.values for each in summaries], "comparison": page, "table": series, "failures": failures}
    return Result("\n".join(lines), values, Exit.FAILED if failures else Exit.DONE)


def source_of(path: Path, scenario: str | None, output: Path | None, taken: Sequence[Path]) -> Source:
    """Return the source of a report, in a folder that is not taken; raise ScenarioError for a bag without scenario."""
    above = [path, *path.resolve().parents[:2]]
    run = next((folder for folder in above if (folder / SCENARIO).is_file()), None)  # the run that the bag belongs to
    if scenario is not None:
        file = library.find(scenario)
    elif run is not None:
        file = run / SCENARIO
    else:
        files_of(bag_folder(path))  # raises first if the path is no bag
        raise library.ScenarioError(
            f"no scenario for {path}: expected {SCENARIO} next to the bag, or --scenario NAME or FILE"
        )
    known = {} if run is None else known_of(run / METRICS)
    name = Path(known.pop("scenario", "")).name or (path.resolve().stem if run is None else run.resolve().name)
    default = run if run is not None else path.with_name(f"{path.resolve().stem}_report")
    folder = first = default if output is None else output / name
    number = 2
    while folder in taken:
        folder, number = first.with_name(f"{first.name}-{number}"), number + 1
    return name, file, folder, known


def known_of(path: Path) -> dict[str, Any]:
    """Return the entries of an earlier report that the bag lacks; none if there is no valid one."""
    try:
        found = read_json(path)
    except (OSError, ValueError):
        return {}
    return {name: found[name] for name, kind in KNOWN.items() if isinstance(found.get(name), kind)}
