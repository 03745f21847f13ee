# SPDX-License-Identifier: Apache-2.0
"""YAML file of a sweep: scenario, drawn deviations, success criteria; with the command line, the sweep to run."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeGuard

from fjr_core.config import ros_yaml
from fjr_core.config.parameter import resembling
from fjr_core.errors import ParameterError, prefixed
from fjr_design.batch.draws import FIXED, FORM, Distribution, varied
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


def is_one(document: object) -> bool:
    """Return whether a YAML document is a sweep, not a scenario."""
    return isinstance(document, Mapping) and "scenario" in document and "/**" not in document


def read(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of Sweep that a parsed document gives, but for scenario and posterior; raise ParameterError."""
    check_keys(document, KEYS)
    given = {key: mapping(key, document.get(key, {})) for key in MAPPINGS}
    vary = varied(given["vary"])
    posterior = document.get(POSTERIOR, "")
    if not isinstance(posterior, str):
        raise ParameterError(f"has {posterior!r} as '{POSTERIOR}'; expected the path of an identification.json")
    if not posterior and not any(one.kind != FIXED for one in vary.values()):
        raise ParameterError(f"draws nothing; expected '{POSTERIOR}', or 'vary' with {FORM}")
    success = {name: number(f"success.{name}", value) for name, value in given["success"].items()}
    wholes = {key: whole(key, document[key]) for key in WHOLE if key in document}
    numbers = {key: number(key, document[key]) for key in SECONDS if key in document}
    return {"vary": vary, "success": success, **wholes, **numbers}


def usual(sample_period: float) -> dict[str, Distribution]:
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
    return varied(document)


def check_keys(given: Mapping[str, Any], keys: Sequence[str], where: str = "") -> None:
    """Raise ParameterError for an unknown key, with the one it resembles; where: section, as a start of the message."""
    for key in given:
        if key not in keys:
            close = resembling(str(key), keys)
            hint = f"did you mean '{close}'?" if close else f"expected some of {', '.join(keys)}"
            raise ParameterError(f"{where}has '{key}'; {hint}")


def mapping(name: str, value: object, where: str = "") -> Mapping[str, Any]:
    """Return a section of the file; raise ParameterError for anything else."""
    if not isinstance(value, Mapping):
        raise ParameterError(f"{where}has {value!r} as '{name}'; expected a mapping")
    return value


def whole(name: str, value: object, where: str = "") -> int:
    """Return a whole number of the file; raise ParameterError for anything else."""
    if not is_finite(value) or value != int(value):
        raise ParameterError(f"{where}has {value!r} as '{name}'; expected a whole number")
    return int(value)


def number(name: str, value: object, where: str = "") -> float:
    """Return a finite number of the file; raise ParameterError for anything else."""
    if not is_finite(value):
        raise ParameterError(f"{where}has {value!r} as '{name}'; expected a number")
    return float(value)


def is_finite(value: object) -> TypeGuard[int | float]:
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


def described(path: Path, document: Any, options: Options) -> tuple[Sweep, Mapping[str, Any]]:
    """Return the sweep of a parsed file and its section `tune`, of a scenario the usual sweep; raise FjrError."""
    if not is_one(document):
        text, loaded = library.as_run(path, options.overrides)
        return Sweep(path.stem, text, vary=usual(loaded.sample_period), **{"runs": RUNS, **options.numbers}), {}
    with prefixed(f"sweep {path.stem} "):
        fields, name = read(document), str(document["scenario"])
        scenario = path.parent / name if os.path.isfile(path.parent / name) else library.find(name)
        text, _ = library.as_run(scenario, {**document.get("set", {}), **options.overrides})
        if document.get(POSTERIOR):
            fields["posterior"] = read_identification(path.parent / document[POSTERIOR]).as_dict()
        return Sweep(path.stem, text, **{"runs": RUNS, **fields, **options.numbers}), document.get(TUNE, {})
