# SPDX-License-Identifier: Apache-2.0
"""`fjr report`: write pages from bags."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fjr_core.config.scenario import load_scenario
from fjr_core.errors import FjrError, RecordError
from fjr_core.files.text_file import read_json
from fjr_monitor.recording.formats import files_of
from fjr_monitor.recording.reader import read_bag
from fjr_monitor.report.write import METRICS, RunSummary, compare, output_paths, report_bag, table
from fjr_msgs_py.console.ending import Exit
from fjr_msgs_py.console.output import Result
from fjr_msgs_py.console.provenance import Provenance
from fjr_msgs_py.scenarios import library

SCENARIO = "scenario.yaml"
LARGE = 50e6  # bytes: reading a larger bag is announced


class ReportError(RecordError):
    """A bag cannot be reported."""


@dataclass(frozen=True)
class Source:
    """A bag with its name and scenario, and the folder of its report."""

    bag: Path
    name: str
    scenario: Path
    folder: Path


def report(bags: Sequence[Path], scenario: str | None, output: Path | None, namespace: str) -> Result:
    """Report each bag, and compare them if there are several; the result has failed if any bag failed."""
    namespace = namespace.strip("/")
    summaries, failures = _report_all(bags, scenario, output, f"/{namespace}" if namespace else "")
    _print_losses(summaries, failures)
    if not summaries:
        raise ReportError(failures[-1])
    page = _comparison(summaries, output) if len(summaries) > 1 else None
    lines = [table(summaries), output_paths(summaries), *([f"side by side: {page}"] if page else [])]
    values = {"runs": [each.values for each in summaries], "comparison": page, "failures": failures}
    return Result("\n".join(lines), values, Exit.FAILED if failures else Exit.DONE)


def _report_all(
    bags: Sequence[Path], scenario: str | None, output: Path | None, namespace: str
) -> tuple[list[RunSummary], list[str]]:
    """Write the report of each bag; return what was written, and a sentence for each failure."""
    summaries: list[RunSummary] = []
    failures: list[str] = []
    for path in bags:
        try:
            taken = [each.folder for each in summaries]
            summaries.append(_report(_unique(_source(path, scenario, output), taken), namespace))
        except (FjrError, OSError) as error:
            failures.append(str(error) if str(path) in str(error) else f"{path}: {error}")
    return _labelled(summaries), failures


def _print_losses(summaries: Sequence[RunSummary], failures: Sequence[str]) -> None:
    """Print failures and missing data on stderr; without any report the last failure is raised instead."""
    for failure in failures if summaries else failures[:-1]:
        print(f"fjr: {failure}", file=sys.stderr)
    for each in summaries:
        for note in each.report.missing:
            print(f"fjr: {each.label}: {note}", file=sys.stderr)


def _comparison(summaries: Sequence[RunSummary], output: Path | None) -> Path:
    """Write the page that compares the runs; return its path."""
    common = Path(os.path.commonpath([each.folder.resolve().parent for each in summaries]))
    return compare(summaries, output or common)


def _report(source: Source, namespace: str) -> RunSummary:
    size = sum(file.stat().st_size for file in files_of(_inner(source.bag)) if file.is_file())
    if size > LARGE:
        print(f"fjr: reading {source.bag}, {size / 1e6:.0f} MB", file=sys.stderr, flush=True)
    bag = read_bag(source.bag, namespace)
    known = _known(source.scenario.with_name(METRICS))
    return report_bag(
        source.name,
        bag,
        load_scenario(source.scenario, user_code=False),
        source.folder,
        duration=known.get("planned_s"),
        skipped=known.get("not_recorded"),
        failure=known.get("failure", ""),
        recorded=Provenance.read(known.get("provenance")),
    )


def _source(path: Path, scenario: str | None, output: Path | None) -> Source:
    """Return bag, name, scenario file and report folder; raises ScenarioError if no scenario is known."""
    if path.is_symlink():  # such as that to the newest run: the report names a folder that does not change
        path = path.parent / path.readlink()
    above = [path, *path.resolve().parents[:2]]
    run = next((folder for folder in above if (folder / SCENARIO).is_file()), None)  # the run that the bag belongs to
    if scenario is not None:
        file = library.find(scenario)
    elif run is not None:
        file = run / SCENARIO
    else:
        files_of(_inner(path))  # raises first if the path is no bag
        raise library.ScenarioError(
            f"no scenario for {path}: expected {SCENARIO} next to the bag, or --scenario NAME or FILE"
        )
    name = _run_name(run) if run else (path.resolve().name if scenario is None else path.resolve().stem)
    default = run if run is not None else path.with_name(f"{path.resolve().stem}_report")
    return Source(path, name, file, default if output is None else output / name)


def _unique(source: Source, taken: Sequence[Path]) -> Source:
    """Append a number to the folder's name if the folder is already taken."""
    folder, number = source.folder, 2
    while folder in taken:
        folder = source.folder.with_name(f"{source.folder.name}-{number}")
        number += 1
    return replace(source, folder=folder)


def _run_name(folder: Path) -> str:
    """Return the scenario's name from the run's report, or the folder's name if there is no report."""
    name = _known(folder / METRICS).get("scenario")
    return Path(name).name if isinstance(name, str) and Path(name).name else folder.resolve().name


def _inner(path: Path) -> Path:
    return path / "bag" if (path / "bag").is_dir() else path


def _known(path: Path) -> Mapping[str, Any]:
    """Return the entries of an earlier report that the bag lacks: name, planned duration, losses, failure, origin."""
    try:
        found = read_json(path)
    except (OSError, ValueError):
        return {}
    kinds: dict[str, Any] = {
        "scenario": str,
        "planned_s": (int, float),
        "not_recorded": dict,
        "failure": str,
        "provenance": dict,
    }
    return {name: found[name] for name, kind in kinds.items() if isinstance(found.get(name), kind)}


def _labelled(summaries: Sequence[RunSummary]) -> list[RunSummary]:
    """Label each run by its scenario, or by its folder if two runs have the same scenario."""
    names = [each.label for each in summaries]
    return [replace(each, label=str(each.folder)) if names.count(each.label) > 1 else each for each in summaries]
