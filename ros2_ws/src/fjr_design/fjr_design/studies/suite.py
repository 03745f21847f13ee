# SPDX-License-Identifier: Apache-2.0
"""Specification of a comparison: laws, robots, references and imperfections, read from YAML."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from fjr_core.config import ros_yaml
from fjr_core.errors import CompareError, FjrError, ParameterError, prefixed
from fjr_core.extensions.law_registry import LAWS, V_DPBC
from fjr_core.files.importing import is_named
from fjr_core.files.importing import load as load_class
from fjr_core.robust.options import Robust
from fjr_msgs_py.scenarios import library

from ..batch.draws import varied
from .sweep import check_keys, is_finite, mapping, number, refuse_what_is_left_out, whole
from .trial import TRACKS, directions, imperfection
from .tune import GOAL, HERE, Goal, given_goal

REQUIRED = ("laws", "robots")
KEYS = (*REQUIRED, "imperfections", "margins", "duration", "settle_after", "tracks", "tune")
NOMINAL = "nominal"
CHANGED = ("reference.", "initial_")  # parameters that references of one robot may change
GAINS = ("scenario", TUNED := "tuned")  # of v-dPBC
LONGEST, LONGEST_JOIN = 600.0, 10.0  # s
NUMBERS: Mapping[str, Callable[[str, object, str], float]] = {"seed": whole, "duration": number, "settle_after": number}
"""Numbers of a sweep that the section `tune` may have."""
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
    """Read a suite from a file; raise CompareError, which names the file."""
    document = ros_yaml.read(path, "suite")
    with prefixed(f"suite {path}: ", new=CompareError):
        return read(path.stem, document)


def read(name: str, document: Any) -> Suite:
    """Return the suite of a parsed document; raise ParameterError."""
    given = _mapping("a suite", document)
    check_keys(given, KEYS)
    for key in REQUIRED:
        if not given.get(key):
            raise CompareError(f"has no '{key}'; expected at least one")
    duration = _number("duration", given.get("duration", 6.0), lambda value: 0 < value <= LONGEST)
    robots = _mapping("'robots'", given["robots"])
    margins = given.get("margins", [])
    if not isinstance(margins, list):
        raise CompareError(f"'margins' is {margins!r}; expected a list of imperfections")
    directions(margins := [str(name) for name in margins])
    return Suite(
        name=name,
        laws=_laws(given["laws"]),
        robots=tuple(_robot(label, each) for label, each in robots.items()),
        imperfections=_imperfections(given.get("imperfections", {})),
        margins=tuple(margins),
        duration=duration,
        settle_after=_number("settle_after", given.get("settle_after", duration / 2), lambda v: 0 <= v < duration),
        tracks=_number("tracks", given.get("tracks", TRACKS), lambda value: 0 < value < 1),
        tune=uncertainties(_mapping("'tune'", given["tune"])) if "tune" in given else None,
    )


def _laws(given: Any) -> tuple[LawChoice, ...]:
    if not isinstance(given, list):
        raise CompareError(f"'laws' is {given!r}; expected a list")
    laws = tuple(_law(each) for each in given)
    labels = [law.label for law in laws]
    twice = next((label for label in labels if labels.count(label) > 1), None)
    if twice is not None:
        raise CompareError(f"law '{twice}' is listed twice; expected different labels")
    return laws


def _law(given: Any) -> LawChoice:
    if isinstance(given, str):
        return LawChoice(given, _known_law(given))
    label, law = str(_mapping("a law", given).get("label", given.get("law"))), _known_law(given.get("law"))
    check_keys(given, ("label", "law", "robust", "gains", "options", "join"), f"law '{label}' ")
    robust = _mapping(f"'robust' of {label}", given.get("robust", {}))
    check_keys(robust, ROBUST, f"'robust' of {label} ")
    gains, own = given.get("gains"), _mapping(f"'options' of {label}", given.get("options", {}))
    if own and not is_named(law):
        raise CompareError(f"law '{label}' has options; expected them for a law of your own, module:Class")
    if gains not in (None, *GAINS) or (gains and law != V_DPBC):
        raise CompareError(
            f"'gains' of {label} is {gains!r}; expected {' or '.join(GAINS)}, for {V_DPBC} only, other laws are tuned"
        )
    numbers = {key: _number(f"robust.{key}", value, lambda v: v >= 0) for key, value in robust.items()}
    join = _number(f"'join' of {label}", given.get("join", 0.0), lambda value: 0 <= value <= LONGEST_JOIN)
    return LawChoice(label, law, numbers, gains == TUNED, own, join)


def _known_law(name: Any) -> str:
    if is_named(name):
        load_class(name)
    elif not isinstance(name, str) or name not in LAWS:
        raise CompareError(f"unknown law '{name}': expected one of {', '.join(LAWS)}, or module:Class of your own")
    return str(name)


def _robot(label: str, given: Any) -> RobotChoice:
    options = _mapping(f"robot '{label}'", given)
    check_keys(options, ("scenario", "references"), f"robot '{label}' ")
    name = str(options.get("scenario", label))
    references = _mapping(f"'references' of {label}", options.get("references") or {"scenario": {}})
    changes = {str(key): _mapping(f"reference '{key}' of {label}", value or {}) for key, value in references.items()}
    for reference, each in changes.items():
        for key in each:
            if not str(key).startswith(CHANGED):
                raise CompareError(
                    f"reference '{reference}' of {label} changes '{key}'; expected names that begin with "
                    f"{' or '.join(CHANGED)}: the robot is the same along all of them"
                )
    return RobotChoice(str(label), name, changes)


def scenario_texts(robot: RobotChoice, join: float = 0.0) -> tuple[tuple[str, str], ...]:
    """Return (reference, scenario text) for each reference of a robot; raise CompareError or FjrError.

    Every law starts alike: at once, or with a transition if join > 0 [s], whatever the scenario's limits.start_error.
    """
    path = library.find(robot.scenario)
    texts = []
    with prefixed(f"robot '{robot.label}': ", FjrError, CompareError):
        for label, changes in robot.references.items():
            _, scenario = library.as_run(path, changes)
            start = {"start.join_time": join, "limits.start_error": [math.inf] * scenario.robot.n}
            text, scenario = library.as_run(path, {**changes, **start})
            refuse_what_is_left_out(scenario, "a suite sets these itself, use 'imperfections'")
            texts.append((label, text))
    return tuple(texts)


def _imperfections(given: Any) -> dict[str, dict[str, float]]:
    """Return the levels by name, the nominal plant first."""
    found: dict[str, dict[str, float]] = {NOMINAL: {}}
    for name, levels in _mapping("'imperfections'", given).items():
        if str(name) == NOMINAL:
            raise CompareError(
                f"an imperfection is called '{NOMINAL}'; expected another name: this one is the ideal plant"
            )
        each = _mapping(f"imperfection '{name}'", levels or {})
        numbers = {axis: _number(f"'{axis}' of '{name}'", level, lambda _: True) for axis, level in each.items()}
        found[str(name)] = {axis: imperfection(axis).checked(level) for axis, level in numbers.items()}
    return found


def _mapping(what: str, given: Any) -> dict[str, Any]:
    if not isinstance(given, dict):
        raise CompareError(f"{what} is {given!r}; expected a mapping")
    return given


def _number(what: str, given: Any, is_valid: Callable[[float], bool]) -> float:
    if not is_finite(given) or not is_valid(given):
        raise CompareError(f"{what} is {given!r}; expected a number in range")
    return float(given)


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


def uncertainties(section: Mapping[str, Any]) -> dict[str, Any]:
    """Return the section `tune` of a comparison, checked and complete; raises ParameterError, CompareError.

    A deviation under its former name is reported and has its present one in the result, which worker processes read.
    """
    goal, size = given_goal(section, list(USUAL))
    found = {**USUAL, **goal, **size}
    found |= {key: mapping(key, section[key], HERE) for key in ("vary", "imperfections") if key in section}
    found |= {key: read(key, section[key], HERE) for key, read in NUMBERS.items() if key in section}
    levels = {name: number(name, level, HERE) for name, level in found["imperfections"].items()}
    found["imperfections"] = {name: imperfection(name).checked(level) for name, level in levels.items()}
    with prefixed("'tune': "):
        Goal(**{name: found[name] for name in GOAL})
        if not 0 <= found["settle_after"] < found["duration"] <= LONGEST:
            raise ParameterError(
                f"'settle_after' is {found['settle_after']} and 'duration' {found['duration']} s; expected 0 to less "
                f"than the duration, and this at most {LONGEST:g} s"
            )
        found["vary"] = {name: one.as_yaml for name, one in varied(found["vary"]).items()}
    return found
