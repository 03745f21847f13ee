# SPDX-License-Identifier: Apache-2.0
"""Results of a comparison as plain values, comparison.json, and their rows: one for each metric of each robot.

The table of a page or document has a column for each law and a row for each metric: robustness margins along the
imperfections, errors under imperfections, metrics of the nominal run, and figures on drawn plants.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from dataclasses import replace as replaced
from pathlib import Path
from typing import Any

from fjr_core.errors import ParameterError
from fjr_core.extensions.law_registry import law_kind
from fjr_core.files.text_file import write_text
from fjr_core.model.joints import PRISMATIC, REVOLUTE, in_units
from fjr_msgs_py.console.output import DASH, number, percent, plural

from .suite import NOMINAL, Suite
from .trial import Direction, Imperfection, directions

SHORT = {"pd_gravity": "PD + gravity", "singular_perturbation": "singular perturbation"}
VERSIONS = {"pd_feedforward": "pd_gravity", "torque_feedback_feedforward": "torque_feedback"}
TIE = 0.05  # relative; smaller differences count as equal
BEGIN, END = "<!-- fjr compare: begin -->", "<!-- fjr compare: end -->"


def document(suite: Suite, of: Sequence[tuple[str, str]], results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return results by robot and law, data shared by all laws with the robot; of: (robot, law) of each result."""
    by_robot: dict[str, dict[str, Any]] = {robot.label: {} for robot in suite.robots}
    robots: dict[str, Any] = {}
    for (robot, law), result in zip(of, results, strict=True):
        by_robot[robot][law] = {key: value for key, value in result.items() if key != "robot"}
        robots[robot] = result["robot"]
    given = asdict(suite)
    return {
        "suite": {key: value for key, value in given.items() if key not in ("laws", "robots")},
        "laws": [_described(law) for law in given["laws"]],
        "robots": robots,
        "runs": sum(result["runs"] for result in results),
        "results": by_robot,
    }


def _described(law: dict[str, Any]) -> dict[str, Any]:
    """Return a law of the suite with its data that do not depend on the robot; title: its label, else the law's."""
    name, kind = str(law["law"]), law_kind(law["law"])
    title = str(law["label"]) if law["label"] != name else SHORT.get(name, kind.title)
    return {**law, "title": title, "paper": kind.paper, "measures": kind.measures, "adds": kind.extension}


def extent(document: dict[str, Any]) -> str:
    """Count laws, versions of them, robots and runs of a comparison, as a sentence."""
    laws, robots = document["laws"], plural(len(document["robots"]), "robot")
    kinds = len({law_without_additions(law) for law in laws})
    runs = f"{plural(document['runs'], 'run')} of {document['suite']['duration']:g} s"
    versions = f" in {len(laws)} versions" if len(laws) > kinds else ""
    return f"{plural(kinds, 'control law')}{versions} on {robots}, {runs}."


def law_without_additions(law: dict[str, Any]) -> str:
    """Return the name of the published law of a column, without the version."""
    return VERSIONS.get(str(law["law"]), str(law["law"]))


@dataclass(frozen=True)
class Value:
    """Value of a law in a row. number: None if not available. state: tracks, lost (or stopped) or unstable."""

    number: float | None
    words: str
    state: str = "tracks"


@dataclass(frozen=True)
class Row:
    """One quantity of one robot, for all laws. less: smaller is better. in_table: it is a row of the short table.

    kind: "drawn", "margins", "errors" or "metrics"; the latter two along a reference.
    """

    robot: str
    kind: str
    reference: str
    name: str
    values: tuple[Value, ...]
    less: bool = True
    in_table: bool = False

    @property
    def best(self) -> tuple[bool, ...]:
        """For each law, whether no other is better by more than TIE; only laws that track count."""
        costs = [math.inf] * len(self.values)
        for i, value in enumerate(self.values):
            if value.number is not None and value.state == "tracks":
                costs[i] = value.number if self.less else 1 / value.number if value.number > 0 else math.inf
        return tuple(cost < math.inf and cost <= min(costs) * (1 + TIE) for cost in costs)


