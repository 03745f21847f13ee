# SPDX-License-Identifier: Apache-2.0
"""Read the samples of a motion from CSV or Parquet: columns `time` [s], each joint [rad, m], optionally its velocity.

The header names the columns. Columns may come in any order; other columns are ignored. Empty lines and lines that
begin with # are skipped.
"""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import LONGEST, TrajectoryError
from .text_file import is_lines, read_text

TIME, VELOCITY = "time", "_velocity"
"""Name of the column of times, and the end of the name of a joint's velocity column."""
PARQUET = ".parquet"
SHORTEST_STEP, LARGEST_TABLE = 1e-6, 10**7  # s between samples; numbers in a Parquet file
_Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MotionTable:
    """Samples of a motion: times (k,) [s] that increase, positions (k, n) [rad, m], velocities (k, n) or None."""

    times: _Array
    positions: _Array
    velocities: _Array | None = None


def read_motion(path: str | os.PathLike[str], joints: Sequence[str]) -> MotionTable:
    """Return the motion of the joints from a CSV file, or from a Parquet file if the name ends with .parquet.

    A path with a line break is the text of a CSV file.
    Raises TrajectoryError, which names file, line (or row) and column.
    """
    name = os.fspath(path)
    if is_lines(name):
        return parse_motion(name, joints)
    try:
        return _parquet_motion(name, joints) if name.endswith(PARQUET) else parse_motion(read_text(path), joints)
    except TrajectoryError as error:
        raise TrajectoryError(f"{name}: {error}") from None
    except OSError as error:
        raise TrajectoryError(f"{name} cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise TrajectoryError(f"{name} is not UTF-8 text; expected CSV with a header line") from None


def parse_motion(text: str, joints: Sequence[str]) -> MotionTable:
    """Return the motion of the joints from the text of a CSV file; raise TrajectoryError."""
    lines = _rows(text)
    _, header = next(lines, (0, []))
    columns = motion_columns([name.strip() for name in header], joints)
    numbers, rows = [], []
    for number, row in lines:
        if len(row) != len(header):
            raise TrajectoryError(f"line {number} has {len(row)} columns; expected {len(header)}, as in the header")
        rows.append([_number(row[i], number, name) for name, i in columns.items()])
        numbers.append(number)
    values = np.array(rows, dtype=float).reshape(len(rows), len(columns))
    return motion_table(values, joints, lambda i: f"line {numbers[i]}")


def motion_text(table: MotionTable, joints: Sequence[str]) -> str:
    """Return the text of a CSV file from which `parse_motion` reads the same numbers."""
    columns = [table.times[:, None], table.positions]
    header = [TIME, *joints]
    if table.velocities is not None:
        columns.append(table.velocities)
        header += [name + VELOCITY for name in joints]
    lines = (",".join(map(repr, row)) for row in np.concatenate(columns, axis=1).tolist())
    return "\n".join([",".join(header), *lines, ""])


def motion_columns(header: Sequence[str], joints: Sequence[str]) -> dict[str, int]:
    """Return the indices of the columns to read, by name: time, joints, then velocities if there are any.

    Raises TrajectoryError if a column is missing or is there twice, or if some joints only have a velocity.
    """
    wanted = [TIME, *joints]
    optional = [name + VELOCITY for name in joints if name + VELOCITY not in wanted]
    present = [name for name in optional if name in header]
    if present:
        wanted += [name + VELOCITY for name in joints]
    missing = [name for name in wanted if name not in header]
    if missing:
        seen, sought = (", ".join(names)[: LONGEST // 4] for names in (header, wanted))
        raise TrajectoryError(f"the header is '{seen}', without {missing[0]}; expected the columns {sought}")
    twice = [name for name in wanted if list(header).count(name) > 1]
    if twice:
        raise TrajectoryError(f"the header has the column {twice[0]} more than once; expected it once")
    return {name: list(header).index(name) for name in wanted}


def motion_table(values: _Array, joints: Sequence[str], where: Callable[[int], str] = "row {}".format) -> MotionTable:
    """Return the motion of columns (k, 1 + n) or (k, 1 + 2 n) in the order of `motion_columns`; times begin at 0.

    where: names a row in messages. Raises TrajectoryError for fewer than two rows, and for times that do not increase.
    """
    n, times = len(joints), values[:, 0]
    if len(times) < 2:
        raise TrajectoryError(f"{len(times)} samples are given; expected at least 2")
    stalls = np.flatnonzero(~(np.diff(times) >= SHORTEST_STEP))
    if len(stalls):
        i = int(stalls[0])
        raise TrajectoryError(
            f"{where(i + 1)}, column {TIME}: {times[i + 1]:.9g} s follows {times[i]:.9g} s; "
            f"expected an increase of at least {SHORTEST_STEP:g} s"
        )
    velocities = values[:, 1 + n :] if values.shape[1] > 1 + n else None
    return MotionTable(times - times[0], values[:, 1 : 1 + n], velocities)


def _parquet_motion(path: str, joints: Sequence[str]) -> MotionTable:
    """Return the motion of a Parquet file; raise TrajectoryError, also if pyarrow is not installed."""
    try:
        import pyarrow as pa  # optional: no other part of this package reads Parquet
        import pyarrow.parquet as pq
    except ImportError:
        raise TrajectoryError("pyarrow is not installed; expected it, or a CSV file") from None
    try:
        file = pq.ParquetFile(path)
        columns = list(motion_columns(file.schema_arrow.names, joints))
        if file.metadata.num_rows * len(columns) > LARGEST_TABLE:
            raise TrajectoryError(
                f"{file.metadata.num_rows} rows are too many; expected {LARGEST_TABLE} numbers or fewer"
            )
        table = file.read(columns)
        values = np.stack([np.asarray(table[name].to_numpy(), dtype=float) for name in columns], axis=1)
    except (OSError, pa.ArrowException, TypeError, ValueError) as error:
        raise TrajectoryError(f"is not a Parquet file of numbers ({' '.join(str(error).split())[:200]})") from None
    wrong = np.argwhere(~np.isfinite(values))
    if len(wrong):
        row, column = wrong[0]
        raise TrajectoryError(f"row {row}, column {columns[column]}: {values[row, column]}; expected a finite number")
    return motion_table(values, joints)


def _rows(text: str) -> Iterator[tuple[int, list[str]]]:
    """Yield line number and cells of each line that is neither empty nor a comment."""
    for number, line in enumerate(text.splitlines(), 1):
        if line.strip() and not line.lstrip().startswith("#"):
            try:
                yield number, next(csv.reader([line], strict=True))
            except csv.Error as error:
                raise TrajectoryError(f"line {number} is not CSV ({error}); expected numbers and commas") from None


def _number(cell: str, line: int, column: str) -> float:
    """Return a finite number; raise TrajectoryError with line and column."""
    try:
        value = math.nan if "_" in cell else float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise TrajectoryError(f"line {line}, column {column}: '{cell.strip()[:60]}'; expected a finite number")
    return value
