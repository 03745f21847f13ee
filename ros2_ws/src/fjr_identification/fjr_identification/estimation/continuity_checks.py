# SPDX-License-Identifier: Apache-2.0
"""Check that measured signals belong to a continuous motion: no jumps, no spikes, no sensor that is stuck."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fjr_core.numerics.checks import Array

from .finding import CONSTANT, JUMP, STUCK, Finding
from .motion_record import MotionRecord

SIGNALS = {"q_l": "rad", "q_m": "rad", "torque": "N m"}
BEND, LEAST_JUMP = 20.0, 0.01  # times the usual change of a step, and share of the signal's range
RUN, LEAST_RUN = 0.05, 10  # s and samples of a sensor that is stuck
LEAST_LOST = 0.1  # way at the speed before, relative to the signal's range
STEPS = 3.5  # of resolution; a joint that stops by itself takes smaller ones at last
SAME = 1e-9  # rad; two measurements differ by more


def jumps(record: MotionRecord) -> Iterator[Finding]:
    """Find steps between samples that no smooth motion makes: a revolution, a spike."""
    for name, joint, x in _signals(record):
        bends = np.abs(np.diff(x, n=2))
        limit = max(BEND * (float(np.quantile(bends, 0.99)) + 2 * _resolution(x)), LEAST_JUMP * float(np.ptp(x)))
        i = int(np.argmax(bends))
        if bends[i] > limit:
            at = i + 1 + int(np.argmax(np.abs(np.diff(x[i : i + 3]))))
            sentence = (
                f"{name} of {joint} jumps by {x[at] - x[at - 1]:.4g} {SIGNALS[name]} at sample {at} "
                f"({at * record.dt:.4g} s); expected a continuous signal"
            )
            yield Finding(JUMP, joint, sentence)


def stuck(record: MotionRecord) -> Iterator[Finding]:
    """Find sensors that keep a value from one sample to the next although the joint was moving."""
    least = max(LEAST_RUN, round(RUN / record.dt))
    for name, joint, x in _signals(record):
        steps = np.abs(np.diff(x))
        edges = np.flatnonzero(np.diff(np.concatenate([[False], steps == 0, [False]])))
        for start, end in zip(edges[::2], edges[1::2], strict=True):
            before = steps[max(0, start - LEAST_RUN) : start]
            if end - start < least or not len(before) or before.mean() * (end - start) < LEAST_LOST * np.ptp(x):
                continue
            if before[-1] > max(STEPS * _resolution(x), 0.3 * before.mean()):
                sentence = (
                    f"{name} of {joint} stops at {x[start]:.6g} {SIGNALS[name]} from one sample to the next, at "
                    f"{start * record.dt:.4g} s for {(end - start) * record.dt:.3g} s; expected it to slow down first"
                )
                yield Finding(STUCK, joint, sentence)
                break


def same_sides(record: MotionRecord) -> Iterator[Finding]:
    """Find one column that stands for both sides of a joint."""
    for j, joint in enumerate(record.joints):
        deflection = record.q_m[:, j] - record.q_l[:, j]
        if np.all(np.isfinite(deflection)) and np.ptp(record.q_m[:, j]) > 0 and np.ptp(deflection) < SAME:
            sentence = f"q_m - q_l of {joint} is constant at every sample; expected two measurements"
            yield Finding(CONSTANT, joint, sentence)


def _signals(record: MotionRecord) -> Iterator[tuple[str, str, Array]]:
    """Yield the name, joint and values (k,) of each complete signal that changes."""
    for name in SIGNALS:
        for j, joint in enumerate(record.joints):
            x = getattr(record, name)[:, j]
            if np.all(np.isfinite(x)) and np.ptp(x) > 0:
                yield name, joint, x


def _resolution(x: Array) -> float:
    """Return the smallest step of a signal."""
    steps = np.abs(np.diff(x))
    return float(np.min(steps[steps > 1e-12 * np.max(np.abs(x))], initial=np.inf))
