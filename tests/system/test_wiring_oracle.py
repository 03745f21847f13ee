# SPDX-License-Identifier: Apache-2.0
"""The check of the wiring in C agrees with its equations in NumPy on noisy streams of every shipped robot."""

from __future__ import annotations

import sys
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

import fjr_core as fjr
from core.oracles.wiring import NumericCheck
from fjr_core.numerics.checks import Array
from fjr_core.runtime.events import WiringFault
from fjr_monitor.diagnosis.fault_isolation import WiringCheck
from fjr_monitor.diagnosis.record import Record

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))

from diagnosis_benchmark.fault_runs import PAIRS, ROBOTS, WIRING, FaultCase
from diagnosis_benchmark.faulty_loop import Fault, FaultyLoop
from diagnosis_benchmark.loop import record
from diagnosis_benchmark.wiring_runs import healthy, wrong

pytestmark = pytest.mark.system
CASES = [(robot, kind) for robot in ROBOTS for kind in WIRING if robot != "paper_k31" or kind not in PAIRS]
STATES, LATER = 30, 80
"""States of a stream, and of one in which the comparisons go on."""
SAME = {"rtol": 1e-6, "atol": 1e-9}


def stream(case: FaultCase, states: int = STATES, change: Fault | None = None) -> tuple[fjr.Robot, Record]:
    """Return the robot as the controller knows it, and what it measured and sent."""
    scenario = case.case.loaded()
    run = record(FaultyLoop(scenario, change or case.fault).run(states * scenario.sample_period), scenario)
    return scenario.robot, run


def compared(robot: fjr.Robot, run: Record) -> str:
    """Give a stream to both; return the sentence of the fault that both find with the same state, if any."""
    names = [f"joint{j + 1}" for j in range(robot.n)]
    here, oracle = WiringCheck(robot), NumericCheck(robot)
    for t, q, dq, u in zip(run.t, run.position, run.velocity, run.u, strict=True):
        found, expected = here.see(t, q, dq), oracle.see(t, q, dq)
        assert found == expected
        np.testing.assert_array_equal(np.array(list(here.state.right), dtype=bool), oracle.right)
        np.testing.assert_allclose(list(here.state.comparison.misfit), oracle.misfit[: 2 * robot.n], **SAME)
        assert here.done == oracle.right.all()
        if found is not None or here.done or not np.isfinite(u).all():
            return found.sentence(names) if found is not None else ""
        here.sent(u)
        oracle.sent(u)
    return ""


@pytest.mark.parametrize(("robot", "kind"), CASES, ids=lambda value: value.replace(" ", "_"))
def test_both_find_the_same_fault_with_the_same_state(robot: str, kind: str) -> None:
    for case in islice(wrong(robot, kind), 0, None, 3):
        assert compared(*stream(case)), case.name


@pytest.mark.parametrize("robot", ROBOTS)
def test_both_find_no_fault_in_healthy_starts(robot: str) -> None:
    """At rest, at speed, with payload, friction, delays and lost states; until long after the first window."""
    for seed in range(1000, 1004):
        assert not compared(*stream(healthy(robot, seed), LATER)), seed


@pytest.mark.parametrize(
    "change",
    [Fault(effort=np.negative), Fault(position=lambda q: np.roll(q, 1), velocity=lambda dq: np.roll(dq, 1))],
    ids=["all_efforts_reversed", "all_encoders_moved"],
)
@pytest.mark.parametrize("robot", ["two_link", "arm7"])
def test_both_agree_where_all_joints_are_suspected(robot: str, change: Fault) -> None:
    compared(*stream(next(wrong(robot, "effort sign")), change=change))


@pytest.mark.parametrize("wrong_motor", [None, 0, 1])
def test_both_agree_on_a_robot_with_full_matrices(wrong_motor: int | None) -> None:
    def full(a: float, b: float) -> Array:
        return np.array([[a, 0.2 * b], [0.2 * b, b]])

    links = fjr.planar_two_link().links
    robot = fjr.Robot(links, full(0.02, 0.01), full(40, 25), full(0.2, 0.1), full(0.01, 0.02), full(1, 0.8))
    plant, rng, x = fjr.Plant(robot), np.random.default_rng(5), robot.state(*np.zeros((4, 2)))
    here, oracle = WiringCheck(robot), NumericCheck(robot)
    for k in range(STATES):
        q, dq = x[:4] + 1e-6 * rng.standard_normal(4), np.hstack(robot.velocities(x)) + 5e-4 * rng.standard_normal(4)
        if wrong_motor is not None:
            q[2 + wrong_motor], dq[2 + wrong_motor] = -q[2 + wrong_motor], -dq[2 + wrong_motor]
        found = here.see(1e-3 * k, q, dq)
        assert found == oracle.see(1e-3 * k, q, dq)
        np.testing.assert_allclose(list(here.state.comparison.misfit), oracle.misfit[:4], **SAME)
        if found is not None:
            break
        u = np.array([3.0, 2.0]) * np.sin(200e-3 * k)
        here.sent(u)
        oracle.sent(u)
        x = plant.step(x, u, 1e-3)
    assert found == (None if wrong_motor is None else WiringFault("encoder sign", (wrong_motor,), "motor"))
