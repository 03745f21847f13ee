# SPDX-License-Identifier: Apache-2.0
"""`fjr identify`: read records, identify the robot, write robot.yaml, identification.json and the page."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from click import UsageError

from fjr_core.errors import ParameterError
from fjr_core.files.text_file import write_text
from fjr_core.urdf.typical_joints import joints_without_inertia
from fjr_design.uncertainty.posterior import IDENTIFIED, UNKNOWN, WEAK, Identification
from fjr_identification.estimation.identify import identify as identification_of
from fjr_identification.estimation.motion_record import MotionRecord
from fjr_identification.estimation.parameters import SMOOTHING, IdentifyOptions, prior_of
from fjr_identification.estimation.validation import HoldOut, hold_out
from fjr_identification.page import HOLD_OUT, STIFFNESS, counted, hold_out_rows, reasons, springs_seen, write_page
from fjr_identification.records.missing_sensors import lacking
from fjr_identification.records.reading import Reading, read_record
from fjr_identification.records.record_map import read_map, written_map
from fjr_identification.records.rigid_motion import KINDS
from fjr_identification.robot_file import CORRECTED, GEAR_RATIO, IdentifiedRobot, NominalRobot, RobotFile, nominal_robot
from fjr_msgs_py.console.output import Result, aligned, interval, json_text, note, number, plural, progress_bar, tell

ROBOT, VALUES, PAGE = "robot.yaml", "identification.json", "identification.html"
PROGRESS = "{desc}: {percentage:3.0f}% |{bar}| {elapsed}"


def identify(
    records: Sequence[Path],
    robot: Path | None,
    hold_outs: Sequence[Path],
    mapping: Path | None,
    write_map: bool,
    start: float,
    duration: float,
    accepted: Sequence[str],
    output: Path,
    **free: Any,
) -> Result:
    """Identify a robot from records, write all files and return a table; raise FjrError.

    accepted: kinds of contradictions that are reported only. write_map: write the mapping file of the first record
    instead, next to which nothing is replaced. free: fields of IdentifyOptions, joints among them.
    """
    if write_map:
        return _mapped(records[0], robot)
    if robot is None:
        raise UsageError("Missing option '--robot'.")
    unknown = [kind for kind in accepted if kind not in KINDS]
    if unknown:
        raise ParameterError(f"--accept is '{unknown[0]}'; expected one of {', '.join(KINDS)}")
    options = IdentifyOptions(**free)
    nominal = nominal_robot(robot)
    for i, seen in joints_without_inertia(nominal.robot).items():  # a record would seem wrong by their factor
        raise ParameterError(
            f"{nominal.path}: {nominal.joints[i]} {seen}; expected the inertia of its links in the URDF, or a robot "
            "file in which the joint is locked"
        )
    prior = prior_of(nominal.robot, {SMOOTHING: nominal.smoothing})
    reading = Reading(read_map(mapping, nominal.joints) if mapping else None, start, duration, accepted)
    motions, notes = _read(records, nominal, reading)
    predicted, more = _read(hold_outs, nominal, reading)
    with _progress() as progress:
        identification = identification_of(motions, nominal.robot, prior, options, progress)
    compared = [hold_out(identification, record, nominal.robot, prior, options) for record in predicted]
    notes = (*notes, *more, *unconfirmed(compared))
    shares = {str(path): held.shares for path, held in zip(hold_outs, compared, strict=True)}
    lacks = lacking(motions, nominal.robot)
    inputs = {"robot": robot, "records": records, "hold_out": shares, "lacking": lacks, "notes": notes}
    values = {**identification.as_dict(), **inputs}
    file = _write(output, nominal, identification, motions, compared, values)
    paths = [output / name for name in (ROBOT, VALUES, PAGE)]
    lines = [*table(identification), *(["", "what the records lack:", *lacks] if lacks else [])]
    for held in compared:
        lines += ["", f"hold-out {held.record}: share of the deflection that a model leaves unexplained"]
        lines += aligned([("unexplained", *HOLD_OUT[1:]), *hold_out_rows(held)])
    lines += ["", f"written    {', '.join(map(str, paths))}"]
    following = [f"next       fjr check {paths[0]}", f"           fjr run {paths[0]} --lockstep"]
    lines += [f"no gains   {file.reason}"] if file.reason else following
    return Result("\n".join(lines), {**values, "files": paths})


def _mapped(record: Path, robot: Path | None) -> Result:
    """Write the mapping file of a table into the current folder, and say what to fill in and what to check."""
    file = Path(f"{record.name.partition('.')[0]}_map.yaml")
    if file.exists():
        raise ParameterError(f"{file} exists; expected a new file: remove it, or complete it by hand")
    nominal = nominal_robot(robot) if robot else None
    text, todo = written_map(record, nominal.joints if nominal else ())
    write_text(file, text)
    if nominal and GEAR_RATIO in nominal.given:
        todo.append(f"         the robot file has the gear ratios {nominal.given[GEAR_RATIO]}")
    again = f"fjr identify {record} --map {file} --robot {robot or 'ROBOT.yaml'}"
    return Result("\n".join([f"written  {file}", *todo, f"next     {again}"]), {"map": file, "to_do": todo})


def _read(paths: Sequence[Path], nominal: NominalRobot, reading: Reading) -> tuple[list[MotionRecord], tuple[str, ...]]:
    """Return the records and print what is remarkable about them."""
    pairs = [read_record(path, nominal.joints, nominal.robot, reading) for path in paths]
    notes = tuple(each for _, of_record in pairs for each in of_record)
    for each in notes:
        tell(each)
    return [record for record, _ in pairs], notes


@contextmanager
def _progress() -> Iterator[Callable[[str, float], None]]:
    """Show a bar, on a terminal, or a line for each step of the identification elsewhere."""
    shown = ""
    with progress_bar("identifying", PROGRESS, total=1.0, desc="identifying") as bar:

        def progress(what: str, share: float) -> None:
            nonlocal shown
            if what != shown and bar.disable:
                note(what)
            shown = what
            bar.set_description(what, refresh=False)
            bar.n = min(1.0, share)
            bar.refresh()

        yield progress


def _write(
    folder: Path,
    nominal: NominalRobot,
    identification: Identification,
    records: Sequence[MotionRecord],
    compared: Sequence[HoldOut],
    values: Mapping[str, Any],
) -> RobotFile:
    """Write robot.yaml, the URDF of corrected links, identification.json with the values, and the page."""
    folder.mkdir(parents=True, exist_ok=True)
    robot = IdentifiedRobot(nominal, identification)
    file = robot.file(folder, [record.name for record in records], ROBOT)
    write_text(folder / ROBOT, file.text)
    if robot.corrected_urdf:
        write_text(folder / CORRECTED, robot.corrected_urdf)
    write_text(folder / VALUES, json_text(values, indent=1) + "\n")
    seconds = sum(record.dt * len(record.u) for record in records)
    no_gains = [f"robot.yaml has no gains: {file.reason}"] if file.reason else []
    notes = [*values["lacking"], *values["notes"], *no_gains]
    write_page(folder / PAGE, nominal.name, identification, nominal.robot.units, compared, notes, seconds)
    return file


def table(identification: Identification) -> list[str]:
    """Return a headline, a line for each estimate, the stiffnesses first, and each reason once."""
    counts, of_stiffness = counted(identification), counted(identification, STIFFNESS)
    cells = [("parameter", "joint", "value", "95 % interval", "verdict")]
    for estimate in identification.estimates:
        ends = "" if estimate.verdict == UNKNOWN else interval(estimate.low, estimate.high)
        value = number(estimate.value, estimate.unit)
        cells.append((estimate.name, estimate.joint, value, ends, estimate.verdict))
    stiffness = f"joint stiffness K of {of_stiffness[IDENTIFIED]} of {plural(len(identification.joints), 'joint')}"
    others = f"{counts[WEAK]} weakly, {counts[UNKNOWN]} not identifiable"
    headline = f"{stiffness} and {plural(counts[IDENTIFIED], 'parameter')} identified, {others}"
    heads = {UNKNOWN: "not identifiable from these records, kept as given:", WEAK: "weakly identified:"}
    why = [(head, reasons(identification, verdict)) for verdict, head in heads.items()]
    return [
        headline,
        "",
        *aligned(cells),
        *(["", *seen] if (seen := springs_seen(identification)) else []),
        *(line for head, found in why if found for line in ("", head, *(f"{of}: {one}" for one, of in found.items()))),
    ]


def unconfirmed(compared: Sequence[HoldOut]) -> list[str]:
    """Return a sentence for each hold-out that joints without elasticity or without skew explain better."""
    sentences = []
    for held in compared:
        better = np.fmin(held.shares[:, 1], held.shares[:, 2]) < held.shares[:, 0]
        if better.any():
            joints = ", ".join(joint for joint, wrong in zip(held.joints, better, strict=True) if wrong)
            sentences.append(
                f"hold-out {held.record}: the deflection of {joints} is predicted better by rigid joints or no skew; "
                "the record does not confirm these stiffnesses"
            )
            tell(sentences[-1])
    return sentences
