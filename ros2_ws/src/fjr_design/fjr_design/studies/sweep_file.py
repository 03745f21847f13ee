# SPDX-License-Identifier: Apache-2.0
"""YAML file of a sweep: scenario, drawn deviations, success criteria; with the command line, the sweep to run."""

from __future__ import annotations

import difflib
import os
import sys
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeGuard

from fjr_core.config import ros_yaml
from fjr_core.errors import ParameterError
from fjr_design.uncertainty import distributions
from fjr_design.uncertainty.distributions import Distribution
from fjr_design.uncertainty.posterior import read_identification
from fjr_msgs_py.scenarios import installed, library

from .study import Workers, cluster, threads
from .sweep import Sweep

WHOLE = ("runs", "seed")
SECONDS = ("duration", "settle_after", "band", "lost")
TUNE = "tune"  # what `fjr tune` does with the study; `fjr sweep` ignores it
MAPPINGS = ("vary", "success", "set", TUNE)
POSTERIOR = "posterior"
KEYS = ("scenario", POSTERIOR, *MAPPINGS, *WHOLE, *SECONDS)
RUNS = 1000


@dataclass(frozen=True)
class SweepFile:
    """scenario: name or path; vary: distributions; changes: of scenario parameters; numbers: other fields of Sweep.

    posterior: path of an identification.json from which plants are drawn, "" for none. tune: goal and numbers of a
    tuning study, not checked here.
    """

    scenario: str
    vary: Mapping[str, Distribution]
    changes: Mapping[str, Any] = field(default_factory=dict)
    success: Mapping[str, float] = field(default_factory=dict)
    numbers: Mapping[str, Any] = field(default_factory=dict)
    posterior: str = ""
    tune: Mapping[str, Any] = field(default_factory=dict)


def is_one(document: object) -> bool:
    """Return whether a YAML document is a sweep, not a scenario."""
    return isinstance(document, Mapping) and "scenario" in document and "/**" not in document


def read(document: Mapping[str, Any]) -> SweepFile:
    """Return the sweep of a parsed document; raise ParameterError."""
    check_keys(document, KEYS)
    for key in MAPPINGS:
        if not isinstance(document.get(key, {}), Mapping):
            raise ParameterError(f"has {document[key]!r} as '{key}'; expected a mapping")
    vary = {str(name): distributions.read(str(name), given) for name, given in document.get("vary", {}).items()}
    posterior = document.get(POSTERIOR, "")
    if not isinstance(posterior, str):
        raise ParameterError(f"has {posterior!r} as '{POSTERIOR}'; expected the path of an identification.json")
    if not posterior and not any(one.kind != distributions.FIXED for one in vary.values()):
        raise ParameterError(f"draws nothing; expected '{POSTERIOR}', or 'vary' with {distributions.FORM}")
    success = {name: number(f"success.{name}", value) for name, value in document.get("success", {}).items()}
    numbers: dict[str, Any] = {key: whole(key, document[key]) for key in WHOLE if key in document}
    numbers |= {key: number(key, document[key]) for key in SECONDS if key in document}
    return SweepFile(
        str(document["scenario"]), vary, document.get("set", {}), success, numbers, posterior, document.get(TUNE, {})
    )


def usual(scenario: str, sample_period: float) -> SweepFile:
    """Return the default distributions: typical deviations of a robot from its data sheet."""
    document = {
        "stiffness": {"uniform": [0.7, 1.3], "each_joint": True},
        "link_inertia": {"uniform": [0.8, 1.2]},
        "gravity": {"uniform": [0.9, 1.1]},
        "motor_inertia": {"uniform": [0.9, 1.1], "each_joint": True},
        "link_damping": {"log_uniform": [0.5, 2.0], "each_joint": True},
        "motor_damping": {"log_uniform": [0.5, 2.0], "each_joint": True},
        "delay": {"uniform": [0.0, sample_period]},
    }
    return SweepFile(scenario, {name: distributions.read(name, given) for name, given in document.items()})


