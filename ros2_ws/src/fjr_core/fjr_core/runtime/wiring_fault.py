# SPDX-License-Identifier: Apache-2.0
"""Faults of the wiring that the control step finds, and their sentences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

SENTENCES = {
    "effort sign": "the effort of {joints} acts with the wrong sign",
    "efforts exchanged": "the efforts of {joints} are exchanged",
    "encoder sign": "the {side} encoder of {joints} has the wrong sign",
    "encoders exchanged": "the {side} encoders of {joints} are exchanged",
    "velocity sign": "the {side} velocity of {joints} has the sign opposite to its position's slope",
    "velocity of another joint": "the {side} velocity of {first} is that of {last}",
}
"""Sentence of each kind of fault, in the order of enum fjr_wiring_kind in step.h."""
SIDES = ("link", "motor")


@dataclass(frozen=True, order=True)
class WiringFault:
    """Fault of the wiring.

    kind: one of SENTENCES. joints: indices, two if joints are exchanged. side: "link" or "motor".
    """

    kind: str
    joints: tuple[int, ...]
    side: str

    @classmethod
    def of(cls, found: Any) -> WiringFault | None:
        """Return a struct fjr_wiring_fault as a fault, None if it is none."""
        joints = tuple(found.joint[0 : found.count])
        return cls(list(SENTENCES)[found.kind], joints, SIDES[found.side]) if joints else None

    def sentence(self, names: Sequence[str]) -> str:
        """Describe the fault with the names of the joints."""
        named = [names[j] for j in self.joints]
        joints = " and ".join(named)
        return SENTENCES[self.kind].format(joints=joints, side=self.side, first=named[0], last=named[-1])
