# SPDX-License-Identifier: Apache-2.0
"""Read a record of motion from a table or a bag, in blocks, and check it against the robot.

Tables are CSV (also compressed) or Parquet. Memory grows with the numbers that are used only.
"""

from __future__ import annotations

import csv
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fjr_core.config.scenario import load_scenario
from fjr_core.errors import LONGEST, RecordError
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array
from fjr_monitor.diagnosis.record import PART, held_efforts
from fjr_monitor.recording.bag import read_bag
from fjr_monitor.recording.signals import RunSignals
from fjr_msgs_py.console.output import plural
from fjr_msgs_py.names import motor_name

from ..estimation.motion_record import MotionRecord, record_of_samples
from . import record_map
from .checks import findings

TABLES = (".csv", ".csv.gz", ".txt", ".tsv", record_map.PARQUET)
SCENARIO = "scenario.yaml"
LARGEST = 2 * 10**7  # numbers of a record in memory
BYTES = 2**22  # of a CSV file that are read together


@dataclass(frozen=True)
class Reading:
    """How records are read. mapping: of the mapping file. start, duration [s]: the part that is used.

    accepted: kinds of contradictions that are reported and not refused.
    """

    mapping: record_map.TableMap | record_map.BagMap | None = None
    start: float = 0.0
    duration: float = np.inf
    accepted: Collection[str] = ()

    def part(self, path: Path, blocks: Iterable[Array]) -> Array:
        """Return the rows of blocks (k, m) that are used; the first column is the time [s].

        Raises RecordError, which names the file, if there is none, or if there are too many.
        """
        kept: list[Array] = []
        first, count = None, 0
        for block in blocks:
            first = block[0, 0] if first is None and len(block) else first
            since = block[:, 0] - (first or 0.0)
            end = int(np.argmax(np.append(since >= self.start + self.duration, True)))
            kept.append(block[:end][(since[:end] >= self.start) | (since[:end] < 0)])  # back in time: refused later
            count += kept[-1].size
            if count > LARGEST:
                raise RecordError(f"{path} holds more than {LARGEST:,} numbers; expected fewer: --start, --duration")
            if end < len(block):
                break
        if not any(map(len, kept)):
            everything = self.start == 0 and np.isinf(self.duration)
            part = "" if everything else f" from {self.start:g} s for {self.duration:g} s"
            raise RecordError(f"{path} holds no samples{part}; expected a record of motion")
        return np.concatenate(kept)


def read_record(
    path: Path, joints: tuple[str, ...], robot: Robot, reading: Reading
) -> tuple[MotionRecord, tuple[str, ...]]:
    """Return the record of a file or bag, and a sentence for everything that is remarkable about it.

    Raises RecordError, which names the file, for a record that contradicts itself or the robot; BagError.
    """
    if path.name.endswith(TABLES):
        if not isinstance(reading.mapping, record_map.TableMap):
            raise RecordError(
                f"{path} is a table; expected --map FILE with its columns and units (--write-map makes one)"
            )
        record, notes = record_of_table(path, reading.mapping, joints, reading)
    else:
        record, notes = record_of_bag(path, _bag_map(path, reading.mapping, joints), joints, reading)
    return record, (*notes, *_checked(path, record, robot, reading.accepted))


def _bag_map(
    path: Path, given: record_map.TableMap | record_map.BagMap | None, joints: tuple[str, ...]
) -> record_map.BagMap:
    """Return the mapping of a bag: of the mapping file, else of the scenario of the run, else the usual one."""
    if isinstance(given, record_map.TableMap):
        raise RecordError(f"{path} is a bag and the mapping file has columns; expected one with 'bag'")
    if given is not None:
        return given
    run = next((folder for folder in (path, *path.resolve().parents[:2]) if (folder / SCENARIO).is_file()), None)
    if run is None:
        return record_map.BagMap(np.ones(len(joints)))
    scenario = load_scenario(run / SCENARIO, user_code=False)
    if scenario.joints != joints:
        raise RecordError(f"{path} was recorded with the joints {scenario.joints}; expected {joints}, as the robot")
    measured = scenario.measurement
    ratio = np.asarray(measured.gear_ratio, dtype=float)
    return record_map.BagMap(ratio, by_torque=measured.by_torque, held=scenario.sample_period)


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


def record_of_table(
    path: Path, mapping: record_map.TableMap, joints: tuple[str, ...], reading: Reading = Reading()
) -> tuple[MotionRecord, tuple[str, ...]]:
    """Return the record of the part of a table that is used, and notes on it.

    Raises RecordError, which names the file, row and column, and MissingPackageError.
    """
    names = mapping.columns
    values = reading.part(path, _blocks(path, mapping))
    signals = {name: np.full((len(values), len(joints)), np.nan) for name in record_map.UNITS}
    for name, columns in mapping.signals.items():
        for joint, column in columns.items():
            signals[name][:, joints.index(joint)] = column.factor * values[:, names.index(column.name)]
    return record_of_samples(path.name, joints, values[:, 0], list(signals.values()), mapping.held)


