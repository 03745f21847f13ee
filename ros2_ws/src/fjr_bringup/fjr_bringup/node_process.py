# SPDX-License-Identifier: Apache-2.0
"""Start nodes as processes, by the executables that `ros2 run` starts; no node outlives the command."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_prefix

from fjr_core.errors import FjrError
from fjr_msgs_py.console.ros2 import INSTALLATION
from fjr_msgs_py.node.loading import signals_blocked

LAST_LINES = 8  # of a log
SCHEDULING = re.compile(r"(real-time priority \d+ is granted|ordinary scheduling ).*")
GRACE = 20.0  # s from SIGINT to SIGKILL; imports alone take seconds on a busy machine

# Runs in the child before the node: the kernel sends SIGTERM to the node when `fjr` dies, however it dies.
_FOLLOW_PARENT = """
import ctypes, os, sys
PR_SET_PDEATHSIG, SIGTERM = 1, 15
ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, SIGTERM)
if os.getppid() != int(sys.argv[1]):
    sys.exit(1)
os.execv(sys.argv[2], sys.argv[2:])
"""


class NodeError(FjrError):
    """A node could not be started, or ended unexpectedly."""


def executable(package: str, name: str) -> Path:
    """Return the file that `ros2 run package name` starts; raises NodeError if it is not built or sourced."""
    try:
        path = Path(get_package_prefix(package), "lib", package, name)
    except (PackageNotFoundError, OSError):  # OSError: no workspace is sourced
        path = Path()
    if not path.is_file():
        raise NodeError(f"executable {name} of package {package} is not installed; {INSTALLATION}")
    return path


class StartedNode:
    """One node in its own session, with its output in a log file. Create it in the main thread only."""

    def __init__(self, package: str, name: str, ros_arguments: Sequence[str], log: Path) -> None:
        self.name = name
        self.log = log
        command = [str(executable(package, name)), "--ros-args", *ros_arguments]
        if sys.platform == "linux":
            command = [sys.executable, "-I", "-S", "-c", _FOLLOW_PARENT, str(os.getpid()), *command]
        with open(log, "wb") as stream, signals_blocked():  # the node unblocks them once it has its handlers
            self._process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=stream, stderr=stream, start_new_session=True
            )

    def check(self) -> None:
        """Raise NodeError with the end of the node's log if the node has ended."""
        if (code := self._process.poll()) is not None:
            how = f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
            raise NodeError(f"{self.name} {how}. Its last lines:\n{self.last_lines()}")

    def last_lines(self) -> str:
        """Return the last lines of the node's log, indented."""
        lines = self.log.read_text(encoding="utf-8", errors="replace").splitlines()[-LAST_LINES:]
        return "\n".join(f"    {line}" for line in lines) or "    (nothing)"

    def scheduling(self) -> str:
        """Return what the node logged about its scheduling, "" if nothing."""
        found = SCHEDULING.search(self.log.read_text(encoding="utf-8", errors="replace"))
        return found.group(0) if found else ""

    def stop(self) -> int:
        """Send SIGINT, wait up to GRACE, kill the process group; return the exit code."""
        self._process.send_signal(signal.SIGINT)  # without effect if it has ended
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(GRACE)
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        return self._process.wait()
