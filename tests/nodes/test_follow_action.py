# SPDX-License-Identifier: Apache-2.0
"""The action server, with a stand-in for FollowJointTrajectory where test_msgs is installed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from trajectory_msgs.msg import JointTrajectory

import fjr_controller.components as control
from fjr_controller.follow_action import Code
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

    def feedback(self, progress: Any) -> Any:
        return Fibonacci.Feedback(sequence=[round(1e6 * progress.q_d[0])])


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
    ros.controller(**parameters)
    manager.meet_controller()
    manager.ask(stamped(0.0, 0.0))
    return Client(ros, manager)


def test_a_goal_is_tracked_and_reached(ros: Ros, manager: Manager) -> None:
    client = started(ros, manager, constraints__goal=[1e-3])
    handle = client.send(1000)
    assert handle.accepted
    for t in (0.3, 0.9, 1.0, 1.1):
        manager.ask(stamped(t, 0.0))  # GOAL is not reached
    manager.ask(stamped(1.2, GOAL))
    assert client.result(handle) == (GoalStatus.STATUS_SUCCEEDED, Code.SUCCESSFUL)
    assert len(client.feedback) >= 4
    assert client.feedback[-1] == round(1e6 * GOAL)


def test_a_goal_that_cannot_be_tracked_is_rejected(ros: Ros, manager: Manager) -> None:
    client = started(ros, manager)
    assert not client.send(0).accepted
    assert manager.change("deactivate")
    assert not client.send(1000).accepted


def test_path_tolerance_violation_aborts_the_goal_and_holds(ros: Ros, manager: Manager) -> None:
    client = started(ros, manager, constraints__trajectory=[0.5])
    handle = client.send(1000)
    manager.ask(stamped(0.3, 2.0))
    assert client.result(handle) == (GoalStatus.STATUS_ABORTED, Code.PATH_TOLERANCE_VIOLATED)
    assert "holds" in manager.kinds()


def test_a_goal_that_is_not_reached_in_time_is_aborted(ros: Ros, manager: Manager) -> None:
    client = started(ros, manager, constraints__goal=[1e-3], constraints__goal_time=0.2)
    handle = client.send(500)
    for t in (0.5, 0.6, 0.71):
        manager.ask(stamped(t, 0.0))
    assert client.result(handle) == (GoalStatus.STATUS_ABORTED, Code.GOAL_TOLERANCE_VIOLATED)


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


def test_goal_is_replaced_by_another_goal_a_trajectory_or_a_service(ros: Ros, manager: Manager) -> None:
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


def test_a_stop_ends_a_goal(ros: Ros, manager: Manager) -> None:
    client = started(ros, manager, limits__tracking_error=[0.5])
    handle = client.send(1000)
    manager.ask(stamped(0.1, 2.0))
    assert client.result(handle) == (GoalStatus.STATUS_ABORTED, Code.PATH_TOLERANCE_VIOLATED)


def test_trajectory_of_an_aborted_goal_does_not_continue_after_a_stop(ros: Ros, manager: Manager) -> None:
    client = started(ros, manager, limits__tracking_error=[0.5], recovery__join_time=0.1)
    handle = client.send(1000)
    manager.ask(stamped(0.1, 0.6))
    assert client.result(handle)[0] == GoalStatus.STATUS_ABORTED
    manager.ask(stamped(0.2, 0.7))
    assert manager.trigger("resume")[0]
    for t in (0.3, 0.5, 2.0):
        manager.ask(stamped(t, 0.7))
    np.testing.assert_allclose(manager.references[-1].position, [0.7], atol=1e-9)


def test_the_action_server_exists_only_while_configured(ros: Ros, manager: Manager) -> None:
    client = started(ros, manager)
    assert manager.change("deactivate")
    assert manager.change("cleanup")
    ros.until(lambda: not client._client.server_is_ready(), "the server's end")
    assert manager.change("configure")
    assert manager.change("activate")
    ros.until(client._client.server_is_ready, "the server")
