# SPDX-License-Identifier: Apache-2.0
"""Specification of a comparison: laws, robots, references and imperfections, read from YAML."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from fjr_core.config import ros_yaml
from fjr_core.errors import FjrError, ParameterError, prefixed
from fjr_core.extensions.law_registry import LAWS, V_DPBC
from fjr_core.files.importing import is_named
from fjr_core.files.importing import load as load_class
from fjr_core.robust.options import Robust
from fjr_msgs_py.scenarios import library

from ..batch.draws import varied
from .sections import Reader, between, by_name, listed, mapping, number, section, subsection
from .sweep import OF_SWEEP, refuse_what_is_left_out
from .trial import IMPERFECTIONS, TRACKS, directions
from .tune import GOAL, SIZE, Goal

NOMINAL = "nominal"
CHANGED = ("reference.", "initial_")  # parameters that references of one robot may change
TUNED = "tuned"  # gains of v-dPBC
LONGEST, LONGEST_JOIN = 600.0, 10.0  # s
FASTEST = 1e6  # 1/s; of a robust option
ROBUST = tuple(each.name for each in fields(Robust) if each.name != "hold")


@dataclass(frozen=True)
class LawChoice:
    """A column: label, law, robust options.

    retune: v-dPBC with gains by the rule of docs/compare.md; otherwise with the gains of the scenario.
    options: arguments of the constructor of a law of the user, module:Class. join [s]: least duration of the transition
    from the measured state to the reference (start.join_time), 0: none.
    """

    label: str
    law: str
    robust: Mapping[str, float] = field(default_factory=dict)
    retune: bool = False
    options: Mapping[str, Any] = field(default_factory=dict)
    join: float = 0.0


@dataclass(frozen=True)
class RobotChoice:
    """A robot: label, its scenario, and parameter changes of that scenario for each reference."""

    label: str
    scenario: str
    references: Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True)
class Suite:
    """Specification of `fjr compare`. duration [s]: of every run; settle_after [s]: start of the error metrics.

    imperfections: name -> imperfection -> level; margins: those along which the largest level is searched, with the
    first reference. tracks: see Trial. tune: what every law is tuned for (see
    `uncertainties`), None: by the rule of equal bandwidth.
    """

    name: str
    laws: tuple[LawChoice, ...]
    robots: tuple[RobotChoice, ...]
    imperfections: Mapping[str, Mapping[str, float]]
    margins: tuple[str, ...]
    duration: float
    settle_after: float
    tracks: float
    tune: Mapping[str, Any] | None = None


def load(path: Path) -> Suite:
    """Read a suite from a file; raise ParameterError, which names the file."""
    document = ros_yaml.read(path, "suite")
    with prefixed(f"suite {path}: "):
        return read(path.stem, document)


def read(name: str, document: Any) -> Suite:
    """Return the suite of a parsed document; raise ParameterError."""
    given = section(document, SUITE, required=("laws", "robots"))
    duration = given.setdefault("duration", 6.0)
    usual = {"imperfections": {}, "margins": (), "settle_after": duration / 2, "tracks": TRACKS, "tune": None}
    found = Suite(name, **{**usual, **given})
    _check_settling(found.settle_after, found.duration)
    return replace(found, imperfections={NOMINAL: {}, **found.imperfections})  # the nominal plant first


def _check_settling(settle_after: float, duration: float) -> None:
    if not 0 <= settle_after < duration:
        raise ParameterError(
            f"'settle_after' is {settle_after} and 'duration' {duration} s; expected 0 to less than the duration"
        )


def _laws(key: str, given: Any) -> tuple[LawChoice, ...]:
    laws = tuple(map(_law, listed(key, given)))
    labels = [law.label for law in laws]
    twice = next((label for label in labels if labels.count(label) > 1), None)
    if twice is not None:
        raise ParameterError(f"law '{twice}' is listed twice; expected different labels")
    return laws


def _law(given: Any) -> LawChoice:
    named = given if isinstance(given, Mapping) else {"law": given}
    label = str(named.get("label", named.get("law")))
    found = section(named, LAW, f"law '{label}': ", required=("law",))
    law, gains = found["law"], found.pop("gains", None)
    if found.get("options") and not is_named(law):
        raise ParameterError(f"law '{label}' has options; expected them for a law of your own, module:Class")
    if gains is not None and (gains, law) != (TUNED, V_DPBC):
        raise ParameterError(
            f"'gains' of {label} is {gains!r}; expected '{TUNED}', for {V_DPBC} only: other laws are always tuned"
        )
    return LawChoice(**{**found, "label": label}, retune=gains == TUNED)


def _known_law(_key: str, name: Any) -> str:
    if is_named(name):
        load_class(name)
    elif not isinstance(name, str) or name not in LAWS:
        raise ParameterError(f"unknown law '{name}': expected one of {', '.join(LAWS)}, or module:Class of your own")
    return str(name)


def _robot(label: str, given: Any) -> RobotChoice:
    found = section({"scenario": label, "references": None, **mapping(label, given)}, ROBOT, f"robot '{label}': ")
    return RobotChoice(label, **found)


def _references(key: str, given: Any) -> Mapping[str, Mapping[str, Any]]:
    references: dict[str, Mapping[str, Any]] = by_name(mapping)(key, given or {"scenario": {}})
    for reference, changes in references.items():
        for name in changes:
            if not str(name).startswith(CHANGED):
                raise ParameterError(
                    f"reference '{reference}' changes '{name}'; expected names that begin with "
                    f"{' or '.join(CHANGED)}: the robot is the same along all of them"
                )
    return references


def _levels(name: str, given: Any) -> dict[str, float]:
    if name == NOMINAL:
        raise ParameterError(f"an imperfection is called '{NOMINAL}'; expected another name: this is the ideal plant")
    return dict(LEVELS(name, given))


def _margins(key: str, given: Any) -> tuple[str, ...]:
    names = tuple(map(str, listed(key, given)))
    directions(names)  # raises ParameterError
    return names


def uncertainties(key: str, given: Any) -> dict[str, Any]:
    """Return the section `tune` of a comparison, checked and complete.

    A deviation under its former name is reported and has its present one in the result, which worker processes read.
    """
    found = {**USUAL, **UNCERTAIN(key, given)}
    with prefixed(f"'{key}': "):
        _check_settling(found["settle_after"], found["duration"])
        return {**found, "vary": {name: one.as_yaml for name, one in varied(found["vary"]).items()}}


def scenario_texts(robot: RobotChoice, join: float = 0.0) -> tuple[tuple[str, str], ...]:
    """Return (reference, scenario text) for each reference of a robot; raise ParameterError.

    Every law starts alike: at once, or with a transition if join > 0 [s], whatever the scenario's limits.start_error.
    """
    path = library.find(robot.scenario)
    texts = []
    with prefixed(f"robot '{robot.label}': ", FjrError):
        for label, changes in robot.references.items():
            _, scenario = library.as_run(path, changes)
            start = {"start.join_time": join, "limits.start_error": [math.inf] * scenario.robot.n}
            text, scenario = library.as_run(path, {**changes, **start})
            refuse_what_is_left_out(scenario, "a suite sets these itself, use 'imperfections'")
            texts.append((label, text))
    return tuple(texts)


USUAL: Mapping[str, Any] = {
    "vary": {},
    "imperfections": {},
    **asdict(Goal()),
    "candidates": 150,
    "draws": 24,
    "fresh": 400,
    "seed": 1,
    "duration": 3.0,
    "settle_after": 1.0,
}
"""What every law is tuned for where the section `tune` of a comparison is silent: deviations as in a sweep file, levels
of imperfections, the fields of Goal, numbers of TuningStudy and of Sweep."""
DURATION = between(1e-3, LONGEST)
NUMBERS: Mapping[str, Reader] = {"seed": OF_SWEEP["seed"], "duration": DURATION, "settle_after": number}
"""Readers of the numbers of a sweep that the section `tune` may have."""
LEVELS = subsection({name: one.read for name, one in IMPERFECTIONS.items()})
UNCERTAIN = subsection({"vary": mapping, "imperfections": LEVELS, **GOAL, **SIZE, **NUMBERS})
LAW: Mapping[str, Reader] = {
    "label": lambda _, label: str(label),
    "law": _known_law,
    "robust": subsection(dict.fromkeys(ROBUST, between(0, FASTEST))),
    "gains": lambda _, gains: gains,
    "options": mapping,
    "join": between(0, LONGEST_JOIN),
}
ROBOT: Mapping[str, Reader] = {"scenario": lambda _, name: str(name), "references": _references}
SUITE: Mapping[str, Reader] = {
    "laws": _laws,
    "robots": lambda key, given: tuple(by_name(_robot)(key, given).values()),
    "imperfections": by_name(_levels),
    "margins": _margins,
    "duration": DURATION,
    "settle_after": number,
    "tracks": between(1e-6, 1.0),
    "tune": uncertainties,
}
"""Readers of the keys of a suite, and of its laws, robots and section `tune`."""
