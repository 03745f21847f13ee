# SPDX-License-Identifier: Apache-2.0
"""Results of a comparison as plain values: content of comparison.json, and rows for pages and tables."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

from fjr_core.extensions.law_registry import law_kind
from fjr_design.experiments.comparison.perturbations import PERTURBATIONS, Direction, directions
from fjr_design.studies.comparison.job import Job, Result
from fjr_design.studies.comparison.suite import NOMINAL, Suite
from fjr_msgs_py.console.output import DASH, number, percent, plural

SHORT = {
    "pd_gravity": "PD + gravity",
    "singular_perturbation": "singular perturbation",
}
VERSIONS = {"pd_feedforward": "pd_gravity", "torque_feedback_feedforward": "torque_feedback"}


def document(suite: Suite, jobs: Sequence[Job], results: Sequence[Result]) -> dict[str, Any]:
    """Return results by robot and law; data shared by all laws stand with the robot."""
    by_robot: dict[str, dict[str, Result]] = {robot.label: {} for robot in suite.robots}
    robots: dict[str, Any] = {}
    for job, result in zip(jobs, results, strict=True):
        by_robot[job.robot][job.law.label] = {key: value for key, value in result.items() if key != "robot"}
        robots[job.robot] = result["robot"]
    given = asdict(suite)
    return {
        "suite": {key: value for key, value in given.items() if key not in ("laws", "robots")},
        "laws": [_described(law) for law in given["laws"]],
        "robots": robots,
        "runs": sum(result["runs"] for result in results),
        "results": by_robot,
    }


def extent(document: dict[str, Any]) -> str:
    """Count laws, versions of them, robots and runs of a comparison, as a sentence."""
    laws, robots = document["laws"], plural(len(document["robots"]), "robot")
    kinds = plural(len({law_without_additions(law) for law in laws}), "control law")
    runs = f"{plural(document['runs'], 'run')} of {document['suite']['duration']:g} s"
    return f"{kinds} in {plural(len(laws), 'version')} on {robots}, {runs}."


def law_without_additions(law: dict[str, Any]) -> str:
    """Return the name of the published law of a column, without the version."""
    return VERSIONS.get(str(law["law"]), str(law["law"]))


def _described(law: dict[str, Any]) -> dict[str, Any]:
    """Return a law of the suite with its data that do not depend on the robot; title: its label, else the law's."""
    name, kind = str(law["law"]), law_kind(law["law"])
    title = str(law["label"]) if law["label"] != name else SHORT.get(name, kind.title)
    data = {"full_title": kind.title, "paper": kind.paper, "measures": kind.measures, "adds": kind.adds}
    return {**law, "title": title, **data}


TIE = 0.05  # relative; smaller differences count as equal
Words = Callable[[float], str]


@dataclass(frozen=True)
class Value:
    """Value of a law in a row. number: None if not available. state: tracks, lost (or stopped) or unstable."""

    number: float | None
    words: str
    state: str = "tracks"


@dataclass(frozen=True)
class Row:
    """One quantity of one robot. group: heading; less: smaller is better."""

    robot: str
    group: str
    what: str
    values: tuple[Value, ...]
    less: bool = True

    @property
    def best(self) -> tuple[bool, ...]:
        """For each law, whether no other is better by more than TIE; only laws that track count."""
        costs = [_cost(value, self.less) for value in self.values]
        least = min(costs)
        return tuple(cost < math.inf and cost <= least * (1 + TIE) for cost in costs)


def table_rows(document: dict[str, Any]) -> list[Row]:
    """Return the rows of the table: drawn plants, margins, and error and peak effort of the nominal run."""
    first = {robot: next(iter(data["references"])) for robot, data in document["robots"].items()}
    return [row for row in rows(document) if _is_in_table(row, first[row.robot])]


def _is_in_table(row: Row, reference: str) -> bool:
    if row.group in ("margins", "uncertain"):
        return True
    return (row.group, row.what) in {(f"errors {reference}", NOMINAL), (f"metrics {reference}", "peak effort")}


def best_in(document: dict[str, Any]) -> str:
    """Count the rows of the table in which a version of a law is best or within TIE of it, as a sentence."""
    shown = table_rows(document)
    versions: dict[str, list[int]] = {}
    for i, law in enumerate(document["laws"]):
        versions.setdefault(law_without_additions(law), []).append(i)
    counts = {name: sum(any(row.best[i] for i in each) for row in shown) for name, each in versions.items()}
    ranked = sorted(counts.items(), key=lambda one: -one[1])
    each = ", ".join(f"{SHORT.get(name, law_kind(name).title)} {count}" for name, count in ranked)
    best = f"Best, or within {percent(TIE, 0)} of the best, with one of its versions"
    return f"{best}: {each} of {len(shown)} rows (several laws may share a row)."


