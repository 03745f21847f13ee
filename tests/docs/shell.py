# SPDX-License-Identifier: Apache-2.0
"""Run shell blocks; NOT_RUN lists the commands that are not run, with the reason."""

from __future__ import annotations

import re
import shlex
import subprocess
from collections.abc import Iterator

from fjr_msgs_py.console.ending import Exit

RECORDING = ("run", "demo")
SHORT = "0.2"  # s of stamped time for recording commands
SMALLER = {
    "compare": ("--cores", "1"),  # it imports everything again in a process for each core
    "tune": ("--candidates", "6", "--draws", "4", "--fresh", "8"),
}
"""Options with which a command does the same sooner, unless it has the first of them."""
JUDGED = (Exit.VIOLATED, Exit.LATE)  # with which a recording command may end, depending on the machine
SHELL = re.compile(r"[|&<>$*?~`]")  # what a shell replaces or interprets

NOT_RUN = {
    "make": "sets up a whole checkout; `make test` would run this test again",
    "ros2": "the ROS command line is not among the wheels",
    "source": "needs a ROS 2 installation, or a build next to one",
    ".": "is done before the tests run",
    "colcon": "needs a ROS 2 installation",
    "rosdep": "needs a ROS 2 installation, root and a network",
    "pip": "needs a network",
    "cd": "precedes commands that are not run",
    ".venv/bin/python": "takes minutes and writes into docs/",
    "python": "takes minutes and writes into docs/",
    "fjr call": "needs a running node",
    "fjr set": "needs a running node",
    "fjr lifecycle": "needs a running node",
}
"""First words of commands that no test runs; test_names.py checks the names in them."""


def commands(text: str) -> Iterator[str]:
    """Yield the commands of a block without comments."""
    for line in text.replace("\\\n", " ").splitlines():
        for command in line.split(" && "):
            if shlex.split(command, comments=True):
                yield command.strip()


def words(command: str) -> list[str]:
    """Return the words of a command; a substitution `$(...)` is one word."""
    kept: list[str] = []

    def keep(found: re.Match[str]) -> str:
        kept.append(found[0])
        return f"@{len(kept) - 1}@"

    split = shlex.split(re.sub(r"\$\([^)]*\)", keep, command), comments=True)
    return [re.sub(r"@(\d+)@", lambda found: kept[int(found[1])], word) for word in split]


def program(command: str) -> str:
    """Return the first word of a command, or the first two if NOT_RUN has them."""
    first, *rest = words(command)
    return " ".join([first, *rest[:1]]) if f"{first} {rest[0] if rest else ''}" in NOT_RUN else first


def is_run(command: str) -> bool:
    """Return whether a command is run; with --force also one that needs a node, which the page has started."""
    return program(command) not in NOT_RUN or words(command)[-1] == "--force"


def script(text: str) -> str:
    """Return the commands of a block that are run, in order, with short recordings."""
    return "\n".join(["set -e", *(_shortened(command) for command in commands(text) if is_run(command))])


def only_fjr(text: str) -> list[list[str]]:
    """Return the arguments of `fjr` in the commands of a block that are run; none if any needs a shell."""
    found = [words(command) for command in commands(text) if is_run(command)]
    if any(command[0] != "fjr" or SHELL.search("".join(command)) for command in found):
        return []
    return [[*command[1:], *_shorter(command)] for command in found]


def exit_codes(arguments: list[str], expected: int) -> tuple[int, ...]:
    """Return the exit codes that `fjr` may have."""
    return (expected, *JUDGED) if arguments[0] in RECORDING and not expected else (expected,)


def _shortened(command: str) -> str:
    """Return a recording command with a short duration, which may end with any code of JUDGED."""
    parts = words(command)
    if parts[0] != "fjr" or parts[1] not in RECORDING or parts[-1] == "&":
        return command
    short = shlex.join([*parts, *_shorter(parts)]) if _shorter(parts) else command
    judged = " | ".join(str(int(code)) for code in JUDGED)
    return f"{short.partition(' #')[0]} || case $? in {judged}) ;; *) exit 1 ;; esac"


def _shorter(command: list[str]) -> list[str]:
    """Return options that spare time: those of SMALLER, or a short recording without a page of so short a run."""
    if command[1] in SMALLER:
        options = SMALLER[command[1]]
        return [] if options[0] in command else [*options]
    if command[1] not in RECORDING or "--duration" in command:
        return []
    return ["--duration", SHORT, *(["--no-report"] if command[1] == "run" and "--no-report" not in command else [])]


def syntax_error(text: str) -> str:
    """Return the syntax error that bash reports for a text, or an empty string."""
    return subprocess.run(["bash", "-n"], input=text, capture_output=True, text=True, check=False).stderr
