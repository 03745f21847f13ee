# SPDX-License-Identifier: Apache-2.0
"""`fjr report`: any bag of the interface, one page each, and all side by side."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fjr_bringup.recording.formats import files_of
from fjr_bringup.recording.reader import read_bag
from fjr_bringup.report.write import FIGURES, RunSummary, compare, reported, table, where_to_look
from fjr_bringup.scenarios import library
from fjr_core.config.scenario import load_scenario
from fjr_core.errors import FjrError
from fjr_core.files.text_file import read_json

SCENARIO = "scenario.yaml"
LARGE = 50e6  # bytes; reading more takes a while


class ReportError(FjrError):
    """A bag of which there is nothing to report."""


@dataclass(frozen=True)
class Source:
    """A bag to report of: its name and scenario, and where the report goes."""

    bag: Path
    name: str
    scenario: Path
    folder: Path


def report_bags(
    bags: Sequence[Path], scenario: str | None, output: Path | None, namespace: str = ""
) -> tuple[list[RunSummary], list[str]]:
    """Report of each bag, and a page of all where there are several; what was written, and a sentence per failure."""
    summaries: list[RunSummary] = []
    failures: list[str] = []
    for path in bags:
        try:
            taken = [each.folder for each in summaries]
            summaries.append(_report(_apart(_source(path, scenario, output), taken), namespace))
        except (FjrError, OSError) as error:
            failures.append(str(error) if str(path) in str(error) else f"{path}: {error}")
    return _labelled(summaries), failures


def tell(summaries: Sequence[RunSummary], failures: Sequence[str], output: Path | None) -> None:
    """Print the table, what is missing in each bag, and where the pages are."""
    for failure in failures:
        print(f"fjr: {failure}", file=sys.stderr)
    for each in summaries:
        for note in each.report.missing:
            print(f"fjr: {each.label}: {note}", file=sys.stderr)
    if not summaries:
        return
    print(table(summaries))
    print(where_to_look(summaries))
    if len(summaries) > 1:
        print(f"side by side: {compare(summaries, output or _common(summaries))}")


def _report(source: Source, namespace: str) -> RunSummary:
    size = sum(file.stat().st_size for file in files_of(_inner(source.bag)) if file.is_file())
    if size > LARGE:
        print(f"fjr: reading {source.bag}, {size / 1e6:.0f} MB", file=sys.stderr, flush=True)
    bag = read_bag(source.bag, namespace)
    known = _known(source.scenario.with_name(FIGURES))
    return reported(
        source.name,
        bag,
        load_scenario(source.scenario),
        source.folder,
        duration=known.get("planned_s"),
        skipped=known.get("not_recorded"),
        failure=known.get("failure", ""),
    )


def _source(path: Path, scenario: str | None, output: Path | None) -> Source:
    """Where everything of a bag is; raises ScenarioError where no scenario is."""
    path = _unlinked(path)
    run = _run_folder(path)
    if scenario is not None:
        file = library.find(scenario)
    elif run is not None:
        file = run / SCENARIO
    else:
        files_of(_inner(path))  # what is no bag is said first
        raise library.ScenarioError(
            f"no scenario for {path}: expected {SCENARIO} beside the bag, or --scenario NAME or FILE"
        )
    name = _run_name(run) if run else (path.resolve().name if scenario is None else path.resolve().stem)
    beside = run if run is not None else path.with_name(f"{path.resolve().stem}_report")
    return Source(path, name, file, beside if output is None else output / name)


def _apart(source: Source, taken: Sequence[Path]) -> Source:
    """The same with a folder that no other bag has: a number follows the name where several share it."""
    folder, number = source.folder, 2
    while folder in taken:
        folder = source.folder.with_name(f"{source.folder.name}-{number}")
        number += 1
    return replace(source, folder=folder)


def _run_folder(path: Path) -> Path | None:
    """The folder of the run that a bag belongs to: the one with the scenario in it."""
    above = [path, *path.resolve().parents[:2]]
    return next((folder for folder in above if (folder / SCENARIO).is_file()), None)


def _unlinked(path: Path) -> Path:
    """The folder that a link leads to, such as that to the newest run: what is written names it for good."""
    return path.parent / path.readlink() if path.is_symlink() else path


def _run_name(folder: Path) -> str:
    """What a run was called: its scenario, or its folder where no report tells."""
    name = _known(folder / FIGURES).get("scenario")
    return Path(name).name if isinstance(name, str) and Path(name).name else folder.resolve().name


def _inner(path: Path) -> Path:
    return path / "bag" if (path / "bag").is_dir() else path


def _known(path: Path) -> Mapping[str, Any]:
    """What only the run itself knew, from its own report."""
    try:
        found = read_json(path)
    except (OSError, ValueError):
        return {}
    kinds: dict[str, Any] = {"scenario": str, "planned_s": (int, float), "not_recorded": dict, "failure": str}
    return {name: found[name] for name, kind in kinds.items() if isinstance(found.get(name), kind)}


def _labelled(summaries: Sequence[RunSummary]) -> list[RunSummary]:
    """Each with a name of its own: the scenario's, or the folder's where two runs share one."""
    names = [each.label for each in summaries]
    return [replace(each, label=str(each.folder)) if names.count(each.label) > 1 else each for each in summaries]


def _common(summaries: Sequence[RunSummary]) -> Path:
    """The folder above all reports."""
    return Path(os.path.commonpath([each.folder.resolve().parent for each in summaries]))