def _cost(value: Value, less: bool) -> float:
    """Return a positive cost of a law; infinite if it does not count."""
    if value.number is None or value.state != "tracks":
        return math.inf
    if less:
        return value.number
    return 1 / value.number if value.number > 0 else math.inf


def rows(document: dict[str, Any]) -> list[Row]:
    """Return all rows of a comparison (results.document), robot by robot: margins, errors, nominal run."""
    found: list[Row] = []
    for robot in document["robots"]:
        laws = [document["results"][robot][law["label"]] for law in document["laws"]]
        found += _uncertain(robot, laws, document["suite"]["tune"])
        found += _margins(robot, laws, document["suite"]["margins"])
        found += _errors(robot, laws, document)
        found += _metrics(robot, laws, document)
    return found


def _uncertain(robot: str, laws: Sequence[Any], tune: dict[str, Any] | None) -> Iterator[Row]:
    """Yield the figures on fresh draws of laws tuned to uncertainties; a law that tracks too few draws does not count.

    An arm that a limit has stopped has little noise and a small effort.
    """
    if tune and all(law["uncertain"] for law in laws):
        for what, name, words, less in UNCERTAIN:
            yield Row(
                robot, "uncertain", what, tuple(_drawn(law["uncertain"], name, words, tune) for law in laws), less
            )


def _drawn(figures: dict[str, float | None], name: str, words: Words, tune: dict[str, Any]) -> Value:
    value = figures[name]
    counts = name == "success" or (figures["success"] or 0.0) >= tune["success"]
    return Value(value, DASH if value is None else words(value), "tracks" if counts and value is not None else "lost")


def _margins(robot: str, laws: Sequence[Any], axes: Sequence[str]) -> Iterator[Row]:
    for direction in directions(axes):
        words = partial(level_words, direction.perturbation.name)
        values = tuple(_margin(law["margins"][direction.name], words, direction) for law in laws)
        yield Row(robot, "margins", direction.name, values, less=direction.perturbation.is_factor and direction.end < 1)


def _margin(edge: dict[str, float | None], words: Words, direction: Direction) -> Value:
    level = edge["level"]
    if level is None:
        return Value(None, DASH, "lost")
    further = "≤ " if direction.end < direction.perturbation.nominal else "≥ "
    return Value(level, (further if edge["beyond"] is None else "") + words(level))


def level_words(axis: str, level: float) -> str:
    """Format the level of an imperfection with its unit."""
    if PERTURBATIONS[axis].is_factor:
        return f"× {number(level, digits=3)}"
    if PERTURBATIONS[axis].unit == "s":
        return number(level * 1e3, "ms", 2)
    if PERTURBATIONS[axis].unit == "rad":
        return number(level * 1e3, "mrad", 2)
    return percent(level, 0 if level >= 0.1 else 1)


def _errors(robot: str, laws: Sequence[Any], document: dict[str, Any]) -> Iterator[Row]:
    """Yield the RMS errors under every imperfection along every reference."""
    for reference in document["robots"][robot]["references"]:
        for name in document["suite"]["imperfections"]:
            cells = [law["cells"][reference][name] for law in laws]
            yield Row(robot, f"errors {reference}", name, tuple(_value(cell, "rms", milliradians) for cell in cells))


UNCERTAIN: tuple[tuple[str, str, Words, bool], ...] = (
    ("drawn: RMS error [mrad]", "rms", lambda v: milliradians(v), True),
    ("drawn: its 95 % [mrad]", "rms_outer", lambda v: milliradians(v), True),
    ("drawn: share that tracks", "success", lambda v: percent(v, 1), False),
    ("drawn: noise of effort", "effort_noise", lambda v: number(v, "N m"), True),
)
METRICS: tuple[tuple[str, str, Words], ...] = (
    ("largest error", "peak", lambda v: milliradians(v)),
    ("settled after", "settling", lambda v: number(v, "s")),
    ("RMS effort", "effort_rms", lambda v: number(v, "N m")),
    ("peak effort", "effort_peak", lambda v: number(v, "N m")),
    ("mean power", "power", lambda v: number(v, "W")),
)


def _metrics(robot: str, laws: Sequence[Any], document: dict[str, Any]) -> Iterator[Row]:
    for reference in document["robots"][robot]["references"]:
        cells = [law["cells"][reference][NOMINAL] for law in laws]
        for what, name, words in METRICS:
            yield Row(robot, f"metrics {reference}", what, tuple(_value(cell, name, words) for cell in cells))


def _value(cell: dict[str, Any], name: str, words: Words) -> Value:
    if not cell["stable"]:
        return Value(None, "unstable", "unstable")
    if cell["stopped"]:
        return Value(None, "stopped", "lost")
    value = cell[name]
    return Value(value, DASH if value is None else words(value), "tracks" if cell["tracks"] else "lost")


def milliradians(value: float) -> str:
    """Format radians as mrad."""
    return number(value * 1e3, "", 3)
