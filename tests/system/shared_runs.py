# SPDX-License-Identifier: Apache-2.0
"""Runs of scenarios in lock-step by `fjr`, recorded once if several test files read them, and a reader of their bags.

The reader does not use that of the report.
"""

from __future__ import annotations

import fcntl
import json
import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from nodes.harness import nanoseconds
from system.bags import STORE
from system.executables import fjr_here, sets

DURATION = {"paper_k31": 3.0, "paper_k3p1": 2.5, "two_link": 3.2, "arm7": 3.2}  # s; of paper_k31 that of the tutorial


def shared_run(factory: pytest.TempPathFactory, name: str) -> Path:
    """Return the folder of a run of DURATION seconds, to be read only; `said` next to it holds the output of `fjr`."""
    base = factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / f"shared_{name}"
    folder.mkdir(exist_ok=True)
    with (folder / "lock").open("w") as lock, pytest.MonkeyPatch.context() as without_pictures:
        without_pictures.setitem(sys.modules, "matplotlib", None)
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "finished").exists():
            said = complete_run(name, DURATION[name], folder / "runs")
            (folder / "runs" / "said").write_text(said)
            (folder / "finished").symlink_to(folder / "runs")
    return folder / "finished" / name


@dataclass(frozen=True)
class Recorded:
    """k stamps of a run, n joints: t (k,) [s] from the first; q_l, q_ld, u (k, n)."""

    folder: Path
    said: str
    t: np.ndarray
    q_l: np.ndarray
    q_ld: np.ndarray
    u: np.ndarray

    @property
    def error(self) -> np.ndarray:
        """The largest error of all joints (k,) [rad]."""
        return np.abs(self.q_l - self.q_ld).max(axis=1)


def record(name: str, duration: float, output: Path, *overrides: str) -> Recorded:
    """Run a scenario in lock-step without a report and read its bag."""
    said = complete_run(name, duration, output, "--no-report", *sets(*overrides))
    return recorded_run(output / name, said)


def complete_run(name: str, duration: float, output: Path, *options: str) -> str:
    """Run a scenario in lock-step, of which the recorder misses no message; return what `fjr` says."""
    length = ("--duration", str(duration), "--output", str(output))
    said = fjr_here("run", name, "--lockstep", *length, *options)
    assert is_complete(output / name)
    return said


def is_complete(folder: Path) -> bool:
    """Whether the recorder of a run heard every message."""
    counts = json.loads((folder / "report.json").read_text())["counts"]
    return counts["missing"] == 0 and not any(counts["lost_by_recorder"].values())


def recorded_run(folder: Path, said: str) -> Recorded:
    """Read the bag of a run."""
    fields = {"/joint_states": "position", "/fjr_controller/reference": "position", "/joint_commands": "effort"}
    tables: dict[str, dict[int, np.ndarray]] = {topic: {} for topic in fields}
    for topic, message in messages(folder, *fields):  # of several with one stamp the first
        tables[topic].setdefault(nanoseconds(message), np.array(getattr(message, fields[topic])))
    stamps = sorted(set.intersection(*map(set, tables.values())))
    n = len(tables["/joint_commands"][stamps[0]])
    t = (np.array(stamps) - stamps[0]) * 1e-9
    return Recorded(folder, said, t, *(np.array([table[s][:n] for s in stamps]) for table in tables.values()))


def messages(folder: Path, *topics: str) -> Iterator[tuple[str, Any]]:
    """Yield topic and message, in order, of topics in the bag of a run; of all without names."""
    with AnyReader([folder / "bag"], default_typestore=STORE) as bag:
        wanted = [connection for connection in bag.connections if not topics or connection.topic in topics]
        for connection, _, raw in bag.messages(wanted):
            yield connection.topic, bag.deserialize(raw, connection.msgtype)
