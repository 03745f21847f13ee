# SPDX-License-Identifier: Apache-2.0
"""The section `tune` of a sweep file: what `fjr tune` minimises, its constraints, and the size of the search."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fjr_core.errors import ParameterError
from fjr_design.experiments.monte_carlo.sweep import Sweep
from fjr_design.experiments.tuning.candidates import TuningStudy
from fjr_design.experiments.tuning.goal import Goal
from fjr_design.studies.monte_carlo.sweep_file import TUNE, check_keys, number, whole

NUMBERS = ("draws", "candidates", "fresh")
GOAL = ("minimise", "quantile", "success", "limits", "delay_margin")
LAW = "law"
KEYS = (LAW, *GOAL, *NUMBERS)
HERE = f"'{TUNE}' "  # start of a message


def read(sweep: Sweep, section: Mapping[str, Any], numbers: Mapping[str, int]) -> TuningStudy:
    """Return the study of the section `tune` of a sweep file; numbers: replace its own. Raise ParameterError."""
    check_keys(section, KEYS, HERE)
    goal: dict[str, Any] = {}
    for key in GOAL:
        if key in section:
            given = section[key]
            goal[key] = _mapping(key, given) if key in ("minimise", "limits") else number(key, given, HERE)
    size: dict[str, Any] = {key: whole(key, section[key], HERE) for key in NUMBERS if key in section} | dict(numbers)
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
    return {str(name): number(f"{key}.{name}", value, HERE) for name, value in given.items()}
