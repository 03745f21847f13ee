# SPDX-License-Identifier: Apache-2.0
"""The diagnosis of the last second as a DiagnosticStatus."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

LEVELS = {
    "holding": DiagnosticStatus.OK,
    "degraded": DiagnosticStatus.WARN,
    "violated": DiagnosticStatus.ERROR,
    "unknown": DiagnosticStatus.OK,
}
"""Level of the status by kind of the diagnosis."""


def diagnosis_status(
    name: str, kind: str, causes: Sequence[str], sentence: str, figures: Mapping[str, float]
) -> DiagnosticStatus:
    """Return the status `name` of a diagnosis of this kind, with its causes and its finite figures."""
    values = {"verdict": kind, "causes": ", ".join(causes)}
    values |= {key: f"{value:.6g}" for key, value in figures.items() if math.isfinite(value)}
    return DiagnosticStatus(
        level=LEVELS[kind],
        name=name,
        message=f"Degraded: {sentence}" if kind == "degraded" else sentence,
        values=[KeyValue(key=key, value=value) for key, value in values.items()],
    )