def check_keys(given: Mapping[str, Any], keys: Sequence[str], where: str = "") -> None:
    """Raise ParameterError for an unknown key, with the one it resembles; where: section, as a start of the message."""
    for key in given:
        if key not in keys:
            close = difflib.get_close_matches(str(key), keys, n=1)
            hint = f"did you mean '{close[0]}'?" if close else f"expected some of {', '.join(keys)}"
            raise ParameterError(f"{where}has '{key}'; {hint}")


def whole(name: str, value: object, where: str = "") -> int:
    """Return a whole number of the file; raise ParameterError for anything else."""
    if not _is_finite(value) or value != int(value):
        raise ParameterError(f"{where}has {value!r} as '{name}'; expected a whole number")
    return int(value)


def number(name: str, value: object, where: str = "") -> float:
    """Return a finite number of the file; raise ParameterError for anything else."""
    if not _is_finite(value):
        raise ParameterError(f"{where}has {value!r} as '{name}'; expected a number")
    return float(value)


def _is_finite(value: object) -> TypeGuard[int | float]:
    """Return whether a value is a number that is finite as a double."""
    return not isinstance(value, bool) and isinstance(value, (int, float)) and abs(value) <= sys.float_info.max


@dataclass(frozen=True)
class Options:
    """Cores, or address of a Dask scheduler; output folder; parameters and numbers set on the command line."""

    cores: int
    scheduler: str | None
    output: Path
    overrides: Mapping[str, Any]
    numbers: Mapping[str, Any]

    @classmethod
    def given(
        cls, assignments: Sequence[str], cores: int, scheduler: str | None, output: Path, **numbers: float | None
    ) -> Options:
        """Return the options of a command line; numbers: of the study, None keeps its own."""
        given = {name: value for name, value in numbers.items() if value is not None}
        return cls(cores, scheduler, output, library.parse_assignments(assignments), given)

    def workers(self, sweep: Sweep) -> AbstractContextManager[Workers]:
        """Return the workers of a sweep: a cluster, or threads of this process, for which its loop is compiled."""
        if self.scheduler is not None:
            return cluster(self.scheduler)
        sweep.loop.build()
        return threads(self.cores)


def file_of(name: str | None) -> Path:
    """Return the path of an installed sweep or scenario, given its name, or of a file."""
    sweeps = installed("sweeps")
    if name in sweeps:
        return sweeps[name]
    try:
        return library.find(name)
    except library.ScenarioError as error:
        raise library.ScenarioError(f"{error}; or of the sweeps {', '.join(sweeps)}") from None


def planned(name: str | None, options: Options) -> Sweep:
    """Return the sweep to run; raise FjrError."""
    path = file_of(name)
    return described(path, ros_yaml.read(path, "sweep"), options)[0]


def described(path: Path, document: Any, options: Options) -> tuple[Sweep, SweepFile]:
    """Return the sweep of a parsed file and its description, the usual one for a scenario; raise FjrError."""
    if not is_one(document):
        text, loaded = library.as_run(path, options.overrides)
        file = usual(path.stem, loaded.sample_period)
        return _sweep(path.stem, text, file, options), file
    try:
        file = read(document)
        neighbour = path.parent / file.scenario
        scenario = neighbour if os.path.isfile(neighbour) else library.find(file.scenario)
        text, _ = library.as_run(scenario, {**file.changes, **options.overrides})
        posterior = read_identification(path.parent / file.posterior).as_dict() if file.posterior else None
        return _sweep(path.stem, text, file, options, posterior), file
    except ParameterError as error:
        raise ParameterError(f"sweep {path.stem} {error}") from None


def _sweep(
    name: str, text: str, file: SweepFile, options: Options, posterior: Mapping[str, Any] | None = None
) -> Sweep:
    numbers = {"runs": RUNS, **file.numbers, **options.numbers}
    return Sweep(name, text, vary=file.vary, success=file.success, posterior=posterior, **numbers)
