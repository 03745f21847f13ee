# SPDX-License-Identifier: Apache-2.0
"""Folder of a tuning study: every finished part of a candidate is kept, so that a search goes on where it ended.

tuning.json          specification of the study and hash of the program
evaluations.jsonl    a line for each finished part: point, runs, figures
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

import numpy as np

from fjr_design.experiments.tuning.candidates import Point, TuningStudy
from fjr_design.experiments.tuning.goal import Figures
from fjr_design.studies.study_folder import check_description, locked

DESCRIPTION, EVALUATIONS = "tuning.json", "evaluations.jsonl"
Part = tuple[Point, int, int]


@dataclass
class TuningStore:
    """Finished parts by (point, begin, end) of their runs; create it by `open_store`."""

    folder: Path
    study: TuningStudy
    file: IO[str]
    parts: dict[Part, Figures] = field(default_factory=dict)

    def keep(self, part: Part, figures: Figures) -> None:
        """Add a part and write it to the file."""
        point, begin, end = part
        plain = {name: values.tolist() for name, values in figures.items()}
        line = json.dumps({"point": point, "begin": begin, "end": end, "figures": plain})
        self.file.write(line + "\n")
        self.file.flush()
        self.parts[part] = figures


@contextmanager
def open_store(folder: Path, study: TuningStudy, program: str) -> Iterator[TuningStore]:
    """Open or create the store of a study, locked for this process; program: see check_description.

    Raise StoreError.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / EVALUATIONS
    with locked(folder):
        check_description(folder / DESCRIPTION, json.loads(study.text), program, path.exists(), "fjr tune")
        parts, whole = _read(path)
        with path.open("a", encoding="utf-8") as file:
            file.truncate(whole)
            yield TuningStore(folder, study, file, parts)


def _read(path: Path) -> tuple[dict[Part, Figures], int]:
    """Return the finished parts and the length of their lines [bytes]; a line cut off by a crash ends them."""
    found: dict[Part, Figures] = {}
    length = 0
    for line in path.read_bytes().splitlines(keepends=True) if path.exists() else ():
        try:
            values = json.loads(line)
            part = tuple(values["point"]), values["begin"], values["end"]
            figures = {name: np.array(each) for name, each in values["figures"].items()}
        except (ValueError, KeyError, TypeError):
            break
        if not line.endswith(b"\n"):
            break
        found[part] = figures
        length += len(line)
    return found, length
