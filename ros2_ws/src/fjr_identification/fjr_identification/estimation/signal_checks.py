# SPDX-License-Identifier: Apache-2.0
"""Check the signals of a record by themselves: length, motion, constant columns, clipped efforts."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fjr_core.numerics.checks import Array

from .finding import AT_REST, CLIPPED, CONSTANT, TOO_SHORT, Finding
from .motion_record import MotionRecord

SHORTEST = 200  # samples
LEAST_MOTION = 1e-4  # rad or m, peak to peak
CLIPPED_RUN = 3  # times as many samples in a row at the extreme value as at others
PEAK = 50  # steps of resolution; a parabola falls by 9 where it has left its peak for as long as it stayed there


def still_joints(record: MotionRecord) -> tuple[str, ...]:
    """Return the joints that stand still."""
    return tuple(joint for joint, each in zip(record.joints, _ranges(record), strict=True) if each < LEAST_MOTION)


def _ranges(record: MotionRecord) -> Array:
    """Return the range of the positions of each joint (n,), of the side that moves further."""
    with np.errstate(all="ignore"):
        return np.nan_to_num(np.fmax(np.ptp(record.q_l, axis=0), np.ptp(record.q_m, axis=0)))


def short(record: MotionRecord) -> Iterator[Finding]:
    """Find a record of too few samples."""
    if len(record.u) < SHORTEST:
        yield Finding(TOO_SHORT, "", f"the record has {len(record.u)} samples; expected at least {SHORTEST}")


def rest(record: MotionRecord) -> Iterator[Finding]:
    """Find a record in which no joint moves."""
    largest = float(np.max(_ranges(record)))
    if largest < LEAST_MOTION:
        yield Finding(AT_REST, "", f"no joint moves by more than {largest:.2g} rad; expected a record of motion")


def constant(record: MotionRecord) -> Iterator[Finding]:
    """Find columns that never change although the joint moves."""
    still = still_joints(record)
    for j, joint in enumerate(record.joints):
        for name in ("q_l", "q_m", "torque", "u"):
            values = getattr(record, name)[:, j]
            if joint not in still and np.all(np.isfinite(values)) and np.ptp(values) == 0:
                sentence = f"{name} of {joint} is {values[0]:.6g} at every sample; expected a changing signal"
                yield Finding(CONSTANT, joint, sentence)


def clipped(record: MotionRecord) -> Iterator[Finding]:
    """Find efforts that stay at their extreme values for longer than a smooth peak of this resolution."""
    for j, joint in enumerate(record.joints):
        u = record.u[:, j]
        if not np.ptp(u):
            continue
        usual = float(np.median(_runs(u)))
        steps = np.abs(np.diff(u))
        resolution = float(np.min(steps[steps > 0]))
        for extreme in (np.max(u), np.min(u)):
            start, length = _longest_run(u == extreme)
            beside = [u[i] for i in (start - length, start + 2 * length - 1) if 0 <= i < len(u)]
            drop = max((abs(extreme - each) for each in beside), default=0.0)
            if length >= CLIPPED_RUN * usual and drop > PEAK * resolution:
                sentence = (
                    f"effort of {joint} is {extreme:.6g} N m at {np.mean(u == extreme):.1%} of the samples, up to "
                    f"{length} in a row; expected an effort that is not clipped"
                )
                yield Finding(CLIPPED, joint, sentence)


def _longest_run(at: Array) -> tuple[int, int]:
    """Return start and length of the longest run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], at, [False]])))
    starts, lengths = edges[::2], edges[1::2] - edges[::2]
    longest = int(np.argmax(lengths))
    return int(starts[longest]), int(lengths[longest])


def _runs(values: Array) -> Array:
    """Return the lengths of the runs of equal values, in order."""
    edges = np.flatnonzero(np.diff(values)) + 1
    return np.diff(np.concatenate([[0], edges, [len(values)]]))
