# SPDX-License-Identifier: Apache-2.0
"""A contradiction of a record, with itself or with the robot."""

from __future__ import annotations

from dataclasses import dataclass

AT_REST, CONSTANT, TOO_SHORT, CLIPPED = "at_rest", "constant", "too_short", "clipped"
DEGREES, GEAR_RATIO, SIGN, SWAPPED, SCALE = "degrees", "gear_ratio", "sign", "swapped_sides", "effort_scale"
JUMP, STUCK, SKEW, ORDER, TIME = "jump", "stuck", "skew", "joint_order", "time_scale"
KINDS = (
    TOO_SHORT,
    AT_REST,
    CONSTANT,
    JUMP,
    STUCK,
    DEGREES,
    ORDER,
    GEAR_RATIO,
    SIGN,
    SKEW,
    SWAPPED,
    SCALE,
    TIME,
    CLIPPED,
)


@dataclass(frozen=True)
class Finding:
    """A contradiction: its kind, the joint ("" for all) and a sentence with what was seen and expected."""

    kind: str
    joint: str
    sentence: str
