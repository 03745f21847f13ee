# SPDX-License-Identifier: Apache-2.0
"""Exchanged joints and wrong signs are found in the first samples on every robot; healthy starts are never stopped.

The check in C agrees with its equations in NumPy (core/oracles/wiring.py) on the same noisy streams.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, replace
from typing import Any

import numpy as np
import pytest

import fjr_core as fjr
from core.oracles.wiring import NumericCheck, WiringFault, torque_tolerance
from diagnosis_benchmark.cases import JOINTS, Case, nominal
from diagnosis_benchmark.faults import PAIRS, ROBOTS, WIRING, joints_of
from diagnosis_benchmark.lock_step import Fault
from diagnosis_benchmark.wiring import COLOURED, EACH, HEALTHY_LASTING, ONE, Stop, healthy, with_sensors, wrong
from fjr_core.numerics.checks import Array
from fjr_core.runtime.events import Finding
from fjr_design.batch import scenario_loop
from fjr_design.batch.draws import Draws
from fjr_monitor.diagnosis.fault_isolation import WiringCheck
from fjr_monitor.diagnosis.record import Record
from fjr_msgs_py.scenarios import library
from system.test_other_joints import URDF

pytestmark = pytest.mark.system
FIRST = {"velocity sign": 26, "velocity of another joint": 26}  # samples; other faults are found within 20
NAMES = ("joint1", "joint2")
LASTING, STATES = 0.04, 30  # s; at 1 kHz
TRAVEL = {"paper_k31": 0.75, "two_link": 0.25, "arm7": 0.05}  # rad, of any side, until the stop
SLOWEST = ("velocity of another joint", "encoders exchanged")  # of arm7; of the others `make test-all` tries each joint
CASES = [
    pytest.param(robot, kind, marks=pytest.mark.full if robot == "arm7" and kind not in SLOWEST else ())
    for robot in ROBOTS
    for kind in WIRING
    if robot != "paper_k31" or kind not in PAIRS
]
SAME = {"rtol": 1e-6, "atol": 1e-9}


def values(finding: Finding | None) -> tuple[object, ...]:
    """Return the fields, of which a size may be NaN; none for no finding."""
    return () if finding is None else astuple(finding)


def said(fault: WiringFault | None, names: Sequence[str]) -> tuple[object, ...]:
    return values(fault and fault.finding(names))


def compared(case: Case, run: Record) -> str:
    """Give a stream to both; return the sentence of the fault that both find with the same state, if any."""
    robot = nominal(case.scenario).robot  # as the controller knows it
    names = [f"joint{j + 1}" for j in range(robot.n)]
    here, oracle = WiringCheck(robot, names), NumericCheck(robot)
    for t, q, dq, u in zip(run.t, run.position, run.velocity, run.u, strict=True):
        found, expected = here.see(t, q, dq), oracle.see(t, q, dq)
        np.testing.assert_equal(values(found), said(expected, names))
        np.testing.assert_equal(values(Finding.of_wiring(here.state.fault, names)), said(oracle.last, names))
        np.testing.assert_array_equal(np.array(list(here.state.right), dtype=bool), oracle.right)
        np.testing.assert_allclose(list(here.state.comparison.misfit), oracle.misfit[: 2 * robot.n], **SAME)
        assert here.done == oracle.right.all()
        if found is not None or here.done or not np.isfinite(u).all():
            return found.sentence if found is not None else ""
        here.sent(u)
        oracle.sent(u)
    return ""


@pytest.mark.parametrize(("robot", "kind"), CASES, ids=lambda value: value.replace(" ", "_"))
def test_each_fault_of_each_joint_is_found_within_its_samples_and_stops_the_next(robot: str, kind: str) -> None:
    for number, case in enumerate(wrong(robot, kind)):
        stop = Stop.of(case, LASTING)
        assert 0 < stop.samples <= FIRST.get(kind, 20), case.name
        assert all(name in stop.reason for name in joints_of(case).split(" and ")), (case.name, stop.reason)
        assert stop.travel < TRAVEL[robot], case.name
        assert number % 3 or compared(case, stop.run), case.name


@pytest.mark.parametrize("seed", [1000, *(pytest.param(each, marks=pytest.mark.full) for each in range(1001, 1008))])
@pytest.mark.parametrize("robot", ROBOTS)
def test_healthy_starts_are_never_stopped(robot: str, seed: int) -> None:
    """With wrong stiffness and inertia, payload, friction, noise, delay, weak motors; at rest and at speed."""
    case = healthy(robot, seed)
    stop = Stop.of(case, HEALTHY_LASTING)
    assert stop.samples == 0
    assert seed % 2 or not compared(case, stop.run)


@pytest.mark.parametrize(("robot", "noise"), [("two_link", 1e-3), ("arm7", 3e-5)])  # rad; of velocities 100 1/s times
def test_noise_of_few_samples_is_not_taken_for_the_motion_of_another_joint(robot: str, noise: float) -> None:
    """The noise of 9 states, of which the check estimates its own tolerance, may be far below that of the sensors."""
    scenario = library.load(robot)
    loop = scenario_loop(scenario, scenario.sampled_law, HEALTHY_LASTING, settle_after=HEALTHY_LASTING / 2)
    starts = Draws(500, delay=scenario.sample_period, position_noise=noise, velocity_noise=100 * noise)
    assert "wiring" not in loop.run(starts).cause


@pytest.mark.parametrize(("noise", "seed"), [(COLOURED, 0), (COLOURED, 52), (ONE, 5), (EACH, 5), (EACH, 11)])
def test_unequal_or_coloured_noise_is_not_taken_for_the_motion_of_another_joint(noise: str, seed: int) -> None:
    """A quiet slope of another joint fits better than its own noisy one; slow noise looks like motion."""
    assert Stop.of(with_sensors("arm7", noise, seed), HEALTHY_LASTING).samples == 0


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.full)])
@pytest.mark.parametrize(
    ("robot", "delay"),
    [
        ("two_link", 2),
        ("arm7", 4),
        *(pytest.param(*each, marks=pytest.mark.full) for each in (("two_link", 4), ("arm7", 2))),
    ],
)
def test_late_velocities_are_not_taken_for_those_of_other_joints(robot: str, delay: int, seed: int) -> None:
    late = Fault(delay=delay, delayed=np.ones(2 * JOINTS[robot], dtype=bool))
    assert Stop.of(replace(healthy(robot, seed), fault=late), HEALTHY_LASTING).samples == 0


@pytest.mark.parametrize(
    "change",
    [Fault(effort=np.negative), Fault(position=lambda q: np.roll(q, 1), velocity=lambda dq: np.roll(dq, 1))],
    ids=["all_efforts_reversed", "all_encoders_moved"],
)
@pytest.mark.parametrize("robot", ["two_link", "arm7"])
def test_both_agree_where_all_joints_are_suspected(robot: str, change: Fault) -> None:
    case = replace(next(wrong(robot, "effort sign")), fault=change)
    found = compared(case, Stop.of(case, LASTING).run)
    if robot == "two_link" and change.effort is np.negative:
        assert found == WiringFault("effort sign", (0, 1), "motor").finding(NAMES).sentence


def test_tolerated_torques_of_a_joint_are_those_of_joints_with_its_unit() -> None:
    """A tenth of the weight, and an offset of 1 mrad or 0.1 mm: a lift weighs much, its spring deflects little."""
    K, weight = np.array([4e5, 300.0]), np.array([4.0 * 9.81, 0.1 * 9.81])  # N, N m
    arm = fjr.robot_from_urdf(URDF, ["lift", "elbow"], K, [1.0, 0.05])
    check = WiringCheck(arm, ("lift", "elbow"))
    for k in range(20):
        check.see(1e-3 * k, np.zeros(4), np.zeros(4))
        check.sent(np.zeros(2))
    np.testing.assert_allclose(list(check.state.constant), 0.1 * weight + [1e-4, 1e-3] * K, rtol=1e-9)
    np.testing.assert_allclose(torque_tolerance(arm, np.zeros(4)), list(check.state.constant), rtol=1e-9)


def test_check_continues_without_motion() -> None:
    check = WiringCheck(fjr.planar_two_link(), NAMES)
    for k in range(200):
        assert check.see(1e-3 * k, np.zeros(4), np.zeros(4)) is None
        check.sent(np.zeros(2))
    assert not check.done


def test_the_operations_after_one_state_are_bounded() -> None:
    """Fewer than 16 n before the last hypothesis, which takes 2 n + 3; the next state continues the comparison."""
    moved = Fault(position=lambda q: np.roll(q, 1), velocity=lambda dq: np.roll(dq, 1))  # all joints are suspected
    case = replace(next(wrong("arm7", "effort sign")), fault=moved)
    run, robot = Stop.of(case, LASTING).run, case.loaded().robot
    check, done, went_on = WiringCheck(robot, [""] * robot.n), [], 0
    for t, q, dq, u in zip(run.t, run.position, run.velocity, run.u, strict=True):
        check._lib.fjr_wiring_see(check.state, t, check._pointer(q), check._pointer(dq))
        done.append(check._lib.fjr_wiring_compare(check._model, check.state))
        assert not check._lib.fjr_wiring_compare(check._model, check.state), "it waits for the next state"
        went_on += check.state.comparing
        if check.state.found or not np.isfinite(u).all():
            break
        check.sent(u)
    assert went_on
    assert 0 <= min(done) < max(done) <= 18 * robot.n + 2


@pytest.mark.parametrize("springs", ["full matrices", "cubic", "torsion"])
@pytest.mark.parametrize("wrong_motor", [None, 0, 1])
def test_both_agree_on_a_robot_with_full_matrices_or_curved_springs(wrong_motor: int | None, springs: str) -> None:
    def full(a: float, b: float) -> Array:
        return np.array([[a, 0.2 * b], [0.2 * b, b]])

    links = fjr.planar_two_link().links
    robot = fjr.Robot(links, full(0.02, 0.01), full(40, 25), full(0.2, 0.1), full(0.01, 0.02), full(1, 0.8))
    K = np.array([40.0, 25.0])
    if springs == "cubic":
        robot = replace(robot, K=np.diag(K), cubic=K / 0.05**2)
    if springs == "torsion":
        z = np.array([[0.02, 0.03], [0.05, 0.06]])
        robot = replace(robot, K=np.diag(K), torsion=[z, K * z * [[1.2], [2.0]]])
    fault, signs = None, np.ones(4)
    if wrong_motor is not None:
        fault, signs[2 + wrong_motor] = WiringFault("encoder sign", (wrong_motor,), "motor"), -1.0
    assert_found(fault, robot, ([3.0, 2.0], 0.2), noise=5e-4, signs=signs)


def assert_found(
    fault: WiringFault | None,
    robot: fjr.Robot,
    sine: tuple[Any, Any],
    noise: float,
    signs: Any = 1.0,
    acting: Any = 1.0,
) -> None:
    """Check that both find a fault in a motion from rest under sines (amplitudes [N m], angles of a sample) of efforts.

    noise [rad/s]: of the velocities. signs (4,): of the encoders. acting (2, 2): what the efforts are multiplied by.
    """
    plant, rng, x = fjr.Plant(robot), np.random.default_rng(5), robot.state(*np.zeros((4, 2)))
    here, oracle = WiringCheck(robot, NAMES), NumericCheck(robot)
    for k in range(STATES):
        q = signs * (x[:4] + 1e-5 * rng.standard_normal(4))
        dq = signs * (np.hstack(robot.velocities(x)) + noise * rng.standard_normal(4))
        found = here.see(1e-3 * k, q, dq)
        np.testing.assert_equal(values(found), said(oracle.see(1e-3 * k, q, dq), NAMES))
        np.testing.assert_allclose(list(here.state.comparison.misfit), oracle.misfit[:4], **SAME)
        if found is not None:
            break
        u = np.multiply(sine[0], np.sin(np.multiply(k, sine[1])))
        here.sent(u)
        oracle.sent(u)
        x = plant.step(x, np.dot(acting, u), 1e-3)
    np.testing.assert_equal(values(found), said(fault, NAMES))


@pytest.mark.parametrize("B_m", [[[0.5, 0.5], [0.5, -0.5]], [[0.0, 1.0], [1.0, 0.0]]], ids=["differential", "crossed"])
@pytest.mark.parametrize(
    ("kind", "joints", "acting"),
    [
        ("effort sign", (0,), [[-1.0, 0.0], [0.0, 1.0]]),
        ("effort sign", (1,), [[1.0, 0.0], [0.0, -1.0]]),
        ("effort sign", (0, 1), [[-1.0, 0.0], [0.0, -1.0]]),
        ("efforts exchanged", (0, 1), [[0.0, 1.0], [1.0, 0.0]]),
        (None, (), [[1.1, 0.0], [0.0, 0.9]]),
    ],
)
def test_wrong_efforts_are_found_where_motors_drive_other_joints(
    B_m: list[list[float]], kind: str | None, joints: tuple[int, ...], acting: list[list[float]]
) -> None:
    """Exchanged motors of a differential transmission are seen by one joint only, crossed ones by the other joint."""
    fault = WiringFault(kind, joints, "motor") if kind else None
    assert_found(fault, fjr.planar_two_link(input_gain=B_m), ([6.0, 4.0], [0.2, 0.3]), noise=1e-4, acting=acting)
