# SPDX-License-Identifier: Apache-2.0
"""Which cause the lack of fit of a motion is given, whether K is called identified all the same, and the table."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from bench.figures import markdown
from fjr_core.errors import RecordError
from fjr_design.uncertainty.posterior import IDENTIFIED
from fjr_identification.estimation.estimation_problem import Estimation
from fjr_identification.estimation.filtered_fit import filtered_fit
from fjr_identification.estimation.lack_of_fit import seen
from fjr_identification.estimation.parameters import IdentifyOptions, prior_of
from fjr_identification.records.checks import findings

from .coverage import CASES, CAUSES, identified, read
from .draws import Draws, drawn

PASSED = 0.05
"""Share of the samples on either side of a dead zone from which on it counts as passed."""

Named = list[tuple[str, bool, bool, bool]]
"""Of each joint of a record: the cause that is named, whether its torque changes its sign, whether its stiffness is
called identified, and whether this interval misses the secants that were driven."""


def of_batch(job: tuple[str, int, int, int]) -> list[Named | None]:
    """Return what is named in each draw of a batch: name of the case, number of joints, of draws, and seed."""
    name, joints, count, seed = job
    draws = drawn(CASES[name], joints, count, seed)
    return [named(draws, i) for i in range(count)]


def named(draws: Draws, i: int) -> Named | None:
    """Return what is named of each joint of draw i, None if its record is refused.

    Motions are simulated only where a cause is expected, and missed: a stiffness with a cause is not called identified.
    """
    try:
        record, nominal = read(draws, i)
    except RecordError:
        return None
    if findings(record, nominal.robot):
        return None
    options = IdentifyOptions(threads=1)
    setup = Estimation([record], nominal.robot, prior_of(nominal.robot), options)
    found = [each.wrong for each in seen(setup, filtered_fit(setup, setup.coordinates.mean)).values()]
    sought = bool(draws.case.cause) and not all(found)
    of_record = identified(draws, i, options) or [] if sought else []
    K = [(each.verdict == IDENTIFIED, not each.meets) for each in of_record if each.kind == "joint_stiffness"]
    sure = [(called, called and misses) for called, misses in K] or [(False, False)] * len(record.joints)
    passed = draws.changes_sign(i, PASSED).tolist()
    return [(said, sign, *of_K) for said, sign, of_K in zip(found, passed, sure, strict=True)]


def head(joints: Sequence[int]) -> str:
    """Return the first lines of the table."""
    columns = ["physics", *(f"named, joints of {n}" for n in joints), "where the torque changes its sign"]
    columns += ["K identified", "of these beyond the secants", "else"]
    return "\n".join(markdown(columns, [], right=columns[1:-1]))


def line(name: str, results: Sequence[Sequence[Named | None]]) -> str:
    """Return a row of the table, from the draws of each number of joints. Cases without a cause expect none."""
    of_number = [[joint for each in of_n if each is not None for joint in each] for of_n in results]
    every, cause = sum(of_number, []), CASES[name].cause if name in CASES else ""
    right = [[cause in said if cause else bool(said) for said, *_ in joints] for joints in of_number]
    passed = [cause in said for said, changes, *_ in every if changes] if cause == "backlash" else []
    sure = [misses for *_, called, misses in every if called]
    others = Counter(kind(said) for said, *_ in every if said and not (cause and cause in said))
    refused = sum(each is None for of_n in results for each in of_n)
    others.update({"records refused": refused} if refused else {})
    cells = [
        *(f"{sum(each)} of {len(each)}" for each in right),
        f"{sum(passed)} of {len(passed)}" if passed else "",
        str(len(sure)) if cause else "",
        str(sum(sure)) if cause else "",
        ", ".join(f"{count} {what}" for what, count in others.most_common()),
    ]
    return "| " + " | ".join([name, *cells]) + " |"


def kind(sentence: str) -> str:
    """Return the words of a sentence that name its cause."""
    return next((words for words in CAUSES if words in sentence), sentence)
