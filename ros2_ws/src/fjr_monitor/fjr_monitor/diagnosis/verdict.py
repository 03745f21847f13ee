# SPDX-License-Identifier: Apache-2.0
"""The verdict on a loop: whether V decayed as guaranteed, the causes if it did not, and the faults that explain it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from fjr_core.numerics.checks import Array
from fjr_core.numerics.one_line import brief
from fjr_core.runtime.events import Finding

from .thresholds import JointTolerances

SAMPLING, SATURATION, NOISE = "sampling", "saturation", "noise"
MISMATCH, EXTERNAL = "model mismatch", "external torque"
NO_DECAY = "V does not decay as guaranteed"
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


def violated(what: str, causes: tuple[str, ...], figures: dict[str, float]) -> Diagnosis:
    """Return "violated" with what was seen and the causes, the strongest first."""
    return Diagnosis("violated", causes, f"{what}: {explained(causes)}", figures, {}, ", ".join(causes))


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
