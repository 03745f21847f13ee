# SPDX-License-Identifier: Apache-2.0
"""Read a record of motion of any kind and check it against the robot."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fjr_core.config.scenario import load_scenario
from fjr_core.errors import RecordError
from fjr_core.model.robot import Robot

from .bag_record import record_of_bag
from .estimation.motion_record import MotionRecord, TimeWindow
from .record_checks import findings
from .record_map import BagMap, TableMap
from .table_record import PARQUET, record_of_table

TABLES = (".csv", ".csv.gz", ".txt", ".tsv", PARQUET)
SCENARIO = "scenario.yaml"


@dataclass(frozen=True)
class Reading:
    """How records are read. mapping: of the mapping file. start, duration [s]: the part that is used.

    accepted: kinds of contradictions that are reported and not refused.
    """

    mapping: TableMap | BagMap | None = None
    start: float = 0.0
    duration: float = np.inf
    accepted: Collection[str] = ()


def read_record(
    path: Path, joints: tuple[str, ...], robot: Robot, reading: Reading
) -> tuple[MotionRecord, tuple[str, ...]]:
    """Return the record of a file or bag, and a sentence for everything that is remarkable about it.

    Raises RecordError, which names the file, for a record that contradicts itself or the robot; BagError.
    """
    window = TimeWindow(reading.start, reading.duration)
    if path.name.endswith(TABLES):
        if not isinstance(reading.mapping, TableMap):
            raise RecordError(
                f"{path} is a table; expected --map FILE with its columns and units (--write-map makes one)"
            )
        record, notes = record_of_table(path, reading.mapping, joints, window)
    else:
        record, notes = record_of_bag(path, _bag_map(path, reading, joints, robot), joints, window)
    return record, (*notes, *_checked(path, record, robot, reading.accepted))


def _bag_map(path: Path, reading: Reading, joints: tuple[str, ...], robot: Robot) -> BagMap:
    """Return the mapping of a bag: of the mapping file, else of the scenario of the run, else the usual one."""
    if isinstance(reading.mapping, TableMap):
        raise RecordError(f"{path} is a bag and the mapping file has columns; expected one with 'bag'")
    if reading.mapping is not None:
        return reading.mapping
    run = next((folder for folder in (path, *path.resolve().parents[:2]) if (folder / SCENARIO).is_file()), None)
    if run is None:
        return BagMap(np.ones(len(joints)))
    scenario = load_scenario(run / SCENARIO, user_code=False)
    if scenario.joints != joints:
        raise RecordError(f"{path} was recorded with the joints {scenario.joints}; expected {joints}, as the robot")
    measured = scenario.measurement
    return BagMap(np.asarray(measured.gear_ratio, dtype=float), by_torque=measured.by_torque)


def _checked(path: Path, record: MotionRecord, robot: Robot, accepted: Collection[str]) -> tuple[str, ...]:
    """Return a sentence for each accepted contradiction and for joints at rest; raise RecordError for other ones."""
    contradictions = findings(record, robot, accepted)
    refused = [finding for finding in contradictions if finding.kind not in accepted]
    if refused:
        more = f" (and {len(refused) - 1} more)" if len(refused) > 1 else ""
        raise RecordError(f"{path}: {refused[0].sentence}{more}; --accept {refused[0].kind} identifies nevertheless")
    rest = [f"standing still: {', '.join(record.still)}"] if record.still else []
    sentences = [*(finding.sentence for finding in contradictions), *rest]
    return tuple(f"{path}: {sentence}" for sentence in sentences)
