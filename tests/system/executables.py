# SPDX-License-Identifier: Apache-2.0
"""Start the installed executables that `ros2 run` starts, each in its own session."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from io import StringIO
from pathlib import Path
from typing import IO, Any
from unittest import mock

from ament_index_python.packages import get_package_share_directory

from fjr_bringup.cli.app import main
from fjr_bringup.node_process import executable
from isolation import ROOT
from time_limits import HANG, Limit

TIME_LIMIT = 60.0  # s on an idle machine


class Executable:
    """A running executable; `end` returns its exit code and standard error."""

    def __init__(self, command: Sequence[str], **environment: str) -> None:
        """command: of `installed`, or any other; environment: variables that it has beside those of this process."""
        self._said: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 (closed in kill)
        self.process = subprocess.Popen(
            command, stdout=self._said, stderr=self._said, start_new_session=True, env={**os.environ, **environment}
        )

    def signal(self, number: int) -> None:
        self.process.send_signal(number)

    def recorder(self) -> int:
        """Return the process in which `fjr run` records, in a session of its own."""
        (found,) = children(self.process.pid).values()
        return found

    def said_so_far(self) -> str:
        return os.pread(self._said.fileno(), 1_000_000, 0).decode()  # leaves the position, which the child shares

    def end(self) -> tuple[int, str]:
        code = self.process.wait(timeout=HANG)
        self._said.seek(0)
        return code, self._said.read().decode()

    def kill(self) -> None:
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        self._said.close()


def children(pid: int) -> dict[str, int]:
    """Return the processes started by `pid`, by the name that ps shows."""
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            name = (folder / "comm").read_text().strip()
        except (OSError, IndexError):
            continue
        if parent == pid:
            found[name] = int(folder.name)
    return found


def is_alive(group: int) -> bool:
    """Return whether a process group has processes, so that its id cannot belong to another group yet."""
    with suppress(ProcessLookupError):
        os.killpg(group, 0)
        return True
    return False


def wait_for(condition: Callable[[], bool], what: str) -> None:
    limit = Limit(TIME_LIMIT)
    while not condition():
        assert not limit.passed(), f"{what} did not come within {TIME_LIMIT} s"
        time.sleep(0.002)


def fjr(*arguments: str, code: int = 0) -> str:
    """Run the `fjr` command to its end with an exit code; return its output."""
    done = subprocess.run(installed("fjr", *arguments), capture_output=True, text=True, timeout=HANG)
    assert done.returncode == code, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    return done.stdout + done.stderr


def fjr_here(*arguments: str, code: int = 0, codes: Collection[int] = ()) -> str:
    """Run `fjr` with `code` or one of `codes` in this process, which saves a second of imports; nodes are processes."""
    output, errors = StringIO(), StringIO()
    with mock.patch.dict(os.environ), redirect_stdout(output), redirect_stderr(errors):
        ended = main(arguments)
    assert ended in (codes or (code,)), output.getvalue() + errors.getvalue()
    return output.getvalue() + errors.getvalue()


def fjr_json(*arguments: str, code: int = 0) -> dict[str, Any]:
    """Return the document that `fjr` prints with --json; warnings may follow it."""
    found: dict[str, Any] = json.JSONDecoder().raw_decode(fjr_here(*arguments, "--json", code=code))[0]
    return found


def sets(*assignments: str) -> list[str]:
    """Return the options of `fjr` that set parameters, as NAME:=VALUE."""
    return [part for assignment in assignments for part in ("--set", assignment)]


def python_here(text: str, file: Path) -> str:
    """Run a Python program in this process, which saves its imports; return its output. file: where it stands."""
    output = StringIO()
    with mock.patch.dict(os.environ), redirect_stdout(output), redirect_stderr(output):
        exec(compile(text, str(file), "exec"), {"__name__": "__main__", "__file__": str(file)})
    return output.getvalue()


def scenario(name: str) -> str:
    return str(Path(get_package_share_directory("fjr_bringup")) / "scenarios" / f"{name}.yaml")


NODES = {"plant": ("fjr_plant", "plant_node"), "controller": ("fjr_controller", "controller_node")}
PROGRAMS = {**NODES, "fjr": ("fjr_bringup", "fjr")}


def installed(program: str, *arguments: str) -> list[str]:
    """Return the command that starts a program of PROGRAMS."""
    return [str(executable(*PROGRAMS[program])), *arguments]


Start = Callable[..., Executable]
"""The fixture `start`: start a program of PROGRAMS with arguments; what runs at the end of the test is killed."""
SLOW = {"plant": ("-p", "publish_rate:=200.0"), "controller": ("-p", "state_timeout:=600.0")}
"""Real time at 200 Hz, for little processor time; a controller that gets no core for long goes on all the same."""


@contextmanager
def running(parameters: Mapping[str, Sequence[str]], *more: str) -> Iterator[dict[str, Executable]]:
    """Run plant and controller with ROS arguments of each and `more` of both."""
    started = {node: Executable(installed(node, "--ros-args", *parameters[node], *more)) for node in NODES}
    try:
        yield started
    finally:
        for each in started.values():
            each.kill()


# The keys of the JSON that each command prints, as docs/tables/json.md lists them.

ROW = re.compile(r"^\| (`fjr [^|]*) \| ([^|]*) \|$", re.MULTILINE)
OPTIONAL = re.compile(r"; with [^;]*")
CODE = re.compile(r"`([^`]*)`")


def documented_keys() -> dict[str, set[str]]:
    """Return the keys in the second column of the table by command, without those of an option ("; with ...;")."""
    page = (ROOT / "docs" / "tables" / "json.md").read_text(encoding="utf-8")
    section = page.partition("## Results of commands\n")[2].partition("\n## ")[0]
    rows = {names: set(CODE.findall(OPTIONAL.sub("", keys))) for names, keys in ROW.findall(section)}
    return {name.removeprefix("fjr "): keys for names, keys in rows.items() for name in CODE.findall(names)}
