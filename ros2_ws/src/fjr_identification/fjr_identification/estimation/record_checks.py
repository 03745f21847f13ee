# SPDX-License-Identifier: Apache-2.0
"""Find what contradicts a record: sides swapped, gear ratio, sign, unit, order of joints, a clipped effort."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator

from fjr_core.errors import RecordError
from fjr_core.model.robot import Robot

from . import continuity_checks, joint_checks, motion_checks, scale_checks, signal_checks
from .finding import Finding
from .motion_record import MotionRecord
from .rigid_motion import rigid_motion


def findings(record: MotionRecord, robot: Robot, accepted: Collection[str] = ()) -> tuple[Finding, ...]:
    """Return what contradicts the record, up to the first kind that is not accepted: a wrong unit causes many others.

    Raises RecordError for a record of another number of joints.
    """
    if len(record.joints) != robot.n:
        raise RecordError(f"{record.name} has {len(record.joints)} joints; expected {robot.n}, as the robot")
    found: list[Finding] = []
    for check in _checks(record, robot):
        found += check
        if any(each.kind not in accepted for each in found):
            break
    return tuple(found)


def _checks(record: MotionRecord, robot: Robot) -> Iterator[Iterable[Finding]]:
    """Yield the findings of each check, the most fundamental one first."""
    yield signal_checks.short(record)
    yield signal_checks.rest(record)
    yield signal_checks.constant(record)
    yield continuity_checks.same_sides(record)
    yield continuity_checks.jumps(record)
    yield continuity_checks.stuck(record)
    yield joint_checks.crossed_sides(record)
    motion = rigid_motion(record, robot)
    yield motion_checks.degrees(record, robot, motion)
    yield motion_checks.skews(record, motion)
    yield motion_checks.sides(record, robot, motion)
    yield motion_checks.swapped(record, robot, motion)
    yield joint_checks.crossed(record, robot, motion)
    yield motion_checks.efforts(record, motion)
    yield joint_checks.turned(record, robot, motion)
    yield signal_checks.clipped(record)
    yield scale_checks.scales(record, robot)
