# SPDX-License-Identifier: Apache-2.0
"""Whether the theory held on a recorded run, and if not, why: from measured states and sent efforts alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from .certificate import Balance
from .checks import Array
from .effort_age import Acting, acting, effort_age
from .fault_isolation import UNKNOWN, Finding, isolate
from .intervals import Intervals, Record, intervals, needed
from .linear_loop import linearize
from .prediction import Prediction
from .supplies import CAUSES, Supplies, supplies
from .thresholds import BLOCK, CAUSE_SHARE, FALLEN, FEWEST, GAP, JUDGED, PREDICTED, SHARE
from .vdpbc.law import TrackingLaw

SAMPLING = "sampling"
LOOKED_AT = 12  # configurations of a run at which the sampled loop is linearised

__all__ = ["Record", "Verdict", "conclude", "judge"]


@dataclass(frozen=True)
class Verdict:
    """What a run says of the theory. kind: whether V fell as proven, down to the floor that hold and noise predict.

    causes: why not, the strongest first, out of "model mismatch", "saturation", "delay", "loss", "sampling"; none
    where no cause can be told. sentence: both in words. figures: what it is drawn from, by name. findings: what is
    wrong with the robot or its signals, by joint, side and kind.
    """

    kind: Literal["holding", "violated", "unknown"]
    causes: tuple[str, ...]
    sentence: str
    figures: dict[str, float]
    findings: tuple[Finding, ...] = ()


def judge(record: Record, law: TrackingLaw, beta: float | None = None, joints: Sequence[str] | None = ()) -> Verdict:
    """Return the verdict on a record, with the faults that explain it.

    beta [1/s]: the rate to judge by, None: the law's at configurations of the run. joints: names (n,) for the findings;
    None: look for none, where velocities are an observer's, which knows no fault.
    """
    verdict = _judged(record, law, beta)
    if joints is None or not np.isfinite(record.velocity).any():
        return verdict
    elsewhere = verdict.kind == "violated" and "model mismatch" not in verdict.causes
    findings = tuple(each for each in isolate(record, law, joints) if not (elsewhere and each.kind == UNKNOWN))
    sentence = "; ".join([verdict.sentence, *(each.sentence for each in findings)])
    return replace(verdict, sentence=sentence, findings=findings)


def _judged(record: Record, law: TrackingLaw, beta: float | None) -> Verdict:
    """Return the verdict without findings."""
    if not np.isfinite(record.velocity).any():
        return unknown("the states hold no velocities")
    found = intervals(record, Balance(law), Prediction(law))
    if not len(found):
        return unknown("no two states follow one another of which the first was answered")
    visited = _visited(record.jets[:, 0])
    radius = float(linearize(law, visited).radii(float(np.median(found.dt))).max())
    acted = acting(found, effort_age(found, law.robot), needed(found, law.robot))
    figures = {**_figures(found, acted, record), "spectral radius": radius}
    if radius >= 1 and _stays(found.V1):
        return violated((SAMPLING,), figures)
    if len(found) < FEWEST * BLOCK:
        return unknown(f"{len(found)} answered states follow one another; expected {FEWEST * BLOCK}", figures)
    beta = law.rate(visited).beta if beta is None else beta
    blocks = supplies(found, acted, law.robot, beta, record.sample_period, record.effort_limit)
    return conclude(blocks, figures)


def conclude(blocks: Supplies, figures: dict[str, float] | None = None) -> Verdict:
    """The verdict on blocks of a loop whose sample period is short enough."""
    judged = int(blocks.judged.sum())
    if judged < max(FEWEST, JUDGED * len(blocks.judged)):
        return unknown("the effort sent was seldom the law's", figures)
    causes = np.maximum(blocks.causes[blocks.judged], 0.0)
    allowed = blocks.slack + PREDICTED * (blocks.hold + blocks.noise)
    above = causes.sum(axis=1) > allowed[blocks.judged]
    share = float(above.mean())
    figures = {**(figures or {}), "blocks": float(judged), "violated share": share}
    strongest = np.bincount(np.argmax(causes[above], axis=1), minlength=len(CAUSES)) / max(1, int(above.sum()))
    figures |= {f"violated by {cause}": float(strongest[i] * share) for i, cause in enumerate(CAUSES)}
    if share < SHARE or above.sum() < FEWEST:
        return Verdict("holding", (), "V falls as proven, down to the floor that hold and noise predict", figures)
    order = np.argsort(-strongest, kind="stable")
    return violated(tuple(CAUSES[i] for i in order if strongest[i] >= CAUSE_SHARE), figures)


def unknown(reason: str, figures: dict[str, float] | None = None) -> Verdict:
    """No verdict, with the reason."""
    return Verdict("unknown", (), f"no verdict: {reason}", figures or {})


_WORDS = {
    "model mismatch": "the robot is not the model: links or motors have torques that their equations do not know",
    "saturation": "the effort was cut off at a limit",
    "delay": "the effort acted late",
    "loss": "states or efforts were lost",
    SAMPLING: "the loop is unstable at this sample period",
}


def violated(causes: tuple[str, ...], figures: dict[str, float]) -> Verdict:
    """V does not fall as proven, with the causes, the strongest first."""
    why = "; ".join(_WORDS[cause] for cause in causes) or "no cause can be told"
    return Verdict("violated", causes, f"V does not fall as proven: {why}", figures)


def _figures(found: Intervals, acted: Acting, record: Record) -> dict[str, float]:
    return {
        "intervals": float(len(found)),
        "effort age": acted.age * float(np.median(found.dt)),
        "gaps": float((found.dt > GAP * record.sample_period).sum()),
        "unanswered": float((~found.answered).sum()),
        "largest V": float(found.V1.max()),
        "last V": float(found.V1[-1]),
    }


def _stays(V: Array) -> bool:
    """Whether V has not fallen from the first third to the last."""
    third = max(1, len(V) // 3)
    return bool(V[-third:].max() >= FALLEN * V[:third].max())


def _visited(q_l: Array) -> Array:
    """Some of the reference's configurations (k, n): a robot that has left it may be anywhere."""
    known = q_l[np.isfinite(q_l).all(axis=1)]
    return known[:: max(1, len(known) // LOOKED_AT)]
