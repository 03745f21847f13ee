# SPDX-License-Identifier: Apache-2.0
"""Diagnose a recorded run as holding, degraded, violated or unknown: whether V decayed as guaranteed, else the causes.

Only measured states and sent efforts are used.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from ..control.vdpbc.law import TrackingLaw
from ..numerics.checks import Array
from ..numerics.one_line import brief
from ..stability.linearization import linearize
from . import thresholds
from .cause_errors import CauseErrors, cause_errors, closed_loop
from .certificate import Certificate, CertificateSeries
from .delay_estimation import Acting, acting, effort_delay
from .fault_isolation.isolation import UNKNOWN, Finding, isolate
from .grading import Axes, Grade, detail, grade
from .innovations import Innovations, innovations, needed
from .one_step_prediction import Prediction
from .record import Record
from .storage_budget import CAUSES, StorageBudget, storage_budget
from .storage_growth import floor, growth, rises

SAMPLING, SATURATION = "sampling", "saturation"
CONFIGURATIONS = 12  # of a run at which the sampled loop is linearised


@dataclass(frozen=True)
class Diagnosis:
    """Result of comparing V with its guaranteed decay.

    kind: "holding": V decayed as guaranteed, to the floor that hold and noise predict. "degraded": V exceeds the floor
    and the resulting tracking error is within the tolerance. "violated": it is not, or V grew. "unknown": too few
    data. causes: of the violating blocks, the strongest first, out of "model mismatch", "saturation",
    "delay", "loss", "sampling"; empty if none is known. sentence: kind and causes as text. figures: the underlying
    numbers by name. errors: the tracking error (n,) [rad; m if the joint slides] that each cause makes.
    detail: causes with the largest of these, e.g. "delay makes 0.14 mrad at joint2". findings: faults of the robot or
    its signals, by joint, side and kind.
    """

    kind: Literal["holding", "degraded", "violated", "unknown"]
    causes: tuple[str, ...]
    sentence: str
    figures: dict[str, float]
    errors: dict[str, Array] = field(default_factory=dict, compare=False)
    detail: str = ""
    findings: tuple[Finding, ...] = ()

    def __repr__(self) -> str:
        return f"Diagnosis({self.kind}: {brief(self.sentence)})"


def diagnose(
    record: Record,
    law: TrackingLaw,
    beta: float | None = None,
    axes: Axes | None = None,
    velocities_measured: bool = True,
    series: CertificateSeries | None = None,
) -> Diagnosis:
    """Diagnose a record and isolate the faults that explain it.

    beta [1/s]: guaranteed rate of V; None: the rate of the law at configurations of the record. axes: names, units and
    tolerances of the joints; None: Axes.plain. velocities_measured: false if an observer estimates them; faults are
    then not isolated, nor in a loop that is unstable at its sample period. series: certificate of the law along the
    record; None: it is computed here.
    """
    axes = axes or Axes.plain(law.robot.n)
    if not np.isfinite(record.velocity).any():
        return unknown("the states hold no velocities")
    with np.errstate(all="ignore"):  # a diverging run overflows; the comparisons below allow for it
        found = innovations(record, Certificate(law), Prediction(law), series)
        diagnosis = _diagnosis(record, found, law, beta, axes)
        if not velocities_measured or SAMPLING in diagnosis.causes:
            return diagnosis  # the model needs measured velocities and close samples
        findings = isolate(record, law, axes.names, found)
    explained = diagnosis.kind in ("degraded", "violated") and "model mismatch" not in diagnosis.causes
    findings = tuple(each for each in findings if not (explained and each.kind == UNKNOWN))
    sentence = "; ".join([diagnosis.sentence, *(each.sentence for each in findings)])
    return replace(diagnosis, sentence=sentence, findings=findings)


def _diagnosis(record: Record, found: Innovations, law: TrackingLaw, beta: float | None, axes: Axes) -> Diagnosis:
    """Diagnose a record with velocities, without isolating faults."""
    if not len(found):
        return unknown("no state with a command is followed by another state")
    visited, period = _visited(record.jets[:, 0]), float(np.median(found.dt))
    radius = float(linearize(law, visited).radii(period).max())
    acted = acting(found, effort_delay(found, law.robot), needed(found, law.robot))
    figures = {**_figures(found, acted, record), "spectral radius": radius}
    if radius >= 1 and not _decayed(found.V1):
        return violated((SAMPLING,), figures)
    beta = law.rate(visited).beta if beta is None else beta
    decay = float(np.exp(-2 * beta * thresholds.BLOCK * period))
    blocks = storage_budget(found, acted, law.robot, beta, record.sample_period, record.effort_limit)
    loops = closed_loop(law, visited, period)
    made, _ = cause_errors(found, acted, law.robot, record.sample_period, record.effort_limit, loops)
    grown = growth(rises(found, record.effort_limit), floor(blocks, decay, axes.storage(law)))
    return conclude(blocks, made, grown, decay, axes, figures)


def conclude(
    blocks: StorageBudget, made: CauseErrors, grown: float, decay: float, axes: Axes, figures: dict[str, float]
) -> Diagnosis:
    """Diagnose the blocks of a loop that is stable at its sample period.

    made: tracking errors by cause in the same blocks. grown: growth of V over its lowest value and its floor.
    decay: guaranteed factor of V in a block. figures: further numbers to report.
    """
    judged = int(blocks.judged.sum())
    above, share, strongest = _violating(blocks)
    figures = {**figures, "blocks": float(judged), "violated share": share, "growth of V": grown}
    figures |= {f"violated by {cause}": float(strongest[i] * share) for i, cause in enumerate(CAUSES)}
    order = np.argsort(-strongest, kind="stable")
    causes = tuple(CAUSES[i] for i in order if strongest[i] >= thresholds.CAUSE_SHARE)
    if grown > thresholds.DIVERGED:
        return diverged(causes or _hold(blocks), figures)
    if len(blocks.judged) < thresholds.FEWEST:
        states = int(figures.get("intervals", len(blocks.judged) * thresholds.BLOCK))
        fewest = thresholds.FEWEST * thresholds.BLOCK
        return unknown(f"{states} consecutive states with a command; expected {fewest}", figures)
    if judged < max(thresholds.FEWEST, thresholds.JUDGED * len(blocks.judged)):
        return unknown("most efforts sent are not those of the law", figures)
    found = grade(made, blocks.judged, decay, axes.tolerance)
    often = share >= thresholds.HIGH_SHARE or (share >= thresholds.SHARE and above >= thresholds.FEWEST)
    if grown > thresholds.EXCEEDED or often:
        return graded(causes, found, axes, figures)
    if share > thresholds.SHARE_OF_FEW:
        return unknown(f"V exceeds its floor in {above} of {judged} blocks; expected more blocks", figures)
    sentence = "V decays as guaranteed, down to the floor that hold and noise predict"
    return Diagnosis("holding", (), sentence, figures, found.errors)


def _violating(blocks: StorageBudget) -> tuple[int, float, Array]:
    """Return the number of violated blocks, their share, and the share (4,) of them that each cause dominates.

    Only blocks with `judged` count.
    """
    causes = np.maximum(blocks.causes[blocks.judged], 0.0)
    allowed = (blocks.slack + thresholds.PREDICTED * (blocks.hold + blocks.noise))[blocks.judged]
    above = ~(causes.sum(axis=1) <= allowed)
    count = int(above.sum())
    strongest = np.bincount(np.argmax(causes[above], axis=1), minlength=len(CAUSES)) / max(1, count)
    return count, count / max(1, len(above)), strongest


def _hold(blocks: StorageBudget) -> tuple[str, ...]:
    """Return the sample period as the cause if the ideal sampled loop added more to V than the decay removed."""
    return (SAMPLING,) if blocks.hold.sum() > blocks.slack.sum() else ()


def unknown(reason: str, figures: dict[str, float] | None = None) -> Diagnosis:
    """Return "unknown" with the reason."""
    return Diagnosis("unknown", (), f"no diagnosis: {reason}", figures or {})


_EXPLANATIONS = {
    "model mismatch": "the robot differs from the model: torques act on links or motors that the model lacks",
    SATURATION: "the effort was saturated at a limit",
    "delay": "the effort acted late",
    "loss": "states or efforts were lost",
    SAMPLING: "the loop is unstable at this sample period",
}


def graded(causes: tuple[str, ...], found: Grade, axes: Axes, figures: dict[str, float]) -> Diagnosis:
    """Return "degraded" for known causes whose errors are within the tolerance, otherwise "violated"."""
    size, why = detail(causes, found.errors, axes), _why(causes)
    if causes and found.within and SATURATION not in causes:
        sentence = f"{size}, within the tolerance: {why}"
        return Diagnosis("degraded", causes, sentence, figures, found.errors, size)
    sentence = f"V does not decay as guaranteed: {why}" + (f"; {size}" if size else "")
    return Diagnosis("violated", causes, sentence, figures, found.errors, size)


def violated(causes: tuple[str, ...], figures: dict[str, float]) -> Diagnosis:
    """Return "violated" with the causes, the strongest first."""
    sentence = f"V does not decay as guaranteed: {_why(causes)}"
    return Diagnosis("violated", causes, sentence, figures, {}, ", ".join(causes))


def diverged(causes: tuple[str, ...], figures: dict[str, float]) -> Diagnosis:
    """Return "violated" for a run in which V grew."""
    sentence = f"V grew to {figures['growth of V']:.2g} times its floor: {_why(causes)}"
    return Diagnosis("violated", causes, sentence, figures, {}, ", ".join(causes))


def _why(causes: tuple[str, ...]) -> str:
    return "; ".join(_EXPLANATIONS[cause] for cause in causes) or "the cause is unknown"


def _figures(found: Innovations, acted: Acting, record: Record) -> dict[str, float]:
    return {
        "intervals": float(len(found)),
        "effort age": acted.age * float(np.median(found.dt)),
        "gaps": float((found.dt > thresholds.GAP * record.sample_period).sum()),
        "unanswered": float((~found.answered).sum()),
        "largest V": float(found.V1.max()),
        "last V": float(found.V1[-1]),
    }


def _decayed(V: Array) -> bool:
    """Return whether V decreased from the first third of the run to the last."""
    third = max(1, len(V) // 3)
    return not V[-third:].max() >= thresholds.FALLEN * V[:third].max()


def _visited(q_l: Array) -> Array:
    """Return about CONFIGURATIONS configurations (k, n) of the reference; a diverging robot may be anywhere else."""
    known = q_l[np.isfinite(q_l).all(axis=1)]
    return known[:: max(1, len(known) // CONFIGURATIONS)]
