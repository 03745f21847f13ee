# SPDX-License-Identifier: Apache-2.0
"""Read a record of motion from a table or a bag, in blocks, and check it against the robot.

Tables are CSV (also compressed) or Parquet. Memory grows with the numbers that are used only.
"""

from __future__ import annotations

import csv
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fjr_core.config.scenario import load_scenario
from fjr_core.errors import LONGEST, RecordError
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array
from fjr_monitor.recording.bag import FLOATS, STATES, Bag, read_bag
from fjr_monitor.recording.files import BagError, Times
from fjr_monitor.recording.signals import ANSWERS, EFFORTS, first_of_each_stamp, match_stamps
from fjr_msgs_py.names import motor_name, state_names

from ..estimation.motion_record import MotionRecord, record_of_samples
from . import record_map
from .checks import findings

TABLES = (".csv", ".csv.gz", ".txt", ".tsv", record_map.PARQUET)
SCENARIO = "scenario.yaml"
LARGEST = 2 * 10**7  # numbers of a record in memory
BYTES, MESSAGES = 2**22, 4096  # of a CSV file, of states in a bag, that are read together
Rows = tuple[Times, Times, Array]
"""Stamps and send times (k,) [ns] of k messages, and their numbers (k, width): positions, then efforts."""


@dataclass
class TimeWindow:
    """Part of a record: from `start` [s] after its first sample for `duration` [s]. ended: nothing more follows."""

    start: float = 0.0
    duration: float = np.inf
    ended: bool = field(default=False, init=False)
    _first: float | None = field(default=None, init=False)
    _count: int = field(default=0, init=False)

    @property
    def text(self) -> str:
        """Return the window for a message; empty if it is everything."""
        return "" if self.start == 0 and np.isinf(self.duration) else f" from {self.start:g} s for {self.duration:g} s"

    def of(self, t: Array, block: Array) -> Array:
        """Return the rows of a block with the times t [s] that are in the window; raise RecordError if too many are."""
        self._first = float(t[0]) if self._first is None and len(t) else self._first
        since = t - (self._first or 0.0)
        end = int(np.argmax(np.append(since >= self.start + self.duration, True)))
        self.ended = end < len(t)
        rows = np.asarray(block[:end][(since[:end] >= self.start) | (since[:end] < 0)])  # back in time: refused later
        self._count += rows.size
        if self._count > LARGEST:
            raise RecordError(
                f"the record holds more than {LARGEST:,} numbers; expected fewer: choose a --start and a --duration"
            )
        return rows


@dataclass(frozen=True)
class Reading:
    """How records are read. mapping: of the mapping file. start, duration [s]: the part that is used.

    accepted: kinds of contradictions that are reported and not refused.
    """

    mapping: record_map.TableMap | record_map.BagMap | None = None
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
        if not isinstance(reading.mapping, record_map.TableMap):
            raise RecordError(
                f"{path} is a table; expected --map FILE with its columns and units (--write-map makes one)"
            )
        record, notes = record_of_table(path, reading.mapping, joints, window)
    else:
        record, notes = record_of_bag(path, _bag_map(path, reading, joints, robot), joints, window)
    return record, (*notes, *_checked(path, record, robot, reading.accepted))