@dataclass(frozen=True)
class Metric:
    """A number of a run or of drawn plants: its name in a row, its key in the results [SI], the unit of its text."""

    name: str
    key: str
    unit: str
    less: bool = True

    def words(self, value: float) -> str:
        """Format the number; errors in mrad are without their unit, which the table names."""
        if self.unit == "%":
            return percent(value, 1)
        return number(1e3 * value) if self.unit == "mrad" else number(value, self.unit)


DRAWN = (
    Metric("drawn: RMS error [mrad]", "rms", "mrad"),
    Metric("drawn: its 95 % [mrad]", "rms_outer", "mrad"),
    Metric("drawn: share that tracks", "success", "%", less=False),
    Metric("drawn: noise of effort", "effort_noise", "N m"),
)
ERROR, PEAK_EFFORT = Metric("RMS error", "rms", "mrad"), Metric("peak effort", "effort_peak", "N m")
OF_A_RUN = (
    Metric("largest error", "peak", "mrad"),
    Metric("settled after", "settling", "s"),
    Metric("RMS effort", "effort_rms", "N m"),
    PEAK_EFFORT,
    Metric("mean power", "power", "W"),
)


def rows(document: dict[str, Any]) -> list[Row]:
    """Return all rows of a comparison (`document`), robot by robot: drawn plants, margins, errors, nominal run."""
    found = []
    for robot in document["robots"]:
        for row in _rows(document, robot):
            values = (replaced(value, words=in_units_of(document, robot, value.words)) for value in row.values)
            found.append(replaced(row, name=in_units_of(document, robot, row.name), values=tuple(values)))
    return found


def in_units_of(document: dict[str, Any], robot: str, text: str) -> str:
    """Return a text, which has the units of a revolute joint, with those of the joints of a robot."""
    return in_units(text, (PRISMATIC if slides else REVOLUTE for slides in document["robots"][robot]["prismatic"]))


def table_rows(document: dict[str, Any]) -> list[Row]:
    """Return the rows of the table: drawn plants, margins, and error and peak effort of the nominal run."""
    return [row for row in rows(document) if row.in_table]


def _rows(document: dict[str, Any], robot: str) -> Iterator[Row]:
    suite, laws = document["suite"], [document["results"][robot][law["label"]] for law in document["laws"]]
    if suite["tune"] and all(law["uncertain"] for law in laws):
        for metric in DRAWN:
            values = tuple(_drawn(metric, law["uncertain"], suite["tune"]["success"]) for law in laws)
            yield Row(robot, "drawn", "", metric.name, values, metric.less, True)
    for direction in directions(suite["margins"]):
        values = tuple(_margin(direction, law["margins"][direction.name]) for law in laws)
        yield Row(robot, "margins", "", direction.name, values, direction.is_down, True)
    references = list(document["robots"][robot]["references"])
    errors = [("errors", each, name, name, ERROR) for each in references for name in suite["imperfections"]]
    metrics = [("metrics", each, NOMINAL, metric.name, metric) for each in references for metric in OF_A_RUN]
    for kind, reference, imperfection, name, metric in (*errors, *metrics):
        values = tuple(_cell(metric, law["cells"][reference][imperfection]) for law in laws)
        in_table = reference == references[0] and imperfection == NOMINAL and metric in (ERROR, PEAK_EFFORT)
        yield Row(robot, kind, reference, name, values, True, in_table)


def _drawn(metric: Metric, figures: dict[str, Any], least: float) -> Value:
    """Return a figure on fresh draws; of a law that tracks too few of them it does not count.

    An arm that a limit has stopped has little noise and a small effort.
    """
    value, counts = figures[metric.key], metric.key == "success" or (figures["success"] or 0.0) >= least
    words = DASH if value is None else metric.words(value)
    return Value(value, words, "tracks" if counts and value is not None else "lost")


