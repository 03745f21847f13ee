# SPDX-License-Identifier: Apache-2.0
"""The folder of a campaign: finished parts as Parquet files, each whole or not there; at the end one table of all.

campaign.json      the campaign and the program that runs it
parts/             <begin>-<end>.parquet while it goes on
table.parquet      all runs in their order, once all parts are there
"""

from __future__ import annotations

import fcntl
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

from fjr_bringup.atomic_file import is_sealed, whole_file, write_text
from fjr_core.errors import FjrError
from fjr_core.experiments.monte_carlo.sweep import Columns, Sweep
from fjr_core.files.text_file import read_json

LARGEST_PART, SMALLEST_PART, PARTS = 1000, 10, 200


class StoreError(FjrError):
    """A folder that holds another campaign, or one that is being filled."""


@dataclass(frozen=True)
class Store:
    """A campaign's folder; `open_store` makes one."""

    folder: Path
    sweep: Sweep

    @property
    def table(self) -> Path:
        """Where the table of all runs is, once it is complete."""
        return self.folder / "table.parquet"

    def missing(self) -> Iterator[tuple[int, int]]:
        """The parts (begin, end) that are not there, in their order."""
        all_parts = [] if self.table.exists() else parts(self.sweep.runs)
        return (part for part in all_parts if not is_sealed(self._file(*part)))

    def finished(self) -> int:
        """How many runs are there."""
        if self.table.exists():
            return self.sweep.runs
        return sum(end - begin for begin, end in parts(self.sweep.runs) if is_sealed(self._file(begin, end)))

    def keep(self, begin: int, end: int, columns: Columns) -> None:
        """Write a part: after a kill it is there whole or not at all."""
        path = self._file(begin, end)
        with whole_file(path, sealed=True) as scratch:
            pq.write_table(pa.table(columns), scratch, compression="zstd")

    def complete(self) -> Path:
        """Make the one table of all parts, part by part, and remove them."""
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
        """One column of the table (runs,)."""
        return np.asarray(pq.read_table(self.table, columns=[name]).column(0).to_numpy())

    @property
    def _parts(self) -> Path:
        return self.folder / "parts"

    def _file(self, begin: int, end: int) -> Path:
        return self._parts / f"{begin:09d}-{end:09d}.parquet"


@contextmanager
def open_store(folder: Path, sweep: Sweep, program: str) -> Iterator[Store]:
    """The store of a campaign, new or taken up again, for this process alone.

    program: what tells apart results of different code. Raises StoreError.
    """
    (folder / "parts").mkdir(parents=True, exist_ok=True)
    with (folder / ".lock").open("a") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise StoreError(f"{folder} is being filled by another process; expected one at a time") from None
        _check(folder, sweep, program)
        for left in folder.rglob("*.part"):
            left.unlink()
        _check_table(folder / "table.parquet")
        yield Store(folder, sweep)


def parts(runs: int) -> list[tuple[int, int]]:
    """Begin and end of the parts that a campaign of so many runs is done in."""
    size = min(LARGEST_PART, max(SMALLEST_PART, runs // PARTS))
    return [(begin, min(begin + size, runs)) for begin in range(0, runs, size)]


def _check(folder: Path, sweep: Sweep, program: str) -> None:
    """Write what the folder holds, or see that it is that."""
    path = folder / "campaign.json"
    wanted = {**json.loads(sweep.text), "program": program}
    try:
        found = read_json(path)
    except FileNotFoundError:
        if any(folder.glob("*.parquet")) or any(folder.glob("parts/*.parquet")):
            raise StoreError(
                f"{folder} holds runs, but no campaign.json that says of what; expected both, or another --output"
            ) from None
        write_text(path, json.dumps(wanted, indent=1))
        return
    except ValueError:
        raise StoreError(f"{path} cannot be read; expected what `fjr sweep` wrote there") from None
    different = [name for name in wanted if name != "program" and found.get(name) != wanted[name]]
    if different:
        said = ", ".join(_said(name, found.get(name), wanted[name]) for name in different)
        raise StoreError(f"{folder} holds another campaign ({said}); expected the same one, or another --output")
    if found.get("program") != program:
        raise StoreError(
            f"{folder} was begun by another version of this program (source, CasADi, with or without a C compiler); "
            "expected the same, or another --output"
        )


def _check_table(table: Path) -> None:
    """Raise StoreError for a table that is not as it was written."""
    if table.exists() and not is_sealed(table):
        raise StoreError(
            f"{table} is not what `fjr sweep` wrote there (its SHA-256 digest differs); expected it unchanged, or "
            "removed, then it is computed again"
        )


def _said(name: str, there: object, here: object) -> str:
    if isinstance(there, (int, float)) and isinstance(here, (int, float)):
        return f"{name} is {there:g}, not {here:g}"
    if isinstance(there, dict) and isinstance(here, dict):
        return f"{name} differs in {', '.join(sorted(k for k in {*there, *here} if there.get(k) != here.get(k)))}"
    return f"{name} differs"