def _bag_map(path: Path, reading: Reading, joints: tuple[str, ...], robot: Robot) -> record_map.BagMap:
    """Return the mapping of a bag: of the mapping file, else of the scenario of the run, else the usual one."""
    if isinstance(reading.mapping, record_map.TableMap):
        raise RecordError(f"{path} is a bag and the mapping file has columns; expected one with 'bag'")
    if reading.mapping is not None:
        return reading.mapping
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
    path: Path, mapping: record_map.TableMap, joints: tuple[str, ...], window: TimeWindow
) -> tuple[MotionRecord, tuple[str, ...]]:
    """Return the record of a table within the window, and notes on it.

    Raises RecordError, which names the file, row and column, and MissingPackageError.
    """
    names, rows, pa = mapping.columns, 0, record_map.arrow()
    blocks: list[Array] = []
    try:
        for block in _blocks(path, names, mapping.delimiter):
            _check_finite(path, names, block, rows)
            rows += len(block)
            block[:, 0] *= mapping.time.factor
            blocks += [kept] if len(kept := window.of(block[:, 0], block)) else []
            if window.ended:
                break
    except (OSError, EOFError, UnicodeDecodeError, pa.ArrowException, csv.Error) as error:
        text = " ".join(str(error).split())[: LONGEST // 4]
        raise RecordError(f"{path} is not a table of numbers ({text}); expected CSV with points, or Parquet") from None
    if not blocks:
        raise RecordError(f"{path} holds no samples{window.text}; expected a record of motion")
    values = np.concatenate(blocks)
    signals = {name: np.full((len(values), len(joints)), np.nan) for name in record_map.UNITS}
    for name, columns in mapping.signals.items():
        for joint, column in columns.items():
            signals[name][:, joints.index(joint)] = column.factor * values[:, names.index(column.name)]
    return record_of_samples(path.name, joints, values[:, 0], list(signals.values()), mapping.held)


def _blocks(path: Path, names: list[str], delimiter: str) -> Iterator[Array]:
    """Yield the named columns (rows, columns) of a table block by block."""
    pa = record_map.arrow()
    if path.name.endswith(record_map.PARQUET):
        file = pa.parquet.ParquetFile(path)
        _check_header(path, file.schema_arrow.names, names)
        batches = file.iter_batches(columns=names, batch_size=2**16)
    else:
        skipped, header = record_map.header_of(path, delimiter)
        _check_header(path, header, names)
        batches = pa.csv.open_csv(
            pa.input_stream(str(path), compression="detect"),
            pa.csv.ReadOptions(block_size=BYTES, skip_rows=skipped + 1, column_names=header),
            pa.csv.ParseOptions(delimiter=delimiter),
            pa.csv.ConvertOptions(include_columns=names, column_types=dict.fromkeys(names, pa.float64())),
        )
    for batch in batches:
        yield np.column_stack([np.asarray(batch[name].to_numpy(zero_copy_only=False), dtype=float) for name in names])


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
    path: Path, mapping: record_map.BagMap, joints: tuple[str, ...], window: TimeWindow
) -> tuple[MotionRecord, tuple[str, ...]]:
    """Return the record of a bag from the first commanded state on, within the window, and notes on it.

    Effort: the command that answers each state by its stamp, else the last one sent before the next state, else the
    torque of the motors in the states. Raises BagError, RecordError.
    """
    bag = read_bag(path, mapping.namespace)
    commands = None if mapping.effort == record_map.BY_STATES else next(filter(bag.holds, (ANSWERS, EFFORTS)), None)
    if mapping.effort == record_map.BY_COMMANDS and commands is None:
        bag.held(ANSWERS)
    columns = {STATES: state_names(joints)} | ({commands: joints} if commands else {})
    read = _messages(bag, columns, window)
    n, (stamps, sent, rows) = len(joints), read[STATES]
    if not len(stamps):
        raise RecordError(f"{path} holds no state; expected a record of motion")
    q_l, q_m, tau, u = (rows[:, i * n : (i + 1) * n] for i in range(4))
    notes: tuple[str, ...] = ()
    if commands is None:
        notes = (f"no commands: the effort of {motor_name(joints[0])} and so on in the states is the torque",)
    else:
        topic = bag.held(commands)
        u, notes = _answers(stamps, sent, read[commands], topic.name, topic.type_name == FLOATS)
    unknown = np.full_like(q_l, np.nan)
    q_m, tau = (unknown, tau) if mapping.by_torque else (q_m / mapping.gear_ratio, unknown)
    driven = np.flatnonzero(np.isfinite(u).all(axis=1))
    if not len(driven):
        raise RecordError(f"{path} holds no effort of all joints; expected commands, or efforts in the states")
    begin, end = int(driven[0]), int(driven[-1]) + 1
    kept = begin + np.flatnonzero(np.append(True, np.diff(stamps[begin:end]) != 0))  # a waiting plant repeats its state
    u = u[kept]
    u = u[np.maximum.accumulate(np.where(np.isfinite(u).all(axis=1), np.arange(len(u)), 0))]  # the last command holds
    t = (stamps[kept] - stamps[kept[0]]) * 1e-9
    table = window.of(t, np.column_stack([t, q_l[kept], q_m[kept], u, tau[kept]]))
    if not len(table):
        raise RecordError(f"{path} holds no samples{window.text}; expected a record of motion")
    q_l, q_m, u, tau = signals = np.split(table[:, 1:], 4, axis=1)
    _check_complete(path, {"positions of the links": q_l, "positions of the motors": q_m, "joint torques": tau}, joints)
    return record_of_samples(path.name, joints, table[:, 0], signals, mapping.held, notes)


