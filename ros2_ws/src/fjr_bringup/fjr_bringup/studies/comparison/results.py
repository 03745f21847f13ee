# SPDX-License-Identifier: Apache-2.0
"""The whole comparison in plain values: what comparison.json holds, and all pages and tables are made from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from fjr_bringup.formatting import plural
from fjr_bringup.studies.comparison.job import Job, Result
from fjr_bringup.studies.comparison.suite import Suite
from fjr_core.control.registry import LAWS

SHORT = {
    "pd_gravity": "PD + gravity",
    "singular_perturbation": "singular perturbation",
}
VERSIONS = {"pd_feedforward": "pd_gravity", "torque_feedback_feedforward": "torque_feedback"}


def document(suite: Suite, jobs: Sequence[Job], results: Sequence[Result]) -> dict[str, Any]:
    """Results by robot and law; what belongs to a robot whatever the law stands with the robot."""
    by_robot: dict[str, dict[str, Result]] = {robot.label: {} for robot in suite.robots}
    robots: dict[str, Any] = {}
    for job, result in zip(jobs, results, strict=True):
        by_robot[job.robot][job.law.label] = {key: value for key, value in result.items() if key != "robot"}
        robots[job.robot] = result["robot"]
    told = asdict(suite)
    return {
        "suite": {key: value for key, value in told.items() if key not in ("laws", "robots")},
        "laws": [{**law, "title": _title(law), **_known(law["law"])} for law in told["laws"]],
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
    """Name of the paper's law that a column is, or is a version of."""
    return VERSIONS.get(str(law["law"]), str(law["law"]))


def _title(law: dict[str, Any]) -> str:
    """The column's heading: the label, where the suite gives one."""
    name = str(law["law"])
    return str(law["label"]) if law["label"] != name else SHORT.get(name, LAWS[name].title)


def _known(name: str) -> dict[str, str]:
    """What there is to know of a law whatever it runs on."""
    kind = LAWS[name]
    return {"full_title": kind.title, "paper": kind.paper, "measures": kind.measures, "adds": kind.adds}
