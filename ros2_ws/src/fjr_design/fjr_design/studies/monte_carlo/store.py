# SPDX-License-Identifier: Apache-2.0
"""Folder of a Monte-Carlo study: finished parts as Parquet files, written atomically, finally merged into one table.

campaign.json      specification of the study and hash of the program
parts/             <begin>-<end>.parquet of finished parts
table.parquet      all runs in order, once all parts are finished
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from fjr_core.files.text_file import is_sealed, whole_file
from fjr_design.experiments.monte_carlo.sweep import Columns, Sweep
from fjr_design.studies.study_folder import StoreError, check_description, locked

LARGEST_PART, SMALLEST_PART, PARTS = 1000, 10, 200


@dataclass(frozen=True)
class Store:
    """Folder of a study; create it by `open_store`."""

    folder: Path
    sweep: Sweep

    @property
    def table(self) -> Path:
        """Path of the table of all runs."""
        return self.folder / "table.parquet"

    def missing(self) -> Iterator[tuple[int, int]]:
        """Yield the missing parts (begin, end) in order."""
        all_parts = [] if self.table.exists() else parts(self.sweep.runs)
        return (part for part in all_parts if not is_sealed(self._file(*part)))

    def finished(self) -> int:
        """Return the number of finished runs."""
        if self.table.exists():
            return self.sweep.runs
        return sum(end - begin for begin, end in parts(self.sweep.runs) if is_sealed(self._file(begin, end)))

    def keep(self, begin: int, end: int, columns: Columns) -> None:
        """Write a part atomically."""
        path = self._file(begin, end)
        with whole_file(path, sealed=True) as scratch:
            pq.write_table(pa.table(columns), scratch, compression="zstd")

    def complete(self) -> Path:
        """Merge all parts into one table and remove them; return its path."""
        if not self.table.exists():
            files = [self._file(*part) for part in parts(self.sweep.runs)]
            with (
                whole_file(self.table, sealed=True) as scratch,
                pq.ParquetWriter(scratch, pq.read_schema(files[0]), compression="zstd") as writer,
            ):
                for file in files:
                    writer.write_table(pq.read_table(file))
        for file in self._parts.glob("*"):
            file.unlink()
        return self.table

    def column(self, name: str) -> NDArray[Any]:
        """Return a column of the table (runs,)."""
        return np.asarray(pq.read_table(self.table, columns=[name]).column(0).to_numpy())

    @property
    def _parts(self) -> Path:
        return self.folder / "parts"

    def _file(self, begin: int, end: int) -> Path:
        return self._parts / f"{begin:09d}-{end:09d}.parquet"


@contextmanager
def open_store(folder: Path, sweep: Sweep, program: str) -> Iterator[Store]:
    """Open or create the store of a study, locked for this process.

    program: hash of the code that computes the results. Raise StoreError.
    """
    (folder / "parts").mkdir(parents=True, exist_ok=True)
    with locked(folder):
        _check(folder, sweep, program)
        for left in folder.rglob("*.part"):
            left.unlink()
        _check_table(folder / "table.parquet")
        yield Store(folder, sweep)


def parts(runs: int) -> list[tuple[int, int]]:
    """Return (begin, end) of the parts into which a study is divided."""
    size = min(LARGEST_PART, max(SMALLEST_PART, runs // PARTS))
    return [(begin, min(begin + size, runs)) for begin in range(0, runs, size)]


def _check(folder: Path, sweep: Sweep, program: str) -> None:
    """Write campaign.json, or check that it describes this study; raise StoreError."""
    runs = any(folder.glob("*.parquet")) or any(folder.glob("parts/*.parquet"))
    check_description(folder / "campaign.json", json.loads(sweep.text), program, runs, "fjr sweep")


def _check_table(table: Path) -> None:
    """Raise StoreError if the table was changed."""
    if table.exists() and not is_sealed(table):
        raise StoreError(
            f"{table} is not what `fjr sweep` wrote (its SHA-256 digest differs); expected it unchanged, or "
            "removed to compute it again"
        )
