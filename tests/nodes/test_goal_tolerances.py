# SPDX-License-Identifier: Apache-2.0
"""Goals of FollowJointTrajectory that are reached or missed, without control_msgs."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from trajectory_msgs.msg import JointTrajectoryPoint

from fjr_controller.follow_action import Code, Tolerances, TrackedGoal, tolerances
from fjr_core.model.joint_units import REVOLUTE
from fjr_msgs_py.messages.trajectories import FollowMessages, Progress

SECOND = 10**9
JOINTS = ("a", "b")
UNITS = (REVOLUTE, REVOLUTE)
VALUES = {
    "constraints.trajectory": (0.1, 0.0),
    "constraints.goal": (0.02, 0.02),
    "constraints.stopped_velocity_tolerance": 0.01,
    "constraints.goal_time": 0.5,
}


def code_of(t: float, q: tuple[float, float], dq: tuple[float, float] = (0.0, 0.0), **other: object) -> Code | None:
    """Return the code for errors at t [s] of a goal of 1 s."""
    goal = TrackedGoal(JOINTS, SECOND, tolerances({**VALUES, **other}, UNITS))
    outcome = goal.check(round(t * SECOND), np.array(q), np.array(dq))
    return None if outcome is None else outcome.code


@pytest.mark.parametrize(
    ("t", "q", "dq", "code"),
    [
        (0.5, (0.05, 9.0), (9.0, 9.0), None),
        (0.5, (-0.2, 0.0), (0.0, 0.0), Code.PATH_TOLERANCE_VIOLATED),
        (0.5, (np.nan, 0.0), (0.0, 0.0), Code.PATH_TOLERANCE_VIOLATED),
        (1.0, (0.01, -0.01), (0.0, 0.0), Code.SUCCESSFUL),
        (1.0, (0.01, 0.03), (0.0, 0.0), None),
        (1.0, (0.0, 0.0), (0.0, 0.02), None),
        (1.4, (0.0, 0.0), (0.0, 0.0), Code.SUCCESSFUL),
        (1.6, (0.0, 0.03), (0.0, 0.0), Code.GOAL_TOLERANCE_VIOLATED),
    ],
)
def test_a_goal_ends_by_its_tolerances(t, q, dq, code) -> None:
    assert code_of(t, q, dq) == code


def test_goal_without_a_goal_time_stays_active() -> None:
    assert code_of(100.0, (0.03, 0.0), **{"constraints.goal_time": 0.0}) is None


def test_message_names_joint_error_and_tolerance() -> None:
    outcome = TrackedGoal(JOINTS, SECOND, tolerances(VALUES, UNITS)).check(0, np.array([0.25, 0.0]), np.zeros(2))
    assert outcome is not None
    assert outcome.sentence == "on the path, a is off by 0.25 rad; expected at most 0.1"


def test_a_goal_overrides_tolerances_zero_keeps_and_negative_removes_them() -> None:
    def entry(name: str, position: float, velocity: float) -> SimpleNamespace:
        return SimpleNamespace(name=name, position=position, velocity=velocity)

    before = tolerances(VALUES, UNITS)
    path = [entry("b", 0.3, 0.4), entry("nobody", 1.0, 1.0)]
    after = before.overridden(JOINTS, path, [entry("a", 0.0, -1.0)], -1.0)
    assert (after.path.tolist(), after.path_velocity.tolist()) == ([0.1, 0.3], [0.0, 0.4])
    assert (after.goal.tolist(), after.goal_velocity.tolist()) == ([0.02, 0.02], [0.0, 0.01])
    assert after.goal_time == 0.0
    assert before.path.tolist() == [0.1, 0.0]
    assert isinstance(after, Tolerances)


def test_messages_carry_codes_feedback_and_tolerances() -> None:
    def feedback(joint_names: list[str]) -> SimpleNamespace:
        points = {name: JointTrajectoryPoint() for name in ("desired", "actual", "error")}
        return SimpleNamespace(joint_names=joint_names, header=SimpleNamespace(stamp=SimpleNamespace()), **points)

    kind = SimpleNamespace(Result=lambda **fields: SimpleNamespace(**fields), Feedback=feedback)
    messages = FollowMessages(kind, JOINTS)
    result = messages.result(-4, "why")
    assert (result.error_code, result.error_string) == (-4, "why")
    message = messages.feedback(Progress(3 * SECOND + 5, *(np.array([v, 2 * v]) for v in (1.0, 2.0, 4.0, 8.0))))
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (3, 5)
    assert list(message.desired.positions) == [1.0, 2.0]
    assert list(message.actual.velocities) == [8.0, 16.0]
    assert list(message.error.positions) == [-3.0, -6.0]
    request = SimpleNamespace(
        trajectory="t", path_tolerance=[1], goal_tolerance=[2], goal_time_tolerance=SimpleNamespace(sec=1, nanosec=5)
    )
    assert messages.trajectory(request) == "t"
    assert messages.tolerances(request) == ([1], [2], 1.000000005)
