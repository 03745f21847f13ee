# SPDX-License-Identifier: Apache-2.0
"""`fjr identify`: read records, identify the robot, write robot.yaml, identification.json and the page."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fjr_core.errors import ParameterError
from fjr_core.files.atomic_file import write_text
from fjr_core.model.free_inertia import joints_without_inertia
from fjr_design.uncertainty.posterior import IDENTIFIED, UNKNOWN, WEAK, Identification
from fjr_identification.estimation.hold_out import HoldOut, hold_out
from fjr_identification.estimation.identify import identify
from fjr_identification.estimation.motion_record import MotionRecord
from fjr_identification.estimation.parameters import Options, Prior
from fjr_identification.page.page import HOLD_OUT, HoldOutRows, counted, hold_out_rows, write_page
from fjr_identification.records.read_record import Reading, read_record
from fjr_identification.records.record_map import read_map
from fjr_identification.robot_file.nominal_robot import (
    CORRECTED,
    NominalRobot,
    corrected_urdf,
    identified_values,
    nominal_robot,
)
from fjr_identification.robot_file.robot_yaml import RobotFile, robot_file
from fjr_msgs_py.console.formatting import interval, number, plural
from fjr_msgs_py.console.progress import progress_bar
from fjr_msgs_py.console.result import Result, json_text

ROBOT, VALUES, PAGE = "robot.yaml", "identification.json", "identification.html"
PROGRESS = "{desc}: {percentage:3.0f}% |{bar}| {elapsed}"


@dataclass(frozen=True)
class Request:
    """Records to identify from and to predict, robot file, mapping file, part and accepted contradictions, output."""

    records: Sequence[Path]
    hold_outs: Sequence[Path]
    robot: Path
    mapping: Path | None
    reading: Reading
    options: Options
    output: Path


def identify_robot(request: Request) -> Result:
    """Identify, write all files and return a table; raise FjrError."""
    nominal = nominal_robot(request.robot)
    _refuse_joints_without_inertia(nominal)
    records, notes = _read(request, nominal, request.records)
    predicted, more = _read(request, nominal, request.hold_outs)
    prior = Prior.of(nominal.robot)
    with _progress() as progress:
        found = identify(records, nominal.robot, prior, request.options, progress)
    compared = [hold_out(found, record, nominal.robot, prior, request.options) for record in predicted]
    rows = [(each.record, list(zip(each.model, each.rigid, each.no_skew, strict=True))) for each in compared]
    notes = (*notes, *more, *unconfirmed(compared))
    values = {
        **found.as_dict(),
        "robot": request.robot,
        "records": request.records,
        "hold_out": dict(rows),
        "notes": notes,
    }
    file = _write(request, nominal, found, records, rows, values)
    paths = [request.output / name for name in (ROBOT, VALUES, PAGE)]
    lines = [*table(found), *_hold_out_lines(found.joints, rows), *_last_lines(paths, file)]
    return Result("\n".join(lines), {**values, "files": paths})


def _refuse_joints_without_inertia(nominal: NominalRobot) -> None:
    """Raise ParameterError, which names the robot file: a record would seem wrong by the factor of the inertia."""
    for i, seen in joints_without_inertia(nominal.robot).items():
        raise ParameterError(
            f"{nominal.path}: {nominal.joints[i]} {seen}; expected the inertia of its links in the URDF, or a robot "
            "file in which the joint is locked"
        )


def _read(request: Request, nominal: NominalRobot, paths: Sequence[Path]) -> tuple[list[MotionRecord], tuple[str, ...]]:
    """Return the records and print what is remarkable about them."""
    mapping = read_map(request.mapping, nominal.joints) if request.mapping else None
    reading = Reading(mapping, request.reading.start, request.reading.duration, request.reading.accepted)
    found = [read_record(path, nominal.joints, nominal.robot, reading) for path in paths]
    notes = tuple(note for _, each in found for note in each)
    for note in notes:
        print(f"fjr: {note}", file=sys.stderr)
    return [record for record, _ in found], notes


@contextmanager
def _progress() -> Iterator[Callable[[str, float], None]]:
    """Show a bar, on a terminal, or a line for each step of the identification elsewhere."""
    shown = ""
    with progress_bar("identifying", PROGRESS, total=1.0, desc="identifying") as bar:

        def progress(what: str, share: float) -> None:
            nonlocal shown
            if what != shown and bar.disable:
                print(what, file=sys.stderr, flush=True)
            shown = what
            bar.set_description(what, refresh=False)
            bar.n = min(1.0, share)
            bar.refresh()

        yield progress


def _write(
    request: Request,
    nominal: NominalRobot,
    found: Identification,
    records: Sequence[MotionRecord],
    rows: Sequence[HoldOutRows],
    values: Mapping[str, Any],
) -> RobotFile:
    """Write robot.yaml, the URDF of corrected links, identification.json with the values, and the page."""
    request.output.mkdir(parents=True, exist_ok=True)
    names = [record.name for record in records]
    file = robot_file(nominal, found, identified_values(nominal, found, request.output), names, ROBOT)
    write_text(request.output / ROBOT, file.text)
    if urdf := corrected_urdf(nominal, found):
        write_text(request.output / CORRECTED, urdf)
    write_text(request.output / VALUES, json_text(values, indent=1) + "\n")
    seconds = sum(record.dt * len(record.u) for record in records)
    notes = [*values["notes"], *([f"robot.yaml has no gains: {file.reason}"] if file.reason else [])]
    write_page(request.output / PAGE, nominal.name, found, rows, notes, seconds)
    return file


def table(found: Identification) -> list[str]:
    """Return a line for each estimate, below a headline."""
    counts = counted(found)
    head = ("parameter", "joint", "value", "95 % interval", "verdict")
    cells = [head]
    for each in found.estimates:
        ends = "" if each.verdict == UNKNOWN else interval(each.low, each.high)
        cells.append((each.name, each.joint, number(each.value, each.unit), ends, each.verdict))
    widths = [max(len(row[i]) for row in cells) for i in range(len(head))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in cells]
    reasons = [
        f"{each.name} of {each.joint or 'the arm'}: {each.reason}"
        for each in found.estimates
        if each.verdict == UNKNOWN
    ]
    others = f"{counts[WEAK]} weakly, {counts[UNKNOWN]} not identifiable"
    return [
        f"{plural(counts[IDENTIFIED], 'parameter')} identified, {others}",
        "",
        *lines,
        *(["", "not identifiable from these records, as before:", *reasons] if reasons else []),
    ]


def unconfirmed(compared: Sequence[HoldOut]) -> list[str]:
    """Return a sentence for each hold-out that joints without elasticity or without skew explain better."""
    sentences = []
    for each in compared:
        better = np.fmin(each.rigid, each.no_skew) < each.model
        if better.any():
            joints = ", ".join(joint for joint, found in zip(each.joints, better, strict=True) if found)
            sentences.append(
                f"hold-out {each.record}: the deflection of {joints} is predicted better by rigid joints or no skew; "
                "the record does not confirm these stiffnesses"
            )
    for sentence in sentences:
        print(f"fjr: {sentence}", file=sys.stderr)
    return sentences


def _hold_out_lines(joints: Sequence[str], rows: Sequence[HoldOutRows]) -> list[str]:
    """Return the tables of unexplained deflections as text."""
    lines: list[str] = []
    for record, shares in rows:
        cells = [("unexplained", *HOLD_OUT[1:]), *hold_out_rows(joints, shares)]
        lines += ["", f"hold-out {record}: share of the deflection that a model leaves unexplained"]
        lines += ["  ".join(cell.ljust(14) for cell in row).rstrip() for row in cells]
    return lines


def _last_lines(paths: Sequence[Path], file: RobotFile) -> list[str]:
    """Return where the results are and what comes next."""
    lines = ["", f"written    {', '.join(map(str, paths))}"]
    if file.reason:
        return [*lines, f"no gains   {file.reason}"]
    return [*lines, f"next       fjr check {paths[0]}", f"           fjr run {paths[0]} --lockstep"]
