# SPDX-License-Identifier: Apache-2.0
"""A record in CSV (also compressed) or Parquet: its samples, read in blocks, and a mapping file from its column names.

Memory grows with the used columns only. `fjr identify LOG --write-map` splits the name of a column into words:

    a1_motor_torque_nm = joint a1, signal effort, unit N m

Words of UNIT, SIGNAL and SIDE give unit and signal; the words that remain are the joint. What no word gives is marked
FILL_IN, which the reader of mapping files refuses until it is replaced.
"""

from __future__ import annotations

import csv
import gzip
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fjr_core.config import ros_yaml
from fjr_core.errors import LONGEST, MissingPackageError, RecordError
from fjr_core.numerics.checks import Array

from .estimation.motion_record import MotionRecord, TimeWindow, record_of_samples
from .record_map import ANGLES, EFFORT, LINK, MOTOR, TORQUE, UNITS, TableMap

PARQUET = ".parquet"
BLOCK = 2**22  # bytes of a CSV file that are converted at once
HEADER_LINES = 1000  # empty lines and comments before the header, at most
FILL_IN = "FILL_IN"
TIME = "time"
UNIT = {
    **{word: word for word in ("rad", "mrad", "deg", "turn", "mm", "s", "ms", "us", "ns", "kn")},
    **{"degree": "deg", "degrees": "deg", "radian": "rad", "radians": "rad", "rev": "turn", "turns": "turn"},
    **{"nm": "N m", "mnm": "mN m", "knm": "kN m", "kn": "kN", "sec": "s", "seconds": "s"},
}
"""Unit of a word; m and n alone are units only at the end of a name, where N m may be two words."""
TIMES = {"time", "timestamp", "stamp", "t"}
IGNORED = {"reference", "ref", "desired", "des", "setpoint", "target", "velocity", "vel", "speed", "dq", "qd"}
IGNORED |= {"acceleration", "acc", "ddq", "current", "temperature", "temp", "error", "err", "state", "status"}
EFFORTS = {"torque", "effort", "tau", "trq", "u", "force", "moment"}
POSITIONS = {"position", "pos", "angle", "q", "theta", "encoder", "enc"}
SIDES = {MOTOR: {"motor", "rotor", "qm", "m"}, LINK: {"link", "load", "output", "secondary", "ql", "l"}}
SENSORS = {"sensor", "measured", "ext", "jts"}


def _arrow() -> Any:
    """Return pyarrow with its readers, loaded on use: a bag needs none of them. Raises MissingPackageError."""
    try:
        import pyarrow.csv
        import pyarrow.parquet
    except ModuleNotFoundError:
        raise MissingPackageError("pyarrow is not installed; expected it for tables: pip install pyarrow") from None
    return pyarrow


def record_of_table(
    path: Path, mapping: TableMap, joints: tuple[str, ...], window: TimeWindow
) -> tuple[MotionRecord, tuple[str, ...]]:
    """Return the record of a table within the window, and notes on it.

    Raises RecordError, which names the file, row and column, and MissingPackageError.
    """
    names, rows, pa = mapping.columns, 0, _arrow()
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
        raise RecordError(f"{path} is not a table of numbers ({text}); expected CSV or Parquet") from None
    if not blocks:
        raise RecordError(f"{path} holds no samples{window.text}; expected a record of motion")
    values = np.concatenate(blocks)
    signals = {name: np.full((len(values), len(joints)), np.nan) for name in UNITS}
    for name, columns in mapping.signals.items():
        for joint, column in columns.items():
            signals[name][:, joints.index(joint)] = column.factor * values[:, names.index(column.name)]
    q_l, q_m, u, torque = (signals[name] for name in (LINK, MOTOR, EFFORT, TORQUE))
    return record_of_samples(path.name, joints, values[:, 0], q_l, q_m, u, torque)


def _blocks(path: Path, names: list[str], delimiter: str) -> Iterator[Array]:
    """Yield the named columns (rows, columns) of a table block by block."""
    pa = _arrow()
    if path.name.endswith(PARQUET):
        file = pa.parquet.ParquetFile(path)
        _check_header(path, file.schema_arrow.names, names)
        batches = file.iter_batches(columns=names, batch_size=2**16)
    else:
        skipped, header = header_of(path, delimiter)
        _check_header(path, header, names)
        batches = pa.csv.open_csv(
            pa.input_stream(str(path), compression="detect"),
            pa.csv.ReadOptions(block_size=BLOCK, skip_rows=skipped + 1, column_names=header),
            pa.csv.ParseOptions(delimiter=delimiter),
            pa.csv.ConvertOptions(include_columns=names, column_types=dict.fromkeys(names, pa.float64())),
        )
    for batch in batches:
        yield np.column_stack([np.asarray(batch[name].to_numpy(zero_copy_only=False), dtype=float) for name in names])


