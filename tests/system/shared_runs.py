# SPDX-License-Identifier: Apache-2.0
"""Runs of installed scenarios in lock-step that several test files read: recorded once for all test processes."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

import pytest

from system.recorded import complete_run

DURATION = {"paper_k31": 2.5, "paper_k3p1": 2.5, "two_link": 3.2, "arm7": 3.2}  # s


def shared_run(factory: pytest.TempPathFactory, name: str) -> Path:
    """Return the folder of a run of DURATION seconds, to be read only; `said` next to it holds the output of `fjr`.

    The recorder heard every message: one that gets no core for long may miss some, and reports it.
    """
    base = factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / f"shared_{name}"
    folder.mkdir(exist_ok=True)
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "finished").exists():
            said = complete_run(name, DURATION[name], folder / "runs")
            (folder / "runs" / "said").write_text(said)
            (folder / "finished").symlink_to(folder / "runs")
    return folder / "finished" / name
