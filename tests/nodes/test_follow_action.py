# SPDX-License-Identifier: Apache-2.0
"""The action ~/follow_joint_trajectory: goals, tolerances, feedback and results."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

import fjr_controller.components as control
from fjr_controller.follow_action import Code, Tolerances, tolerances
from fjr_core.model.robot import REVOLUTE
from fjr_msgs_py.messages.trajectories import FollowMessages
from nodes.harness import Ros, stamped
from nodes.managed import Manager, trajectory

Fibonacci = pytest.importorskip("test_msgs.action", reason="no action type without test_msgs").Fibonacci
GOAL = 0.3  # rad


class StandIn(FollowMessages):
    """The order of a goal is the time [ms] to reach GOAL; results and feedback are numbers."""

    def trajectory(self, request: Any) -> JointTrajectory:
        return trajectory((request.order * 1e-3, GOAL))

    def tolerances(self, request: Any) -> Any:
        return (), (), 0.0

    def result(self, code: int, sentence: str) -> Any:
        return Fibonacci.Result(sequence=[code])

    def feedback(self, stamp: int, desired: np.ndarray, actual: np.ndarray) -> Any:
        return Fibonacci.Feedback(sequence=[round(1e6 * desired[0, 0])])


class Client:
    def __init__(self, ros: Ros, manager: Manager) -> None:
        self._ros = ros
        self._client = ActionClient(manager, Fibonacci, "fjr_controller/follow_joint_trajectory")
        ros.at_close(self._client.destroy)  # which rclpy's Node does not
        ros.until(self._client.server_is_ready, "the action server")
        self.feedback: list[int] = []

    def send(self, order: int) -> Any:
        """Return the handle of the goal."""
        accepted = self._client.send_goal_async(
            Fibonacci.Goal(order=order), lambda message: self.feedback.append(message.feedback.sequence[0])
        )
        self._ros.until(accepted.done, "the goal's answer")
        return accepted.result()

    def result(self, handle: Any) -> tuple[int, int]:
        """Return status and code."""
        future = handle.get_result_async()
        self._ros.until(future.done, "the result")
        return future.result().status, future.result().result.sequence[0]


@pytest.fixture
def manager(ros: Ros, monkeypatch) -> Manager:
    monkeypatch.setattr(control, "follow_messages", lambda joints: StandIn(Fibonacci, joints))
    return Manager(ros)


def started(ros: Ros, manager: Manager, **parameters: Any) -> Client:
    manager.control = manager.started(0.0, **parameters)._control
    return Client(ros, manager)


def test_a_goal_is_tracked_and_reached_and_one_that_cannot_be_is_rejected(ros: Ros, manager: Manager) -> None:
    client = started(ros, manager, constraints__goal=[1e-3])
    assert not client.send(0).accepted
    handle = client.send(1000)
    assert handle.accepted
    for t in (0.3, 0.9, 1.0, 1.1):
        manager.ask(stamped(t, 0.0))  # GOAL is not reached
    manager.ask(stamped(1.2, GOAL))
    assert client.result(handle) == (GoalStatus.STATUS_SUCCEEDED, Code.SUCCESSFUL)
    assert len(client.feedback) >= 4
    assert client.feedback[-1] == round(1e6 * GOAL)


def test_a_goal_is_aborted_off_its_path_or_late(ros: Ros, manager: Manager) -> None:
    limits = {"constraints__trajectory": [0.5], "constraints__goal": [1e-3], "constraints__goal_time": 0.2}
    client = started(ros, manager, **limits)
    handle = client.send(500)
    for t in (0.5, 0.6, 0.71):
        manager.ask(stamped(t, 0.0))
    assert client.result(handle) == (GoalStatus.STATUS_ABORTED, Code.GOAL_TOLERANCE_VIOLATED)
    handle = client.send(1000)
    manager.ask(stamped(1.0, 2.0))
    assert client.result(handle) == (GoalStatus.STATUS_ABORTED, Code.PATH_TOLERANCE_VIOLATED)
    assert "holds" in manager.kinds()


def test_cancelled_goal_comes_to_a_standstill(ros: Ros, manager: Manager) -> None:
    client = started(ros, manager)
    handle = client.send(1000)
    manager.ask(stamped(0.1, 0.0))
    cancelled = handle.cancel_goal_async()
    ros.until(cancelled.done, "the answer")
    manager.ask(stamped(0.2, 0.0))
    assert client.result(handle)[0] == GoalStatus.STATUS_CANCELED
    manager.ask(stamped(1.9, 0.0))
    manager.ask(stamped(3.0, 0.0))
    np.testing.assert_allclose(manager.references[-1].velocity, [0.0], atol=1e-9)


def test_goal_is_replaced_by_another_goal_a_trajectory_a_service_or_a_transition(ros: Ros, manager: Manager) -> None:
    client = started(ros, manager)
    first = client.send(1000)
    second = client.send(900)
    given_up = (GoalStatus.STATUS_ABORTED, Code.INVALID_GOAL)
    assert client.result(first) == given_up
    manager.send(trajectory((1.0, 0.1)))
    assert client.result(second) == given_up
    third = client.send(800)
    assert manager.trigger("hold")[0]
    assert client.result(third) == given_up
    fourth = client.send(700)
    assert manager.change("deactivate")
    assert client.result(fourth) == given_up
    assert not client.send(1000).accepted, "inactive"
    assert manager.change("cleanup")
    ros.until(lambda: not client._client.server_is_ready(), "the server's end")
    assert manager.change("configure")
    ros.until(client._client.server_is_ready, "the server")


def test_a_stop_ends_a_goal_whose_trajectory_does_not_continue_after_it(ros: Ros, manager: Manager) -> None:
    client = started(ros, manager, limits__tracking_error=[0.5], recovery__join_time=0.1)
    handle = client.send(1000)
    manager.ask(stamped(0.1, 0.6))
    assert client.result(handle) == (GoalStatus.STATUS_ABORTED, Code.PATH_TOLERANCE_VIOLATED)
    manager.ask(stamped(0.2, 0.7))
    assert manager.trigger("resume")[0]
    for t in (0.3, 0.5, 2.0):
        manager.ask(stamped(t, 0.7))
    np.testing.assert_allclose(manager.references[-1].position, [0.7], atol=1e-9)


def test_a_goal_ends_where_the_time_of_the_states_jumps_back_and_its_trajectory_does_not_begin_again(
    ros: Ros, manager: Manager
) -> None:
    client = started(ros, manager)
    handle = client.send(1000)
    manager.ask(stamped(0.5, 0.1))
    manager.ask(stamped(-80.0, 0.1), answered=False)  # one jump is doubted
    manager.ask(stamped(-79.999, 0.1))
    assert client.result(handle) == (GoalStatus.STATUS_ABORTED, Code.PATH_TOLERANCE_VIOLATED)
    for t in (-79.9, -75.0):
        manager.ask(stamped(t, 0.1))
    assert manager.references[-1].velocity[0] == pytest.approx(0.0, abs=1e-9)
    assert abs(manager.references[-1].position[0] - GOAL) > 0.01


def test_a_goal_is_not_judged_by_samples_that_were_answered_before_it(ros: Ros, manager: Manager) -> None:
    client = started(ros, manager, limits__tracking_error=[0.5], recovery__join_time=0.1)
    loop = manager.control._command_loop
    loop._timers[0].cancel()  # so that the samples of the stop are still to be read
    manager.ask(stamped(0.1, 0.6))
    assert manager.trigger("resume")[0]
    manager.ask(stamped(0.2, 0.6))
    handle = client.send(1000)
    loop._poll()
    manager.ask(stamped(0.3, 0.6))
    loop._poll()
    assert manager.control._action.has_goal
    manager.ask(stamped(1.5, GOAL))
    loop._poll()
    assert client.result(handle) == (GoalStatus.STATUS_SUCCEEDED, Code.SUCCESSFUL)


SECOND = 10**9
JOINTS = ("a", "b")
UNITS = (REVOLUTE, REVOLUTE)
VALUES = {
    "joints": JOINTS,
    "constraints.trajectory": (0.1, 0.0),
    "constraints.goal": (0.02, 0.02),
    "constraints.stopped_velocity_tolerance": 0.01,
    "constraints.goal_time": 0.5,
}


def code_of(t: float, q: tuple[float, float], dq: tuple[float, float] = (0.0, 0.0), **other: object) -> Code | None:
    """Return the code for errors at t [s] of a goal of 1 s."""
    outcome = tolerances({**VALUES, **other}, UNITS).outcome(round((t - 1) * SECOND), np.array([q, dq]))
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


def test_goal_without_a_goal_time_stays_active_and_an_outcome_names_joint_error_and_tolerance() -> None:
    assert code_of(100.0, (0.03, 0.0), **{"constraints.goal_time": 0.0}) is None
    outcome = tolerances(VALUES, UNITS).outcome(-SECOND, np.array([[0.25, 0.0], [0.0, 0.0]]))
    assert outcome is not None
    assert outcome.sentence == "on the path, a is off by 0.25 rad; expected at most 0.1"


def test_a_goal_overrides_tolerances_zero_keeps_and_negative_removes_them() -> None:
    def entry(name: str, position: float, velocity: float) -> SimpleNamespace:
        return SimpleNamespace(name=name, position=position, velocity=velocity)

    before = tolerances(VALUES, UNITS)
    path = [entry("b", 0.3, 0.4), entry("nobody", 1.0, 1.0)]
    after = before.overridden(path, [entry("a", 0.0, -1.0)], -1.0)
    assert after.path.tolist() == [[0.1, 0.3], [0.0, 0.4]]
    assert after.goal.tolist() == [[0.02, 0.02], [0.0, 0.01]]
    assert after.goal_time == 0.0
    assert before.path.tolist() == [[0.1, 0.0], [0.0, 0.0]]
    assert isinstance(after, Tolerances)


def test_messages_carry_codes_feedback_and_tolerances() -> None:
    def feedback(joint_names: list[str]) -> SimpleNamespace:
        points = {name: JointTrajectoryPoint() for name in ("desired", "actual", "error")}
        return SimpleNamespace(joint_names=joint_names, header=SimpleNamespace(stamp=SimpleNamespace()), **points)

    kind = SimpleNamespace(Result=lambda **fields: SimpleNamespace(**fields), Feedback=feedback)
    messages = FollowMessages(kind, JOINTS)
    result = messages.result(-4, "why")
    assert (result.error_code, result.error_string) == (-4, "why")
    message = messages.feedback(3 * SECOND + 5, *np.array([[[1.0, 2.0], [2.0, 4.0]], [[4.0, 8.0], [8.0, 16.0]]]))
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (3, 5)
    assert list(message.desired.positions) == [1.0, 2.0]
    assert list(message.actual.velocities) == [8.0, 16.0]
    assert list(message.error.positions) == [-3.0, -6.0]
    request = SimpleNamespace(
        trajectory="t", path_tolerance=[1], goal_tolerance=[2], goal_time_tolerance=SimpleNamespace(sec=1, nanosec=5)
    )
    assert messages.trajectory(request) == "t"
    assert messages.tolerances(request) == ([1], [2], 1.000000005)
