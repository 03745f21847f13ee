# SPDX-License-Identifier: Apache-2.0
"""Origin of a page or report: date, version and command line of the command that wrote it, and the machine."""

from __future__ import annotations

import os
import platform
import re
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from fjr_core.version import __version__

EPOCH = "SOURCE_DATE_EPOCH"  # environment variable; seconds since 1970 that replace the clock (reproducible-builds.org)
MODELS = ("model name", "Model")  # lines of /proc/cpuinfo on x86 and on ARM


@dataclass(frozen=True)
class Provenance:
    """Date in UTC, version of fjr, command line, machine; without names of users and hosts."""

    date: str
    version: str
    command: str
    machine: str

    @staticmethod
    def read(values: Mapping[str, Any] | None) -> Provenance | None:
        """Return the provenance in a report.json; None if it holds none."""
        texts = {each.name: (values or {}).get(each.name) for each in fields(Provenance)}
        return Provenance(**{name: str(text) for name, text in texts.items()}) if all(texts.values()) else None


def _now() -> datetime:
    """Return the time of EPOCH; the present one if that is not set or no date."""
    try:
        return datetime.fromtimestamp(int(os.environ[EPOCH]), timezone.utc)
    except (KeyError, ValueError, OverflowError, OSError):
        return datetime.now(timezone.utc)


_command: tuple[Sequence[str], datetime] = [Path(sys.argv[0]).name, *sys.argv[1:]], _now()
"""Arguments and begin of the command that this process carries out."""


def begin_command(arguments: Sequence[str]) -> None:
    """Store command line and time for `provenance`; arguments: the program's name first."""
    global _command
    _command = list(arguments), _now()


def provenance() -> Provenance:
    """Return the origin of what the present command writes; the date is that of its start."""
    arguments, begin = _command
    date = begin.strftime("%Y-%m-%d %H:%M UTC")
    return Provenance(date, f"fjr {__version__}", without_home(shlex.join(arguments)), machine())


def without_home(text: str) -> str:
    """Return the text with ~ for the home folder, whose path contains the user's name."""
    home = os.path.expanduser("~")
    return re.sub(rf"{re.escape(home)}(?![\w.-])", "~", text) if len(home) > 1 else text


def machine() -> str:
    """Return processor model, number of usable cores, kernel and Python version."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    kernel = f"{platform.system()} {platform.release()}"
    return f"{_processor()}, {cores} {'core' if cores == 1 else 'cores'}, {kernel}, Python {platform.python_version()}"


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    named = (line.partition(":")[::2] for line in lines)
    return next((model.strip() for name, model in named if name.strip() in MODELS), platform.machine())
