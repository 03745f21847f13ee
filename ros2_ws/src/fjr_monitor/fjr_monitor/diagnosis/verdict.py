# SPDX-License-Identifier: Apache-2.0
"""The verdict on a loop: whether V decayed as guaranteed, the causes if it did not, and the faults that explain it.

Blocks are counted and graded by the decay of V, by the tracking error, and by the error that is foreseen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fjr_core.numerics.checks import Array
from fjr_core.numerics.one_line import brief
from fjr_core.runtime.events import Finding
from fjr_msgs_py.console.output import percent, plural

from . import thresholds
from .causes import CAUSES, LOSS, MISMATCH, SATURATION, CauseErrors, StorageBudget
from .thresholds import BLOCK, JointTolerances

SAMPLING, NOISE, EXTERNAL = "sampling", "noise", "external torque"
NO_DECAY = "V does not decay as guaranteed"
HOLDING = "V decays as guaranteed, down to the floor that hold and noise predict"
PARTS = (*CAUSES, NOISE, SAMPLING)
"""What the tracking error consists of; the last two are what the model foresees."""
_EXPLANATIONS = {
    MISMATCH: "the robot differs from the model: torques act on links or motors that the model lacks",
    EXTERNAL: "torques from outside act on the links for part of the time, as in contact",
    SATURATION: "the effort was saturated at a limit",
    "delay": "the effort acted late",
    "loss": "states or efforts were lost",
    SAMPLING: "the effort is held too long, at this sample period or while states are missing",
    NOISE: "noise of the sensors moves the robot",
}


@dataclass(frozen=True)
class Diagnosis:
    """Result of comparing V with its guaranteed decay.

    kind: "holding": V decayed as guaranteed, to the floor that hold and noise predict. "degraded": V exceeds the floor
    and the resulting tracking error is within the tolerance. "violated": it is not, or V grew. "unknown": too few
    data. causes: of the violating blocks, the strongest first, out of "model mismatch", "external torque",
    "saturation", "delay", "loss", "sampling"; empty if none is known. sentence: kind and causes as text. figures: the
    underlying numbers by name. errors: the tracking error (n,) [rad; m if the joint slides] that each cause makes.
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


def unknown(reason: str, figures: dict[str, float] | None = None) -> Diagnosis:
    """Return "unknown" with the reason."""
    return Diagnosis("unknown", (), f"no diagnosis: {reason}", figures or {})


def violated(what: str, causes: tuple[str, ...], figures: dict[str, float], why: str = "") -> Diagnosis:
    """Return "violated" with what was seen, the causes, the strongest first, and why; "": a sentence for each cause."""
    return Diagnosis("violated", causes, f"{what}: {why or explained(causes)}", figures, {}, ", ".join(causes))


def external(diagnosis: Diagnosis) -> Diagnosis:
    """Return a diagnosis of which external torques explain the mismatch, or that nothing else explains."""

    def said(text: str) -> str:
        return text.replace(_EXPLANATIONS[MISMATCH], _EXPLANATIONS[EXTERNAL]).replace(MISMATCH, EXTERNAL)

    if not diagnosis.causes and diagnosis.kind != "holding":
        return replace(diagnosis, causes=(EXTERNAL,), detail=EXTERNAL)
    causes, errors = map(said, diagnosis.causes), {said(cause): size for cause, size in diagnosis.errors.items()}
    sentence, detailed = said(diagnosis.sentence), said(diagnosis.detail)
    return replace(diagnosis, causes=tuple(causes), errors=errors, sentence=sentence, detail=detailed)


def explained(causes: tuple[str, ...]) -> str:
    """Return a sentence for each cause."""
    return "; ".join(_EXPLANATIONS[cause] for cause in causes) or "the cause is unknown"


def detail(causes: Sequence[str], errors: dict[str, Array], axes: JointTolerances) -> str:
    """Format causes with the error due to each: "delay makes 0.14 mrad at joint2, sampling"."""
    return ", ".join(f"{cause} makes {axes.largest(errors[cause])}" if cause in errors else cause for cause in causes)