def header_of(path: Path, delimiter: str) -> tuple[int, list[str]]:
    """Return the number of lines before the header of a CSV file, and the names in it; raises RecordError, OSError."""
    opened = gzip.open if path.suffix == ".gz" else open
    with opened(path, "rt", encoding="utf-8-sig", newline="") as stream:
        for number in range(HEADER_LINES):
            line = stream.readline(2**20)
            if line.strip() and not line.lstrip().startswith("#"):
                return number, [name.strip() for name in next(csv.reader([line], delimiter=delimiter))]
    raise RecordError(f"{path} has no header; expected the names of the columns in the first line")


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
        count = len(np.unique(wrong[:, 0]))
        raise RecordError(
            f"{path}, row {before + row + 1}, column {names[column]}: {block[row, column]}; expected a finite number "
            f"({count} such rows from there on)"
        )


@dataclass(frozen=True)
class Meaning:
    """What the name of a column says; "" where it says nothing. signal: also "position", of an unknown side."""

    column: str
    signal: str = ""
    joint: str = ""
    unit: str = ""


def written_map(table: Path, joints: Sequence[str]) -> tuple[str, list[str]]:
    """Return the text of a mapping file for a table, and a line for each thing to fill in or to check.

    joints: of the robot file, empty without one. Raises RecordError for a table without header or without positions.
    """
    delimiter, header = _delimiter_and_names(table)
    meanings = [_meaning(column, joints) for column in header]
    if joints and {meaning.joint for meaning in meanings} & set(joints):  # columns of other joints are of no use
        meanings = [m if m.joint in ("", *joints) else Meaning(m.column) for m in meanings]
    by_signal = {name: [m for m in meanings if m.signal == name] for name in (*UNITS, "position")}
    if not any(by_signal.values()):
        raise RecordError(
            f"{table}: no name of a column says position or torque ({', '.join(header)[: LONGEST // 4]}); expected "
            "names such as a1_motor_rad and a1_motor_torque_nm, or a mapping file written by hand"
        )
    todo: list[str] = []
    lines = [f"# Columns of {table.name}, by `fjr identify --write-map`; docs/from_csv.md explains the keys."]
    lines += [] if delimiter == "," else [f"delimiter: {_text(delimiter)}"]
    time = next((m for m in meanings if m.signal == TIME), None)
    todo += [] if time else ["fill in  time.column: no column was recognised"]
    todo += [] if time and time.unit else ["fill in  time.unit: s, ms, us or ns"]
    column, unit = (_text(time.column), time.unit) if time else (FILL_IN, "")
    lines.append(f"time: {{column: {column}, unit: {unit or FILL_IN}}}")
    if by_signal["position"]:
        todo.append(
            f"fill in  whether {_few(by_signal['position'])} are {MOTOR} or {LINK}: replace {FILL_IN} by one of them"
        )
    for signal, columns in by_signal.items():
        if columns:
            lines += _signal(FILL_IN if signal == "position" else signal, columns, joints, todo)
    if not by_signal[EFFORT]:
        lines.append(f"{EFFORT}: {{column: {FILL_IN}, unit: {FILL_IN}}}")
        todo.append(f"fill in  {EFFORT}: no column was recognised")
    unused = [m.column for m in meanings if not m.signal or (m.signal == TIME and m != time)]
    lines += [f"# not used: {', '.join(unused)}"] if unused else []
    return "\n".join(lines) + "\n", todo