def _margin(direction: Direction, margin: dict[str, Any]) -> Value:
    """Return the largest level up to which a law tracks, after a sign if no larger one was tested."""
    level = margin["level"]
    if level is None:
        return Value(None, DASH, "lost")
    further = "" if margin["beyond"] is not None else "≤ " if direction.is_down else "≥ "
    return Value(level, further + level_words(direction.imperfection, level))


def _cell(metric: Metric, run: dict[str, Any]) -> Value:
    """Return a metric of a run."""
    if not run["stable"]:
        return Value(None, "unstable", "unstable")
    if run["stopped"]:
        return Value(None, "stopped", "lost")
    value = run[metric.key]
    return Value(value, DASH if value is None else metric.words(value), "tracks" if run["tracks"] else "lost")


def level_words(one: Imperfection, level: float) -> str:
    """Format the level of an imperfection with its unit."""
    if one.is_factor:
        return f"× {number(level, digits=3)}"
    if one.unit in ("s", "rad"):
        return number(level * 1e3, f"m{one.unit}", 2)
    return percent(level, 0 if level >= 0.1 else 1)


def best_in(document: dict[str, Any]) -> str:
    """Count, for each column of the table, the rows in which it is best or within TIE of it, as a sentence."""
    shown = table_rows(document)
    counts = [(str(law["title"]), sum(row.best[i] for row in shown)) for i, law in enumerate(document["laws"])]
    each = ", ".join(f"{title} {count}" for title, count in sorted(counts, key=lambda one: -one[1]))
    best = f"Best, or within {percent(TIE, 0)} of the best"
    return f"{best}: {each} of {len(shown)} rows (several columns may share a row)."


def cells(document: dict[str, Any]) -> list[list[str]]:
    """Return the cells of the table: a head with the laws, and for each robot its name alone and its rows."""
    names = [str(law["title"]) for law in document["laws"]]
    found = [["", *names]]
    shown = table_rows(document)
    for robot in document["robots"]:
        found.append([robot, *[""] * len(names)])
        for row in (row for row in shown if row.robot == robot):
            what = in_units_of(document, robot, "RMS error [mrad]") if row.kind == "errors" else row.name
            found.append([what, *(value.words for value in row.values)])
    return found


def markdown(document: dict[str, Any]) -> str:
    """Return the extent of the comparison and one table: a row for each metric of each robot, a column for each law."""
    head, *body = cells(document)
    bold = [[f"**{first}**", *rest] if not any(rest) else [first, *rest] for first, *rest in body]
    lines = [f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *bold)]
    legend = f"*`fjr compare {document['suite']['name']}`. {DASH}: does not track the nominal robot.*"
    counts = ["", best_in(document)] if document["suite"]["tune"] else []
    return "\n".join([extent(document), "", *lines, "", legend, *counts, ""])


def marks(suite: str) -> tuple[str, str]:
    """Return the lines between which the table of this suite stands in a file with several tables."""
    return f"<!-- fjr compare {suite}: begin -->", f"<!-- fjr compare {suite}: end -->"


def replace(path: Path, document: dict[str, Any]) -> None:
    """Write the table of a comparison between its marks in a file, else between those without a name."""
    before, begin, end, after = around_table(path, document["suite"]["name"])
    write_text(path, f"{before}{begin}\n{markdown(document)}{end}{after}")


def around_table(path: Path, suite: str) -> tuple[str, str, str, str]:
    """Return the text of a file before the first mark of a suite, both marks, and the text after the second.

    Raise ParameterError if the file lacks them.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ParameterError(f"cannot read {path}: {error.strerror}") from None
    for first, last in (marks(suite), (BEGIN, END)):
        before, begin, rest = text.partition(first)
        _, end, after = rest.partition(last)
        if begin and end:
            return before, begin, end, after
    raise ParameterError(f"{path} lacks the lines '{BEGIN}' and '{END}'; expected both, in this order")