class BlockStatistics:
    """The blocks of a loop that is stable at its sample period, counted."""

    def __init__(self, decay: float, axes: JointTolerances) -> None:
        """decay: guaranteed factor of V in a block."""
        self._decay, self._axes = decay, axes
        n = len(axes.tolerance)
        self._envelope, self._transient = np.zeros(n), np.full(n, np.inf)
        self._settled, self._measured = np.zeros((len(PARTS), n)), np.zeros(n)
        self._graded = np.zeros(2, dtype=bool)  # whether any block is judged; of these, any outside a transient
        self._within = np.ones(2, dtype=bool)
        self._errors = np.zeros((2, len(CAUSES), n))
        self._blocks = self._counted = self._above = 0
        self._strongest = np.zeros(len(CAUSES), dtype=int)
        self._hold = self._slack = self._missing = 0.0
        self._added: list[Array] = []

    def add(self, blocks: StorageBudget, made: CauseErrors) -> None:
        """Add blocks and the tracking errors by cause in them; only those with `judged` can be violated."""
        causes = np.maximum(blocks.causes[blocks.judged], 0.0)
        allowed = (blocks.slack + thresholds.PREDICTED * (blocks.hold + blocks.noise))[blocks.judged]
        above = ~(causes.sum(axis=1) <= allowed)
        self._blocks += len(blocks.judged)
        self._counted += len(above)
        self._above += int(above.sum())
        self._strongest += np.bincount(np.argmax(causes[above], axis=1), minlength=len(CAUSES))
        self._hold += float(blocks.hold.sum())
        self._slack += float(blocks.slack.sum())
        self._missing += float(blocks.missing.sum())
        self._added.append(blocks.hold + blocks.noise)
        self._grade(made, blocks.judged)
        self._settle(made, blocks.judged)

    def _grade(self, made: CauseErrors, judged: NDArray[np.bool_]) -> None:
        """Keep the largest error (n,) due to each cause in the judged blocks, and in those outside a transient.

        The loop's own error is bounded by an envelope that decays from block to block with the square root of the
        guaranteed factor of V. A block belongs to a transient if that envelope exceeds both the tolerance (n,) and the
        errors due to the causes; if all judged blocks do, all count. Within the tolerance: the errors due to the causes
        are at most the tolerance plus RELATIVE times the envelope.
        """
        total, own, tolerance = made.peaks.sum(axis=1), made.own.copy(), self._axes.tolerance
        for value in own:  # the running maximum, multiplied by the decay from block to block
            np.maximum(value, np.sqrt(self._decay) * self._envelope, out=value)
            self._envelope = value
        settled = judged & ~((own > tolerance) & (own > total)).any(axis=1)
        within = (total <= tolerance + thresholds.RELATIVE * own).all(axis=1)
        for i, rows in enumerate((judged, settled)):
            self._graded[i] |= rows.any()
            self._within[i] &= within[rows].all()
            self._errors[i] = np.maximum(self._errors[i], made.peaks[rows].max(axis=0, initial=0.0))

    def _settle(self, made: CauseErrors, judged: NDArray[np.bool_]) -> None:
        """Keep the largest error (n,), and of each of PARTS, in the blocks after the decay of the initial error.

        The loop's own error at the start of judged blocks, times OVERSHOOT, decays with the guaranteed rate.
        """
        rows = np.zeros(len(judged), dtype=bool)
        for k, own in enumerate(made.own):
            running = np.isfinite(self._transient).all()
            started = np.sqrt(self._decay) * self._transient if running else thresholds.OVERSHOOT * own
            self._transient = started if judged[k] else np.full_like(own, np.inf)
            rows[k] = judged[k] and (started <= self._axes.tolerance).all()
        parts = np.concatenate([made.peaks, made.noise[:, None], made.own[:, None]], axis=1)
        self._settled = np.maximum(self._settled, parts[rows].max(axis=0, initial=0.0))
        self._measured = np.maximum(self._measured, made.measured[rows].max(axis=0, initial=0.0))

    def floor(self, tolerated: float) -> float:
        """Return the storage [J] that hold, noise and the tolerated tracking error explain.

        tolerated [J]: storage of the tolerated error. The remainder is the level at which the decay in a block equals
        the lower quartile of what hold and noise add. The quartile keeps a diverging loop from raising its own floor.
        """
        if not self._blocks:
            return tolerated
        added = np.concatenate(self._added)
        explained = np.quantile(np.where(np.isfinite(added), added, np.finfo(float).max), 0.25)
        return tolerated + thresholds.PREDICTED * float(explained) / max(1 - self._decay, np.finfo(float).eps)

    def conclude(self, grown: float, figures: dict[str, float]) -> Diagnosis:
        """Diagnose the blocks; grown: growth of V over its lowest value and its floor. figures: further numbers."""
        share, strongest = self._above / max(1, self._counted), self._strongest / max(1, self._above)
        figures = {**figures, "blocks": float(self._counted), "violated share": share, "growth of V": grown}
        figures["lost commands"] = self._missing / max(1, self._blocks * BLOCK)
        figures |= {f"violated by {cause}": float(strongest[i] * share) for i, cause in enumerate(CAUSES)}
        order = np.argsort(-strongest, kind="stable")
        causes = tuple(CAUSES[i] for i in order if strongest[i] >= thresholds.CAUSE_SHARE)
        if grown > thresholds.DIVERGED:  # the hold is the cause if it added more to V than the decay removed
            causes = causes or ((SAMPLING,) if self._hold > self._slack else ())
            return violated(f"V grew to {grown:.2g} times its floor", causes, figures, self._explained(causes))
        if self._blocks < thresholds.FEWEST:
            seen = plural(int(figures.get("intervals", self._blocks * BLOCK)), "interval")
            fewest = thresholds.FEWEST * BLOCK
            return unknown(f"{seen} between states with a command; expected {fewest}", figures)
        if self._counted < max(thresholds.FEWEST, thresholds.JUDGED * self._blocks):
            return unknown("most efforts sent are not those of the law", figures)
        which = int(self._graded[1])
        errors = dict(zip(CAUSES, self._errors[which], strict=True)) if self._graded[which] else {}
        often = share >= thresholds.HIGH_SHARE or (share >= thresholds.SHARE and self._above >= thresholds.FEWEST)
        if grown > thresholds.EXCEEDED or often:
            size, why = detail(causes, errors, self._axes), self._explained(causes)
            if causes and self._within[which] and SATURATION not in causes:
                sentence = f"{size}, within the tolerance: {why}"
                return Diagnosis("degraded", causes, sentence, figures, errors, size)
            sentence = f"{NO_DECAY}: {why}" + (f"; {size}" if size else "")
            return Diagnosis("violated", causes, sentence, figures, errors, size)
        if share > thresholds.SHARE_OF_FEW:
            few = f"V exceeds its floor in {self._above} of {self._counted} blocks; expected more blocks"
            return unknown(few, figures)
        return self._exceeding(figures) or Diagnosis("holding", (), HOLDING, figures, errors)

    def _explained(self, causes: tuple[str, ...]) -> str:
        """Return a sentence for each cause, with the share of the commands that were lost."""
        share = self._missing / max(1, self._blocks * BLOCK) if LOSS in causes else 0.0
        return explained(causes) + (f"; about {percent(share, 1)} of the commands never acted" if share else "")

    def _exceeding(self, figures: dict[str, float]) -> Diagnosis | None:
        """Return the diagnosis of a settled error beyond the tolerance or what is foreseen; None if it is not."""
        measured, tolerance = self._measured, self._axes.tolerance
        foreseen = self._settled[len(CAUSES) :].sum(axis=0)
        unforeseen = measured > np.maximum(thresholds.FORESEEN * foreseen, thresholds.UNSEEN * tolerance)
        beyond = measured > tolerance
        if not (beyond | unforeseen).any():
            return None
        worst = int(np.argmax(np.where(beyond | unforeseen, measured / tolerance, 0.0)))
        errors = dict(zip(PARTS, self._settled, strict=True))
        errors[MISMATCH] = np.where(unforeseen, errors[MISMATCH] - errors[NOISE], 0.0)
        possible = np.array([errors[part][worst] for part in (PARTS if beyond.any() else CAUSES)])
        largest = possible / possible.sum()
        causes = tuple(PARTS[i] for i in np.argsort(-largest, kind="stable") if largest[i] >= thresholds.CAUSE_SHARE)
        size, why = detail(causes, errors, self._axes), self._explained(causes)
        what = "exceeds the tolerance" if beyond.any() else "is more than twice the one that the model foresees"
        sentence = f"the tracking error of {self._axes.largest(measured)} {what}: {why}; {size}"
        return Diagnosis("violated" if beyond.any() else "degraded", causes, sentence, figures, errors, size)