def _blocks(path: Path, mapping: record_map.TableMap) -> Iterator[Array]:
    """Yield the columns of a mapping (rows, columns), the time in s first, of a table block by block."""
    pa, names, rows = record_map.arrow(), mapping.columns, 0
    try:
        for batch in _batches(path, names, mapping.delimiter):
            columns = [batch[name].to_numpy(zero_copy_only=False) for name in names]
            block = np.column_stack([np.asarray(column, dtype=float) for column in columns])
            _check_finite(path, names, block, rows)
            rows += len(block)
            block[:, 0] *= mapping.time.factor
            yield block
    except (OSError, EOFError, UnicodeDecodeError, pa.ArrowException, csv.Error) as error:
        text = " ".join(str(error).split())[: LONGEST // 4]
        raise RecordError(f"{path} is not a table of numbers ({text}); expected CSV with points, or Parquet") from None


def _batches(path: Path, names: list[str], delimiter: str) -> Iterator[Any]:
    """Return the record batches of a table with the named columns; raises RecordError."""
    pa = record_map.arrow()
    if path.name.endswith(record_map.PARQUET):
        file = pa.parquet.ParquetFile(path)
        _check_header(path, file.schema_arrow.names, names)
        return iter(file.iter_batches(columns=names, batch_size=2**16))
    skipped, header = record_map.header_of(path, delimiter)
    _check_header(path, header, names)
    batches = pa.csv.open_csv(
        pa.input_stream(str(path), compression="detect"),
        pa.csv.ReadOptions(block_size=BYTES, skip_rows=skipped + 1, column_names=header),
        pa.csv.ParseOptions(delimiter=delimiter),
        pa.csv.ConvertOptions(include_columns=names, column_types=dict.fromkeys(names, pa.float64())),
    )
    return iter(batches)


def _check_header(path: Path, header: list[str], names: list[str]) -> None:
    """Raise RecordError if a column is missing or there twice."""
    for name in names:
        if header.count(name) != 1:
            count = "more than once" if name in header else "missing"
            seen = ", ".join(header)[: LONGEST // 4]
            raise RecordError(f"{path}: column {name} is {count}; expected it once (the header is {seen})")


def _check_finite(path: Path, names: list[str], block: Array, before: int) -> None:
    """Raise RecordError for the first number of a block that is not finite."""
    wrong = np.argwhere(~np.isfinite(block))
    if len(wrong):
        row, column = wrong[0]
        raise RecordError(
            f"{path}, row {before + row + 1}, column {names[column]}: {block[row, column]}; expected a finite number "
            f"({len(np.unique(wrong[:, 0]))} such rows from there on)"
        )


def record_of_bag(
    path: Path, mapping: record_map.BagMap, joints: tuple[str, ...], reading: Reading = Reading()
) -> tuple[MotionRecord, tuple[str, ...]]:
    """Return the record of a bag from the first commanded state on, of the part that is used, and notes on it.

    Effort: the command that answers each state, where there is none the one before, or else the torque of the motors in
    the states. Raises BagError, RecordError.
    """
    signals = RunSignals(read_bag(path, mapping.namespace), joints, until=reading.start + reading.duration)
    by_states, notes = mapping.by_states or signals.commands is None, signals.notes
    if by_states:
        notes += (f"the effort of {motor_name(joints[0])} and so on in the states is the torque",)
    elif missing := int((signals.answered < 0).sum()):
        notes += (f"{plural(missing, 'state')} without a command: the one before is taken to hold",)
    table = reading.part(path, _states(path, signals, mapping, by_states))
    return record_of_samples(path.name, joints, table[:, 0], np.split(table[:, 1:], 4, axis=1), mapping.held, notes)


def _states(path: Path, signals: RunSignals, mapping: record_map.BagMap, by_states: bool) -> Iterator[Array]:
    """Yield time [s], q_l, q_m, u and joint torques of the states from the first effort on, PART states at a time."""
    n, before = len(mapping.gear_ratio), np.full(len(mapping.gear_ratio), np.nan)
    for start in range(0, len(signals.stamp), PART):
        rows = slice(start, start + PART)
        position, _, effort = signals.states(rows)
        u = held_efforts(effort[:, n:] if by_states else signals.efforts(rows), before)
        unknown, before = np.full_like(u, np.nan), u[-1]
        q_m, tau = (unknown, effort[:, :n]) if mapping.by_torque else (position[:, n:] / mapping.gear_ratio, unknown)
        t = (signals.stamp[rows] - signals.stamp[0]) * 1e-9
        yield np.column_stack([t, position[:, :n], q_m, u, tau])[np.isfinite(u).all(axis=1)]
    if not np.isfinite(before).all():
        raise RecordError(f"{path} holds no effort of all joints; expected answers to states, or efforts in them")
