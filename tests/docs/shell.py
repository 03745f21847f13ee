# SPDX-License-Identifier: Apache-2.0
"""Blocks of shell commands: which run for real, and, in one place, which do not and why."""

from __future__ import annotations

import re
import shlex
import subprocess
from collections.abc import Iterator

from fjr_bringup.cli.exit_codes import Exit

SHORT = "0.5"  # s of stamped time for commands that record

NOT_RUN = {
    "make": "sets up a whole checkout; `make test` would run this very test",
    "ros2": "ROS's command line is not among the wheels",
    "source": "the set-up of a ROS 2 installation, or of a build next to one",
    "colcon": "needs a ROS 2 installation",
    "rosdep": "needs a ROS 2 installation, root and a network",
    "pip": "needs a network",
    "cd": "only leads to commands that do not run",
    ".venv/bin/python": "takes minutes and writes into docs/",
    "python": "takes minutes and writes into docs/",
}
"""First words of commands that no test runs; test_names.py checks the names in them."""


def commands(text: str) -> Iterator[str]:
    """The commands of a block, one each, without comments."""
    for line in text.replace("\\\n", " ").splitlines():
        for command in line.split(" && "):
            if shlex.split(command, comments=True):
                yield command.strip()


def words(command: str) -> list[str]:
    """The words of a command; a substitution `$(...)` is one."""
    kept: list[str] = []

    def keep(found: re.Match[str]) -> str:
        kept.append(found[0])
        return f"@{len(kept) - 1}@"

    split = shlex.split(re.sub(r"\$\([^)]*\)", keep, command), comments=True)
    return [re.sub(r"@(\d+)@", lambda found: kept[int(found[1])], word) for word in split]


def is_run(command: str) -> bool:
    """Whether a command is done for real."""
    return words(command)[0] not in NOT_RUN


def script(text: str) -> str:
    """What is run of a block: the commands in their order, recordings short."""
    return "\n".join(["set -e", *(_shortened(command) for command in commands(text) if is_run(command))])


def _shortened(command: str) -> str:
    """A recording made short. It may end with the verdict `violated`: in real time that depends on the machine."""
    parts = words(command)
    if parts[:2] not in (["fjr", "run"], ["fjr", "demo"]) or parts[-1] == "&":
        return command
    short = command if "--duration" in parts else shlex.join([*parts, "--duration", SHORT])
    return f"{short.partition(' #')[0]} || [ $? -eq {Exit.VIOLATED:d} ]"


def syntax_error(text: str) -> str:
    """What bash finds wrong with a text, empty where nothing is."""
    return subprocess.run(["bash", "-n"], input=text, capture_output=True, text=True, check=False).stderr
