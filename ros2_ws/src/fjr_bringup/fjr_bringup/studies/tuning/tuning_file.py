# SPDX-License-Identifier: Apache-2.0
"""The section `tune` of a sweep file: what `fjr tune` minimises, its constraints, and the size of the search."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from typing import Any

from fjr_bringup.studies.monte_carlo.sweep_file import TUNE
from fjr_core.errors import ParameterError
from fjr_core.experiments.monte_carlo.sweep import Sweep
from fjr_core.experiments.tuning.candidates import TuningStudy
from fjr_core.experiments.tuning.goal import Goal

NUMBERS = ("draws", "candidates", "fresh")
GOAL = ("minimise", "quantile", "success", "limits", "delay_margin")
LAW = "law"
KEYS = (LAW, *GOAL, *NUMBERS)


def read(sweep: Sweep, section: Mapping[str, Any], numbers: Mapping[str, int]) -> TuningStudy:
    """Return the study of the section `tune` of a sweep file; numbers: replace its own. Raise ParameterError."""
    for key in section:
        if key not in KEYS:
            close = difflib.get_close_matches(str(key), KEYS, n=1)
            hint = f"did you mean '{close[0]}'?" if close else f"expected some of {', '.join(KEYS)}"
            raise ParameterError(f"'tune' has '{key}'; {hint}")
    goal: dict[str, Any] = {}
    for key in GOAL:
        if key in section:
            given = section[key]
            goal[key] = _mapping(key, given) if key in ("minimise", "limits") else _number(key, given)
    size = {key: _whole(key, section[key]) for key in NUMBERS if key in section} | dict(numbers)
    return TuningStudy(sweep, Goal(**goal), **size)


def law_of(document: object) -> str | None:
    """Return the law that the section of a parsed file names, None if none; raise ParameterError."""
    section = document.get(TUNE) if isinstance(document, Mapping) else None
    name = section.get(LAW) if isinstance(section, Mapping) else None
    if name is not None and not isinstance(name, str):
        raise ParameterError(f"'tune' has {name!r} as '{LAW}'; expected the name of a law")
    return name


def _mapping(key: str, given: object) -> dict[str, float]:
    if not isinstance(given, Mapping):
        raise ParameterError(f"'tune' has {given!r} as '{key}'; expected figures and numbers, e.g. {{rms: 1.0}}")
    return {str(name): _number(f"{key}.{name}", value) for name, value in given.items()}


def _number(key: str, given: object) -> float:
    if isinstance(given, bool) or not isinstance(given, (int, float)):
        raise ParameterError(f"'tune' has {given!r} as '{key}'; expected a number")
    return float(given)


def _whole(key: str, given: object) -> int:
    number = _number(key, given)
    if not number.is_integer():
        raise ParameterError(f"'tune' has {given!r} as '{key}'; expected a whole number")
    return int(number)