def _messages(bag: Bag, columns: Mapping[str, Sequence[str]], window: TimeWindow) -> dict[str, Rows]:
    """Return the messages of topics, with the joints of each, until the window ends; raise BagError, RecordError."""
    blocks: dict[str, list[Rows]] = {name: [] for name in columns}
    first, count = -1, 0
    for batch in bag.batches(columns, STATES, MESSAGES):
        for name, joints in columns.items():
            table = bag.table(batch[name], joints)
            if len(table.stamp) < len(batch[name].messages):
                raise BagError(f"{batch[name].name} holds messages of another length; expected {len(joints)} efforts")
            blocks[name].append((table.stamp, table.publish_time, np.hstack([table.position, table.effort])))
        stamps, _, rows = blocks[STATES][-1]
        count += rows.size
        if count > LARGEST:
            raise RecordError(f"{STATES} holds more than {LARGEST:,} numbers; expected fewer: choose a --duration")
        if first < 0 and all(any(len(block[0]) for block in of) for of in blocks.values()):
            first = int(stamps[-1]) if len(stamps) else first  # of the first states with commands
        if first >= 0 and len(stamps) and (stamps[-1] - first) * 1e-9 > window.start + window.duration + 1.0:
            break  # 1 s for late commands
    return {name: tuple(map(np.concatenate, zip(*of, strict=True))) for name, of in blocks.items()}  # type: ignore[misc]


def _answers(stamps: Times, sent: Times, commands: Rows, topic: str, unstamped: bool) -> tuple[Array, tuple[str, ...]]:
    """Return the command (k, n) of each state, NaN without one, and a note if some are missing."""
    times, published, rows = commands
    efforts = rows[:, rows.shape[1] // 2 :]
    if not len(times):
        raise RecordError(f"{topic} holds no command; expected one for each state")
    if unstamped:
        last = np.searchsorted(published, np.append(sent[1:], np.iinfo(np.int64).max)) - 1
        u = np.where(last[:, None] >= 0, efforts[np.maximum(last, 0)], np.nan)
        return u, (f"a command of {topic} is taken to answer the last state sent before it",)
    first = first_of_each_stamp(times)
    place, answered = match_stamps(stamps, times[first])
    u = np.where(answered[:, None], efforts[first][place], np.nan)
    ends = np.flatnonzero(answered)
    missing = int((~answered[ends[0] : ends[-1]]).sum()) if len(ends) else 0
    return u, (f"{missing} states have no command: the one before is taken to hold",) if missing else ()


def _check_complete(path: Path, signals: dict[str, Array], joints: Sequence[str]) -> None:
    """Raise RecordError for a signal that is there at some samples only."""
    for what, values in signals.items():
        known = np.isfinite(values)
        for j in np.flatnonzero(known.any(axis=0) & ~known.all(axis=0)):
            row = int(np.argmin(known[:, j]))
            raise RecordError(f"{path}: {what} of {joints[j]} are missing or not finite at sample {row}; expected all")
    if not np.isfinite(values := np.hstack(list(signals.values())[:2])).any():
        raise RecordError(f"{path}: no position of {', '.join(joints)} in its {values.shape[0]} states; expected some")
