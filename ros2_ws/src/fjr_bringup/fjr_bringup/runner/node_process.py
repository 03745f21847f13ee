# SPDX-License-Identifier: Apache-2.0
"""The nodes as processes: the very executables `ros2 run` starts, none of which outlives the command."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_prefix

from fjr_core.errors import FjrError
from fjr_msgs_py.node.loading import signals_blocked

GRACE = 20.0  # s between asking a node to end and killing it; imports alone take seconds on a busy machine

# Runs in the child before the node: the kernel ends the node when `fjr` dies in whatever way.
_FOLLOW_PARENT = """
import ctypes, os, sys
PR_SET_PDEATHSIG, SIGTERM = 1, 15
ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, SIGTERM)
if os.getppid() != int(sys.argv[1]):
    sys.exit(1)
os.execv(sys.argv[2], sys.argv[2:])
"""


class NodeError(FjrError):
    """A node that cannot be started or that ended by itself."""


def executable(package: str, name: str) -> Path:
    """What `ros2 run package name` starts; raises NodeError when the workspace is not sourced or built."""
    try:
        path = Path(get_package_prefix(package), "lib", package, name)
    except (PackageNotFoundError, OSError):  # OSError: no workspace is sourced at all
        path = Path()
    if not path.is_file():
        raise NodeError(
            f"executable {name} of package {package} is not installed: build with `colcon build` in ros2_ws, "
            "then `. ros2_ws/install/setup.sh`"
        )
    return path


class NodeProcess:
    """One node in its own session, its output in a log file. Start it from the main thread only."""

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

    @property
    def running(self) -> bool:
        """Whether the process still runs."""
        return self._process.poll() is None

    def check(self) -> None:
        """Raise NodeError with the node's last words when it has ended."""
        if not self.running:
            code = self._process.returncode
            how = f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
            raise NodeError(f"{self.name} {how}. Its last lines ({self.log}):\n{self.last_lines()}")

    def last_lines(self, count: int = 8) -> str:
        """The end of what the node wrote to stdout and stderr, indented."""
        lines = self.log.read_text(encoding="utf-8", errors="replace").splitlines()[-count:]
        return "\n".join(f"    {line}" for line in lines) or "    (nothing)"

    def stop(self, grace: float = GRACE) -> int:
        """Interrupt as Ctrl-C would, wait, then kill the process group; returns the exit code."""
        with suppress(ProcessLookupError):
            if self.running:
                self._process.send_signal(signal.SIGINT)
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(grace)
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        return self._process.wait()
