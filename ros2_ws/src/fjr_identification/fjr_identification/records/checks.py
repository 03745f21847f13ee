# SPDX-License-Identifier: Apache-2.0
"""Find what contradicts a record, the most fundamental first: here what its signals show by themselves.

Length, motion, constant columns, jumps, sensors that are stuck, clipped efforts. `motion_checks` compares signals with
each other and with the robot, `missing_sensors` those of joints with one measured side.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fjr_core.errors import RecordError
from fjr_core.model.joints import PRISMATIC, REVOLUTE
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array
from fjr_core.runtime.events import Finding

from ..estimation.motion_record import LEAST_MOTION, MotionRecord
from . import missing_sensors, motion_checks
from .rigid_motion import AT_REST, CLIPPED, CONSTANT, JUMP, STUCK, TOO_SHORT, contradiction, rigid_motion

SHORTEST = 200  # samples
CLIPPED_RUN = 3  # times as many samples in a row at the extreme value as at others
PEAK = 50  # steps of resolution; a parabola falls by 9 where it has left its peak for as long as it stayed there
SIGNALS = {"q_l": "rad", "q_m": "rad", "torque": "N m"}
BEND, LEAST_JUMP = 20.0, 0.01  # times the usual change of a step, and share of the signal's range
AROUND = 12  # samples on each side of a step
RUN, LEAST_RUN = 0.05, 10  # s and samples of a sensor that is stuck
LEAST_LOST = 0.1  # way at the speed before, relative to the signal's range
STEPS = 3.5  # of resolution; a joint that stops by itself takes smaller ones at last
SAME = 1e-9  # rad; two measurements differ by more


def findings(record: MotionRecord, robot: Robot, accepted: Collection[str] = ()) -> tuple[Finding, ...]:
    """Return what contradicts the record, up to the first kind that is not accepted: a wrong unit causes many others.

    Raises RecordError for a record of another number of joints.
    """
    if len(record.joints) != robot.n:
        raise RecordError(f"{record.name} has {len(record.joints)} joints; expected {robot.n}, as the robot")
    found: list[Finding] = []
    units = {
        "": REVOLUTE if REVOLUTE in robot.units else PRISMATIC,
        **dict(zip(record.joints, robot.units, strict=True)),
    }
    for of_check in _checks(record, robot):
        found += (replace(each, sentence=units.get(each.joint, REVOLUTE).of(each.sentence)) for each in of_check)
        if any(finding.kind not in accepted for finding in found):
            break
    return tuple(found)


def _checks(record: MotionRecord, robot: Robot) -> Iterator[Iterable[Finding]]:
    """Yield the findings of each check, the most fundamental one first."""
    yield from (check(record) for check in (short, rest, constant, jumps, stuck, motion_checks.crossed_sides))
    motion = rigid_motion(record, robot)
    yield from (check(motion) for check in motion_checks.IN_ORDER)
    yield clipped(record)
    yield missing_sensors.scales(record, robot)


def short(record: MotionRecord) -> Iterator[Finding]:
    """Find a record of too few samples."""
    if len(record.u) < SHORTEST:
        yield contradiction(TOO_SHORT, "", f"the record has {len(record.u)} samples", f"at least {SHORTEST}")


def rest(record: MotionRecord) -> Iterator[Finding]:
    """Find a record in which no joint moves."""
    largest = float(np.max(record.ranges))
    if largest < LEAST_MOTION:
        yield contradiction(AT_REST, "", f"no joint moves by more than {largest:.2g} rad", "a record of motion")


def constant(record: MotionRecord) -> Iterator[Finding]:
    """Find columns that never change although the joint moves, and one column that stands for both sides."""
    for j, joint in enumerate(record.joints):
        for name in ("q_l", "q_m", "torque", "u"):
            values = getattr(record, name)[:, j]
            if joint not in record.still and np.ptp(values) == 0:
                seen = f"{name} of {joint} is {values[0]:.6g} at every sample"
                yield contradiction(CONSTANT, joint, seen, "a changing signal")
        deflection = record.q_m[:, j] - record.q_l[:, j]
        if np.ptp(record.q_m[:, j]) > 0 and np.ptp(deflection) < SAME:
            seen = f"q_m - q_l of {joint} is constant at every sample"
            yield contradiction(CONSTANT, joint, seen, "two measurements")


def jumps(record: MotionRecord) -> Iterator[Finding]:
    """Find steps between samples that no smooth motion makes: a revolution, a spike.

    They bend a signal at few samples, a fast transient of a long record also at those before or after.
    """
    for name, joint, x in _changing(record):
        bends = np.abs(np.diff(x, n=2))
        i = int(np.argmax(bends))
        near = max(float(np.median(side)) for side in (bends[max(i - AROUND, 0) : i + 1], bends[i : i + 1 + AROUND]))
        usual = max(float(np.quantile(bends, 0.99)), near)
        limit = max(BEND * (usual + 2 * _resolution(x)), LEAST_JUMP * float(np.ptp(x)))
        if bends[i] > limit:
            at = i + 1 + int(np.argmax(np.abs(np.diff(x[i : i + 3]))))
            jump, t = f"{x[at] - x[at - 1]:.4g} {SIGNALS[name]}", f"{at * record.dt:.4g} s"
            seen = f"{name} of {joint} jumps by {jump} at sample {at} ({t})"
            yield contradiction(JUMP, joint, seen, "a continuous signal")


def stuck(record: MotionRecord) -> Iterator[Finding]:
    """Find sensors that keep a value from one sample to the next although the joint was moving."""
    least = max(LEAST_RUN, round(RUN / record.dt))
    for name, joint, x in _changing(record):
        steps = np.abs(np.diff(x))
        for start, length in zip(*_runs(steps == 0), strict=True):
            before = steps[max(0, start - LEAST_RUN) : start]
            if length < least or not len(before) or before.mean() * length < LEAST_LOST * np.ptp(x):
                continue
            if before[-1] > max(STEPS * _resolution(x), 0.3 * before.mean()):
                when = f"at {start * record.dt:.4g} s for {length * record.dt:.3g} s"
                seen = f"{name} of {joint} stops at {x[start]:.6g} {SIGNALS[name]} from one sample to the next, {when}"
                yield contradiction(STUCK, joint, seen, "it to slow down first")
                break


def clipped(record: MotionRecord) -> Iterator[Finding]:
    """Find efforts that stay at their extreme values for longer than a smooth peak of this resolution."""
    for j, joint in enumerate(record.joints):
        u = record.u[:, j]
        if not np.ptp(u):
            continue
        changes = np.flatnonzero(np.diff(u)) + 1
        usual = float(np.median(np.diff(np.concatenate([[0], changes, [len(u)]]))))
        for extreme in (np.max(u), np.min(u)):
            starts, lengths = _runs(u == extreme)
            start, length = int(starts[np.argmax(lengths)]), int(np.max(lengths))
            apart = [u[i] for i in (start - length, start + 2 * length - 1) if 0 <= i < len(u)]
            drop = max((abs(extreme - value) for value in apart), default=0.0)
            if length >= CLIPPED_RUN * usual and drop > PEAK * _resolution(u):
                often = f"{100 * np.mean(u == extreme):.1f} % of the samples, up to {length} in a row"
                seen = f"effort of {joint} is {extreme:.6g} N m at {often}"
                yield contradiction(CLIPPED, joint, seen, "an effort that is not clipped")


def _runs(at: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return starts and lengths of the runs of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], at, [False]])))
    return edges[::2], edges[1::2] - edges[::2]


def _changing(record: MotionRecord) -> Iterator[tuple[str, str, Array]]:
    """Yield the name, joint and values (k,) of each measured signal that changes."""
    for name in SIGNALS:
        for j, joint in enumerate(record.joints):
            x = getattr(record, name)[:, j]
            if np.ptp(x) > 0:
                yield name, joint, x


def _resolution(x: Array) -> float:
    """Return the smallest step of a signal."""
    steps = np.abs(np.diff(x))
    return float(np.min(steps[steps > 1e-12 * np.max(np.abs(x))], initial=np.inf))
