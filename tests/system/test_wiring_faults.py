# SPDX-License-Identifier: Apache-2.0
"""Exchanged joints and wrong signs are found within 20 samples on every robot; healthy starts are never stopped."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))

from diagnosis_benchmark.fault_runs import JOINTS, PAIRS, ROBOTS, WIRING
from diagnosis_benchmark.faulty_loop import Fault
from diagnosis_benchmark.wiring_runs import HEALTHY_LASTING, Stop, healthy, wrong

pytestmark = pytest.mark.system
FIRST = 20
TRAVEL = {"paper_k31": 0.75, "two_link": 0.25, "arm7": 0.05}  # rad, of any side, until the stop
CASES = [(robot, kind) for robot in ROBOTS for kind in WIRING if robot != "paper_k31" or kind not in PAIRS]


@pytest.mark.parametrize(("robot", "kind"), CASES, ids=lambda value: value.replace(" ", "_"))
def test_each_fault_of_each_joint_is_found_within_twenty_samples_and_stops_the_next(robot: str, kind: str) -> None:
    for case in wrong(robot, kind):
        stop = Stop.of(case, 0.03)
        assert 0 < stop.samples <= FIRST, case.name
        assert all(name in stop.reason for name in case.joints.split(" and ")), (case.name, stop.reason)
        assert stop.travel < TRAVEL[robot], case.name


@pytest.mark.parametrize("robot", ROBOTS)
def test_healthy_starts_are_never_stopped(robot: str) -> None:
    """With wrong stiffness and inertia, payload, friction, noise, delay, weak motors; at rest and at speed."""
    for seed in range(1000, 1008):
        assert Stop.of(healthy(robot, seed), HEALTHY_LASTING).samples == 0, seed


@pytest.mark.parametrize("robot", ["two_link", "arm7"])
@pytest.mark.parametrize("delay", [2, 4])
def test_late_velocities_are_not_taken_for_those_of_other_joints(robot: str, delay: int) -> None:
    late = Fault(delay=delay, delayed=np.ones(2 * JOINTS[robot], dtype=bool))
    for seed in range(2):
        assert Stop.of(replace(healthy(robot, seed), fault=late), HEALTHY_LASTING).samples == 0, seed
