# SPDX-License-Identifier: Apache-2.0
"""Runs of installed scenarios in lock-step that several test files read: recorded once for all test processes."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

import pytest

from system.executables import fjr_here
from system.recorded import TRIES, is_complete

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
            (folder / "finished").symlink_to(_recorded(folder, name))
    return folder / "finished" / name


def _recorded(folder: Path, name: str) -> Path:
    """Record until no message is missing; return the output folder."""
    for number in range(TRIES):
        output = folder / str(number)
        said = fjr_here("run", name, "--lockstep", "--duration", str(DURATION[name]), "--output", str(output))
        (output / "said").write_text(said)
        if is_complete(output / name):
            break
    return output
