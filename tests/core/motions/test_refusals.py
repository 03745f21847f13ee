# SPDX-License-Identifier: Apache-2.0
"""References, transitions and limits that cannot be are refused in one sentence, which names what is wrong."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import fjr_core as fjr
from fjr_identification.excitation import RestingSeries
from fuzzing import refused

TIMES = np.array([0.3, 1.0, 1.4, 2.5])
POSITIONS, VELOCITIES, ACCELERATIONS = np.random.default_rng(4).normal(size=(3, 4, 3))
VELOCITIES[-1] = 0.0
START = np.ones((5, 3))
NAN = np.where(np.arange(12).reshape(4, 3) == 7, np.nan, POSITIONS)
RUNNING = fjr.Sine((0.5, 0.3), (1.0, 2.0))
JETS = RUNNING.jets(0.0)

BAD: dict[str, tuple[Callable[[], object], tuple[str, ...]]] = {
    "sine-lengths": (lambda: fjr.Sine((1.0, 2.0), (1.0, 2.0, 3.0)), ("(2,)", "(3,)")),
    "sine-nan": (lambda: fjr.Sine(np.nan, 1.0), ("amplitude", "nan", "finite")),
    "sine-word": (lambda: fjr.Sine(1.0, "slow"), ("frequency", "slow", "numbers")),
    "multi-vector": (lambda: fjr.MultiSine([1.0], 1.0), ("amplitude", "(1,)", "(m, n)")),
    "multi-shape": (lambda: fjr.MultiSine([[1.0, 2.0]], [[1.0]]), ("frequency", "(1, 1)", "(1, 2)")),
    "multi-offset": (lambda: fjr.MultiSine([[1.0, 2.0]], 1.0, 0.0, (1, 2, 3)), ("offset", "(3,)", "(2,)")),
    "points": (lambda: fjr.PointToPoint((0, 0), (1, 1, 1), 1.0), ("q1", "(3,)", "(2,)")),
    "points-scalar": (lambda: fjr.PointToPoint(0.0, 1.0, 1.0), ("q0", "()", "(n,)")),
    "duration": (lambda: fjr.PointToPoint((0,), (1,), 0.0), ("duration", "0.0 s", "positive")),
    "dwell": (lambda: fjr.PointToPoint((0,), (1,), 1.0, -1.0), ("dwell", "-1.0 s", "0 or more")),
    "circle-one": (lambda: fjr.Circle((0.0,), 0.5, 1.0), ("centre", "1 entry", "2 or more")),
    "circle-radius": (lambda: fjr.Circle((0.0, 0.0), np.nan, 1.0), ("radius", "nan", "finite")),
    "circle-ramp": (lambda: fjr.Circle((0.0, 0.0), 0.5, 1.0, ramp=0.0), ("ramp", "0.0 s", "positive")),
    "hold": (lambda: fjr.Hold([[1.0]]), ("q", "(1, 1)", "(n,)")),
    "standing": (lambda: fjr.standing((1.0, 2.0), (1.0, 2.0, 3.0)), ("dq", "(3,)", "(2,)")),
    # splines
    "times stall": (lambda: fjr.Spline([0.3, 1.0, 1.0, 2.5], POSITIONS), ("1.0 s at point 1", "1.0 s at point 2")),
    "times short": (lambda: fjr.Spline(TIMES[1:], POSITIONS), ("times", "(3,)", "(4,)")),
    "times nan": (lambda: fjr.Spline(np.full(4, np.nan), POSITIONS), ("times", "nan", "finite")),
    "times at start": (lambda: fjr.Spline(TIMES - 0.3, POSITIONS, start=START), ("times", "0.0 s", "more than 0")),
    "too close": (lambda: fjr.Spline(1e-80 * np.arange(4), POSITIONS), ("1e-80 s at point 1", "at least 1e-06 s")),
    "too large": (lambda: fjr.Spline(TIMES, 1e307 * POSITIONS), ("positions", "not finite", "smaller")),
    "one point": (lambda: fjr.Spline(TIMES[:1], POSITIONS[:1]), ("times", "1 point", "at least 2")),
    "no points": (lambda: fjr.Spline(TIMES[:0], POSITIONS[:0]), ("positions", "(0, 3)", "(k, n)")),
    "flat": (lambda: fjr.Spline(TIMES, POSITIONS[:, 0]), ("positions", "(4,)", "(k, n)")),
    "nan": (lambda: fjr.Spline(TIMES, NAN), ("positions", "nan", "point 2", "joint 1", "finite")),
    "ragged": (lambda: fjr.Spline(TIMES, [[1.0, 2.0], [1.0]]), ("positions", "numbers")),
    "velocities": (lambda: fjr.Spline(TIMES, POSITIONS, VELOCITIES[1:]), ("velocities", "(3, 3)", "(4, 3)")),
    "moving end": (lambda: fjr.Spline(TIMES, POSITIONS, VELOCITIES + 1.0), ("1.0", "zeros at the last point")),
    "start": (lambda: fjr.Spline(TIMES, POSITIONS, start=START[:4]), ("start", "(4, 3)", "(5, 3)")),
    "start nan": (lambda: fjr.Spline(TIMES, POSITIONS, start=START * np.inf), ("start", "inf", "finite")),
    # samples
    "tolerance": (lambda: fjr.SampledMotion([0, 1], [[0], [1]], -1.0), ("tolerance is -1.0; expected 0 or more",)),
    "tolerances": (lambda: fjr.SampledMotion([0, 1], [[0], [1]], [1, 1]), ("tolerance has 2 entries; expected 1",)),
    # transitions
    "at once": (lambda: fjr.transition(JETS, 0.0, RUNNING, 0.0), ("duration", "0.0 s", "positive")),
    "endless": (lambda: fjr.transition(JETS, 0.0, RUNNING, np.inf), ("duration", "inf", "finite")),
    "no time": (lambda: fjr.transition(JETS, 1e9, RUNNING, 1e-9), ("duration", "1e-09", "longer")),
    "never": (lambda: fjr.transition(JETS, np.nan, RUNNING, 1.0), ("t0", "nan", "finite")),
    "jets": (lambda: fjr.transition(np.zeros((5, 3)), 0.0, RUNNING, 1.0), ("jets0", "(5, 3)", "(5, 2)")),
    "jets nan": (lambda: fjr.transition(np.full((5, 2), np.nan), 0.0, RUNNING, 1.0), ("jets0", "nan", "finite")),
    "shift": (lambda: fjr.time_shifted(RUNNING, np.nan), ("t0 is nan; expected finite",)),
    # limits
    "order": (lambda: fjr.MotionLimits((1.0,), (-1.0,)), ("lower", "[1.0]", "upper", "[-1.0]", "lower <= upper")),
    "length": (lambda: fjr.MotionLimits((-1.0, -1.0), (1.0, 1.0, 1.0)), ("lower", "[-1.0, -1.0]", "3")),
    "limit nan": (lambda: fjr.MotionLimits((-1.0,), (np.nan,)), ("upper", "nan", "infinite for none")),
    "negative": (lambda: fjr.MotionLimits((-1.0,), (1.0,), (-2.0,)), ("velocity", "-2.0", "no negative")),
    "limit word": (lambda: fjr.MotionLimits((-1.0,), (1.0,), 1.0, "fast"), ("acceleration", "fast", "numbers")),
    "other joints": (
        lambda: fjr.check_motion(fjr.Hold((0.0,)), fjr.MotionLimits((-10.0, -10.0), 9.0)),
        ("limits are of 2 joints; expected those of the reference, 1",),
    ),
    "few harmonics": (lambda: RestingSeries(1.0, (1, 2)), ("the series has 2 harmonics; expected 3 or more",)),
}


@pytest.mark.parametrize("what", BAD)
def test_what_cannot_be_is_refused_in_one_sentence(what: str) -> None:
    make, words = BAD[what]
    refused(fjr.TrajectoryError, make, *words)
