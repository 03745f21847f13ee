# SPDX-License-Identifier: Apache-2.0
"""References of every kind by name; what all of them have in common is tested once."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.motions.reference import Reference
from fjr_identification.excitation.optimal_design import RestingSeries

RNG = np.random.default_rng(4)
K, N = 7, 3
TIMES = np.array([0.3, 1.0, 1.4, 2.5, 2.9, 4.0, 5.0])
POSITIONS, VELOCITIES, ACCELERATIONS = RNG.normal(size=(3, K, N))
VELOCITIES[-1] = 0.0
START = RNG.normal(size=(5, N))
GIVEN: dict[str, dict[str, Any]] = {
    "positions": {},
    "velocities": {"velocities": VELOCITIES},
    "both": {"velocities": VELOCITIES, "accelerations": ACCELERATIONS},
    "accelerations": {"accelerations": ACCELERATIONS},
}
BEGIN: dict[str, dict[str, Any]] = {"alone": {}, "replacing": {"start": START}}
SPLINES: dict[str, Reference] = {
    f"spline of {given}, {begin}": fjr.Spline(TIMES, POSITIONS, **GIVEN[given], **BEGIN[begin])
    for given in GIVEN
    for begin in BEGIN
}

SINES = {
    "plain": fjr.Sine(1.0, 1.0),
    "shifted": fjr.Sine(0.7, 2.5, offset=-0.4, phase=1.1),
    "three": fjr.Sine((1.0, 0.5, -0.2), (1.0, 2.0, 3.5), offset=(0.0, 0.1, 0.2), phase=(0.3, 0.0, -2.0)),
    "backwards": fjr.Sine((1.0, -0.5), (-1.0, -2.0), phase=(0.3, 2.0)),
    "half still": fjr.Sine((0.5, -0.3), (-1.0, 0.0), (0.1, 0.2), (0.3, 4.0)),
    "still": fjr.Sine(0.0, 1.0, offset=0.3),
    "scalars": fjr.Sine((1.0, 0.5), 2.0, offset=0.1),
}
SERIES = RestingSeries(4.0, (1, 2, 3, 5, 8))
FREE = np.random.default_rng(1).standard_normal((SERIES.size, 2))
OTHERS: dict[str, Reference] = {
    "one row": fjr.MultiSine([[0.5, 0.2]], [[1.3, 2.0]], 0.3, (0.1, 0.2)),
    "two sines": fjr.MultiSine([[1.0, 0.5], [0.3, -0.2]], [[1.0, 2.0], [3.0, 0.0]], [[0.1, 0.2], [0.3, 0.4]], (0.5, 1)),
    "series": SERIES.reference(FREE),
    "one way": fjr.PointToPoint((0.1, -0.5), (1.0, 0.5), 1.9),
    "to and fro": fjr.PointToPoint((0.1, -0.5), (1.0, 0.5), 1.9, dwell=0.3, returns=True),
    "no dwell": fjr.PointToPoint(0.1 * np.ones(1), 1.0, 1.7, returns=True),
    "circle": fjr.Circle((0.4, -0.2, 1.0), 0.5, -2.0, 0.3, 1.6),
    "hold": fjr.Hold((0.3, -0.2)),
}

RUNNING = fjr.Sine((0.5, 0.3), (1.0, 2.0), (0.1, -0.2), (0.3, 0.7))
T0, DURATION = 1.3, 0.8
T1 = T0 + DURATION
VIA = np.array([1.5, 2.0, 3.0, 4.5])
TARGETS: dict[str, Reference] = {
    "sine": fjr.Sine((0.4, -0.2), 1.7, 0.2),
    "hold": fjr.Hold((0.3, -0.4)),
    "circle": fjr.Circle((0.1, 0.2), 0.3, 1.2),
    "spline": fjr.Spline(VIA, [[0.1, 0.2], [0.3, -0.1], [0.5, 0.4], [0.0, 0.0]]),
    "shifted": fjr.time_shifted(fjr.PointToPoint((0.0, 0.1), (0.4, -0.2), 2.0), 1.6),
    "joined": fjr.transition(fjr.standing((0.1, 0.1)), 1.8, fjr.Hold((0.5, 0.5)), 1.0),
}
TRANSITIONS: dict[str, Reference] = {
    f"transition to {name}": fjr.transition(RUNNING.jets(T0), T0, target, DURATION) for name, target in TARGETS.items()
}
REFERENCES: dict[str, Reference] = {**SINES, **OTHERS, "late": TARGETS["shifted"], **SPLINES, **TRANSITIONS}
KNOTS = (1.6, 1.7, 1.9, 2.2, 3.4, 3.6, 4.1, 4.4, 8.8, T0, T1, *VIA, *TIMES, *(TIMES[:-1] + np.diff(TIMES) / 2))
"""Instants [s] at which a polynomial of one of these references ends, or may end."""
references = pytest.mark.parametrize("reference", REFERENCES.values(), ids=REFERENCES)
