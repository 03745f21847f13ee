# SPDX-License-Identifier: Apache-2.0
"""Say which sensors the joints of records lack, what stays unknown without them, and which gear ratios are not seen.

docs/from_csv.md has the same sentences.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fjr_core.model.robot import Robot

from .estimation.motion_record import MotionRecord
from .scale_checks import least_seen

BY_RESONANCE = "only motion near its resonance reveals its stiffness"
LINK, MOTOR, TORQUE = "link encoder", "motor encoder", "torque sensor"
LACKING: Mapping[tuple[str, ...], str] = {
    (LINK,): "the torque sensor reveals the stiffness; the control law needs the link encoder",
    (LINK, TORQUE): f"{BY_RESONANCE}, only gravity the offset of its spring; the control law needs the link encoder",
    (MOTOR,): "the torque sensor replaces it; nothing reveals the offset of the spring",
    (MOTOR, TORQUE): f"{BY_RESONANCE}, nothing the offset of its spring; the control law needs one of the two",
}
"""What it means that a joint has none of these sensors."""
NOT_SEEN = "would not be noticed and would bias motor inertia, stiffness and friction"
"""What it means that one side only of a joint is measured."""


def lacking(records: Sequence[MotionRecord], robot: Robot) -> list[str]:
    """Return a sentence for each set of sensors that joints lack in all records, and one on gear ratios and times."""
    of_sensors: dict[tuple[str, ...], list[str]] = {}
    for j, joint in enumerate(records[0].joints):
        signals = {LINK: "q_l", MOTOR: "q_m", TORQUE: "torque"}
        there = {
            sensor: any(np.isfinite(getattr(record, name)[:, j]).any() for record in records)
            for sensor, name in signals.items()
        }
        absent = tuple(sensor for sensor in signals if not there[sensor])
        if absent in LACKING:
            of_sensors.setdefault(absent, []).append(joint)
    sentences = [
        f"{', '.join(joints)}: no {' and no '.join(absent)}: {LACKING[absent]}" for absent, joints in of_sensors.items()
    ]
    return [*sentences, *_not_seen(records, robot)]


def _not_seen(records: Sequence[MotionRecord], robot: Robot) -> list[str]:
    """Return a sentence on errors of gear ratios and times that no record shows; none if both sides are measured."""
    least: dict[str, list[tuple[float, float]]] = {}
    for record in records:
        for joint, factors in least_seen(record, robot).items():
            least.setdefault(joint, []).append(factors)
    if not least:
        return []
    ratios, times = zip(*(map(min, zip(*found, strict=True)) for found in least.values()), strict=True)
    return [
        f"{', '.join(least)}: one side only is measured: a wrong gear ratio ({_factors(ratios)}) or time scale "
        f"({_factors(times)}) {NOT_SEEN}"
    ]


def _factors(values: Sequence[float]) -> str:
    """Return the factors of the joints, in their order, from which on an error is seen, equal ones once."""
    texts = [f"{value:.3g}" if np.isfinite(value) else "any" for value in dict.fromkeys(values)]
    if "any" in texts:
        return ", ".join("any" if text == "any" else f"up to {text} times" for text in texts)
    return f"up to {', '.join(texts)} times"
