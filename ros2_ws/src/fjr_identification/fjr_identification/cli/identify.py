# SPDX-License-Identifier: Apache-2.0
"""`fjr identify`: a robot file with intervals from recorded motion."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from click import UsageError

from fjr_core.errors import ParameterError
from fjr_core.files.atomic_file import write_text
from fjr_identification.cli.command import Request, identify_robot
from fjr_identification.estimation.finding import KINDS
from fjr_identification.estimation.parameters import Options
from fjr_identification.records.header_map import written_map
from fjr_identification.records.read_record import Reading
from fjr_identification.robot_file.nominal_robot import GEAR_RATIO, nominal_robot
from fjr_msgs_py.console.output import Result


def identify(
    records: Sequence[Path],
    robot: Path | None,
    hold_outs: Sequence[Path],
    mapping: Path | None,
    write_map: bool,
    joints: tuple[str, ...],
    start: float,
    duration: float,
    accepted: Sequence[str],
    payload: bool,
    link_inertia: bool,
    static_friction: bool,
    position_torque: str,
    output: Path,
) -> Result:
    """Identify a robot from records; accepted: kinds of contradictions that are reported only.

    write_map: write the mapping file of the first record instead, next to which nothing is replaced.
    """
    if write_map:
        return _mapped(records[0], robot)
    if robot is None:
        raise UsageError("Missing option '--robot'.")
    unknown = [kind for kind in accepted if kind not in KINDS]
    if unknown:
        raise ParameterError(f"--accept is '{unknown[0]}'; expected one of {', '.join(KINDS)}")
    options = Options(
        joints=joints,
        payload=payload,
        link_inertia=link_inertia,
        static_friction=static_friction,
        position_torque=position_torque,
    )
    reading = Reading(start=start, duration=duration, accepted=accepted)
    return identify_robot(Request(records, hold_outs, robot, mapping, reading, options, output))


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
