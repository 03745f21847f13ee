# SPDX-License-Identifier: Apache-2.0
"""Set the workspace up from nothing.

build, test, bench, docs: environment to run, test, measure or build the documents, and the colcon build
lint: environment to test, no build
check: show which Python and ROS 2 would be used; change nothing
"""

from __future__ import annotations

import argparse
import fcntl
import os
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from envsetup import machine
from envsetup.commands import PREFIX, SetupError, say
from envsetup.environment import Environment
from envsetup.workspace import Workspace

ROOT = Path(__file__).resolve().parents[2]
LEVELS = {"build": "run", "test": "test", "bench": "bench", "docs": "docs", "lint": "test", "check": ""}
"""Level of the environment (see environment.LEVELS) by target."""


def main(arguments: Sequence[str]) -> int:
    """Set up a target; return 0, or 1 with one sentence on stderr on failure."""
    raw = argparse.RawTextHelpFormatter
    parser = argparse.ArgumentParser(prog="setup_env.py", description=__doc__, formatter_class=raw)
    parser.add_argument("target", choices=LEVELS, metavar="|".join(LEVELS))
    target = parser.parse_args(arguments).target
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        sourced_ros = machine.uses_sourced_ros()
        if sourced_ros:
            enter_ros_interpreter()
        set_up(target, sourced_ros)
    except SetupError as error:
        print(f"{error.details}\n{PREFIX} {error}" if error.details else f"{PREFIX} {error}", file=sys.stderr)
        return 1
    except OSError as error:
        print(f"{PREFIX} {error}; expected a writable checkout and free space", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"\n{PREFIX} interrupted; run the same command again to continue.", file=sys.stderr)
        return 130
    return 0


def set_up(target: str, sourced_ros: bool) -> None:
    """Run the steps of a target, locked against other set-ups of this checkout."""
    environment = Environment(ROOT, sourced_ros)
    if target == "check":
        source = "the sourced one" if sourced_ros else "wheels"
        say(f"Python {sys.version.split()[0]} ({machine.base_interpreter()}), ROS 2 Jazzy: {source}")
        say(f"environment {environment.path}")
        return
    say(f"checking {environment.path.name}")
    with alone(ROOT / ".setup"):
        environment.ensure(LEVELS[target])
        if target != "lint":
            log, python = ROOT / ".setup" / "extras.log", environment.python
            if not machine.compiler(environment.env, python).ensure(log, environment.env):
                environment.add_compiler()
            for extra in machine.extras(target, python, sourced_ros):
                extra.ensure(log, environment.env)
            Workspace(environment).ensure()


def enter_ros_interpreter() -> None:
    """Continue in the Python of the sourced ROS 2 if it is another one."""
    python = machine.ros_interpreter()
    if python != machine.base_interpreter() and not os.environ.get("FJR_SETUP_ENTERED"):
        sys.stdout.flush()
        os.execvpe(python, [python, *sys.argv], {**os.environ, "FJR_SETUP_ENTERED": "1"})


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Hold the lock of the checkout, so that parallel `make` calls set up once."""
    folder.mkdir(exist_ok=True)
    (folder / ".gitignore").write_text("*\n", encoding="utf-8")
    with (folder / "lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say("waiting for another set-up of this checkout")
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield
