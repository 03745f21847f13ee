# SPDX-License-Identifier: Apache-2.0
"""The verdict on a recorded run, by fjr_core."""

from __future__ import annotations

from dataclasses import dataclass, field

from fjr_bringup.tracking_data import TrackingData
from fjr_core.scenario import Scenario


@dataclass(frozen=True)
class Verdict:
    """As in fjr_core."""

    kind: str
    causes: tuple[str, ...]
    sentence: str
    figures: dict[str, float] = field(default_factory=dict)


def verdict(data: TrackingData, scenario: Scenario) -> Verdict:
    """Whether the certificate held, and why not."""
    return Verdict("unknown", (), "no verdict yet")