def _signal(signal: str, columns: Sequence[Meaning], joints: Sequence[str], todo: list[str]) -> Iterator[str]:
    """Yield the lines of a signal and add what is missing to `todo`."""
    units = {meaning.unit for meaning in columns}
    unit = units.pop() if len(units) == 1 else ""
    if not unit:
        possible = ANGLES if signal in (FILL_IN, LINK, MOTOR) else UNITS[EFFORT]
        todo.append(f"fill in  {signal}.unit of {_few(columns)}: {', '.join(possible)}")
    said = [meaning.joint for meaning in columns]
    distinct = all(said) and len(set(said)) == len(said)
    named = said if distinct and set(said) <= set(joints or said) else []
    if not named and joints and len(said) == len(joints):
        named = list(joints)
        todo.append(f"check    {signal}: {_few(columns)} are taken for {', '.join(joints)} in this order")
    if not named:
        todo.append(
            f"fill in  {signal}.joints of {_few(columns)}: one joint of the robot file for each, in their order"
        )
    patterns = {m.column.replace(joint, "{joint}", 1) for m, joint in zip(columns, named, strict=False)}
    yield f"{signal}:"
    yield f"  column: {_text(patterns.pop()) if len(patterns) == 1 else _listed(m.column for m in columns)}"
    if not named or not joints or named != list(joints):
        yield f"  joints: {_listed(named) if named else FILL_IN}"
    yield f"  unit: {unit or FILL_IN}"
    if signal in (FILL_IN, MOTOR, EFFORT):
        yield "  gear_ratio: 1.0   # motor turns per joint turn, if the columns count at the motor's shaft"
        todo.append(f"check    {signal}.gear_ratio is 1: {_few(columns)} count at the joint's side")


def _meaning(column: str, joints: Sequence[str]) -> Meaning:
    """Return what the name of a column says."""
    words, joint = _words(column), ""
    for name in sorted(joints, key=len, reverse=True):
        part = _words(name)
        starts = [i for i in range(len(words) - len(part) + 1) if words[i : i + len(part)] == part]
        if starts:
            joint, words = name, [*words[: starts[0]], *words[starts[0] + len(part) :]]
            break
    unit, words = _unit(words)
    said = set(words)
    if said & IGNORED:
        return Meaning(column)
    if said & TIMES and not said & (EFFORTS | POSITIONS):
        return Meaning(column, TIME, "", unit)
    side = next((side for side, names in SIDES.items() if said & names), "")
    if said & EFFORTS or unit in UNITS[EFFORT]:
        signal = TORQUE if said & SENSORS or side == LINK else EFFORT
    elif said & POSITIONS or side or unit in ANGLES:
        signal = side or "position"
    else:
        return Meaning(column)
    kept = [word for word in words if word not in EFFORTS | POSITIONS | SENSORS | SIDES[MOTOR] | SIDES[LINK]]
    return Meaning(column, signal, joint or "_".join(kept), unit)


def _words(text: str) -> list[str]:
    """Split a name at everything but letters and digits and before capitals, and letters of symbols from numbers."""
    symbols = EFFORTS | POSITIONS | SIDES[MOTOR] | SIDES[LINK] | IGNORED
    words: list[str] = []
    for part in re.split(r"[^A-Za-z0-9]+", re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", text)):
        numbered = re.fullmatch(r"([a-z]+)(\d+)", part.lower())
        words += numbered.groups() if numbered and numbered[1] in symbols else [part.lower()] if part else []
    return words


def _unit(words: Sequence[str]) -> tuple[str, list[str]]:
    """Return the unit at the end of the words, "" if there is none, and the words before it."""
    units = {**UNIT, "m": "m", "n": "N"}
    for count in (2, 1):
        end = "".join(words[-count:])
        if len(words) > count and (count == 1 or words[-2:] == ["n", "m"]) and end in units:
            return units[end], list(words[:-count])
    return "", list(words)


def _delimiter_and_names(table: Path) -> tuple[str, list[str]]:
    """Return delimiter and names of the columns; raises RecordError, MissingPackageError."""
    pa = _arrow()
    try:
        if table.name.endswith(PARQUET):
            return ",", list(pa.parquet.read_schema(table).names)
        headers: Mapping[str, list[str]] = {mark: header_of(table, mark)[1] for mark in ",;\t"}
    except (OSError, EOFError, UnicodeDecodeError, pa.ArrowException, csv.Error) as error:
        raise RecordError(f"{table} is not a table ({' '.join(str(error).split())}); expected CSV or Parquet") from None
    delimiter = max(headers, key=lambda mark: len(headers[mark]))
    return delimiter, headers[delimiter]


def _few(columns: Sequence[Meaning], most: int = 3) -> str:
    names = [meaning.column for meaning in columns]
    return ", ".join(names) if len(names) <= most else f"{names[0]} to {names[-1]}"


def _text(name: str) -> str:
    return ros_yaml.dump([name]).strip()[1:-1]


def _listed(names: Iterable[str]) -> str:
    return ros_yaml.dump(list(names)).strip()
