# SPDX-License-Identifier: Apache-2.0
"""Read a record of motion from CSV (also compressed) or Parquet, in blocks: memory grows with the used columns only."""

from __future__ import annotations

import csv
import gzip
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

from fjr_core.errors import LONGEST, RecordError
from fjr_core.numerics.checks import Array
from fjr_identification.records.record_map import EFFORT, LINK, MOTOR, TORQUE, TableMap
from fjr_identification.records.samples import Samples, Window

PARQUET = ".parquet"
BLOCK = 2**22  # bytes of a CSV file that are converted at once
HEADER_LINES = 1000  # empty lines and comments before the header, at most


def table_samples(path: Path, mapping: TableMap, joints: tuple[str, ...], window: Window) -> Samples:
    """Return the samples of a table within the window; raise RecordError, which names the file, row and column."""
    names, rows = mapping.columns, 0
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
    return _samples(path, values, names, mapping, joints)


def _samples(path: Path, values: Array, names: list[str], mapping: TableMap, joints: tuple[str, ...]) -> Samples:
    """Return the columns (k, 1 + m) as signals in SI units at the joint side."""

    def signal(name: str) -> Array:
        found = np.full((len(values), len(joints)), np.nan)
        for joint, column in mapping.signals.get(name, {}).items():
            found[:, joints.index(joint)] = column.factor * values[:, names.index(column.name)]
        return found

    return Samples(path.name, values[:, 0], signal(LINK), signal(MOTOR), signal(EFFORT), signal(TORQUE))


def _blocks(path: Path, names: list[str], delimiter: str) -> Iterator[Array]:
    """Yield the named columns (rows, columns) of a table block by block."""
    if path.name.endswith(PARQUET):
        file = pq.ParquetFile(path)
        _check_header(path, file.schema_arrow.names, names)
        batches: Iterator[pa.RecordBatch] = file.iter_batches(columns=names, batch_size=2**16)
    else:
        skipped, header = header_of(path, delimiter)
        _check_header(path, header, names)
        batches = pa_csv.open_csv(
            pa.input_stream(str(path), compression="detect"),
            pa_csv.ReadOptions(block_size=BLOCK, skip_rows=skipped + 1, column_names=header),
            pa_csv.ParseOptions(delimiter=delimiter),
            pa_csv.ConvertOptions(include_columns=names, column_types=dict.fromkeys(names, pa.float64())),
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
