# SPDX-License-Identifier: Apache-2.0
"""JointTrajectory messages by the rules of joint_trajectory_controller, and the services hold, play and resume."""

from __future__ import annotations

import re
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from trajectory_msgs.msg import JointTrajectory

import fjr_core as fjr
from fjr_controller.planner import LONG, PlanningProblem
from fjr_msgs_py.messages.joint_states import MessageError
from fjr_msgs_py.messages.trajectories import read_trajectory, trajectory_message
from fjr_msgs_py.names import state_names
from nodes.harness import Ros, Stranger, stamped
from nodes.managed import Manager, trajectory
from time_limits import HANG
from two_link_urdf import JOINTS, MOTOR_INERTIA, STIFFNESS, two_link_urdf

NAN, INF = float("nan"), float("inf")
SECOND = 10**9
ZERO = 100 * SECOND  # stamp of the first state
TWO = ("a", "b")
STEP = 0.001  # s


def reference_at(manager: Manager, t: float) -> tuple[np.ndarray, np.ndarray]:
    """Return position and velocity of the reference for a state at t [s]."""
    manager.ask(stamped(t, 0.0))
    return np.array(manager.references[-1].position), np.array(manager.references[-1].velocity)


# Messages.


def test_a_written_message_is_read_back_with_its_joints_in_another_order() -> None:
    rows = np.arange(18.0).reshape(3, 3, 2)
    rows[1, -1] = 0.0
    message = trajectory_message(TWO[::-1], np.array([0.5, 1.25, 2.000000001]), *rows)
    waypoints = read_trajectory(message, TWO)
    assert waypoints.times.tolist() == [SECOND // 2, 5 * SECOND // 4, 2 * SECOND + 1]
    assert waypoints.start is None
    for found, row in zip((waypoints.positions, waypoints.velocities, waypoints.accelerations), rows, strict=True):
        np.testing.assert_array_equal(found, row[:, ::-1])


def bad_time(sec: int) -> JointTrajectory:
    message = trajectory((1.0, 0.0))
    message.points[0].time_from_start.sec = sec
    return message


BAD: dict[str, tuple[JointTrajectory, str, str]] = {
    "unknown joint": (trajectory((1.0, 0.0), joints=("elbow",)), "unknown joints", "elbow.*expected some of.*joint1"),
    "no joints": (trajectory((1.0, []), joints=()), "unknown joints", "expected some of"),
    "joint twice": (trajectory((1.0, [0.0, 0.0]), joints=("joint1",) * 2), "duplicate joints", "joint1.*only once"),
    "equal times": (trajectory((1.0, 0.0), (1.0, 0.1)), "bad times", "point 1 is at 1 s; expected.*after point 0"),
    "falling times": (trajectory((1.0, 0.0), (2.0, 0.1), (1.5, 0.0)), "bad times", "point 2 is at 1.5 s"),
    "negative time": (bad_time(-1), "bad times", "point 0 is at -1 s"),
    "negative stamp": (trajectory((1.0, 0.0), start=-5 * SECOND), "bad times", "header.stamp is -5"),
    "too many positions": (trajectory((1.0, [0.0, 0.0])), "wrong lengths", "point 0 has 2 positions; expected 1"),
    "no positions": (trajectory((1.0, []), velocities=[[0.0]]), "wrong lengths", "point 0 has 0 positions"),
    "too many velocities": (trajectory((1.0, 0.0), velocities=[[0.0, 0.0]]), "wrong lengths", "2 velocities"),
    "some velocities": (trajectory((1.0, 0.0), (2.0, 0.0), velocities=[[], [0.0]]), "wrong lengths", "point 0 has no"),
    "accelerations alone": (trajectory((1.0, 0.0), accelerations=[[0.0]]), "wrong lengths", "without velocities"),
    "nan": (trajectory((1.0, 0.0), (2.0, NAN)), "not finite", "positions of point 1 hold nan for joint1"),
    "infinite": (trajectory((1.0, 0.0), velocities=[INF]), "not finite", "velocities of point 0 hold inf for joint1"),
    "effort": (trajectory((1.0, 0.0), effort=[[1.0]]), "efforts", "point 0 has efforts"),
    "last velocity": (trajectory((1.0, 0.0), velocities=[0.5]), "moving end", "0, gives joint1 a velocity of 0.5"),
}


@pytest.mark.parametrize("case", BAD)
def test_an_invalid_message_is_refused_in_one_sentence(case: str) -> None:
    message, kind, sentence = BAD[case]
    with pytest.raises(MessageError, match=sentence) as refused:
        read_trajectory(message, ("joint1",))
    assert refused.value.kind == kind
    assert "\n" not in str(refused.value)


def test_each_refusal_is_an_event_in_the_log_and_changes_nothing(ros: Ros, manager: Manager, capfd) -> None:
    node = manager.started(0.0)
    for case in ("equal times", "falling times", "effort"):  # the first two are of the same kind
        message, kind, sentence = BAD[case]
        event = manager.send(message)
        assert (event.name, event.level) == (f"trajectory refused: {kind}", event.WARN)
        assert re.search(sentence, event.message)
        ros.until_said(capfd, event.message)
    np.testing.assert_allclose(reference_at(manager, 0.2), [[np.sin(0.2)], [np.cos(0.2)]])
    manager.reported(node, "trajectory refused: efforts")


def test_a_last_velocity_that_is_zero_in_single_precision_is_zero() -> None:
    waypoints = read_trajectory(trajectory((1.0, 0.0), velocities=[1e-8]), ("joint1",))
    assert waypoints.velocities.tolist() == [[0.0]]


# Execution.


def move(**fields: Any) -> JointTrajectory:
    return trajectory((0.5, 0.3), (1.0, -0.2), **fields)


def test_a_trajectory_passes_its_points_and_holds_the_last(ros: Ros, manager: Manager) -> None:
    manager.started(0.0)
    event = manager.send(move(velocities=[0.4, 0.0], accelerations=[1.0, 0.0]))
    assert (event.name, event.message) == ("references changed", "another reference: spline")
    np.testing.assert_allclose(reference_at(manager, 0.5), [[0.3], [0.4]], atol=1e-9)
    for t in (1.0, 1.7):
        np.testing.assert_allclose(reference_at(manager, t), [[-0.2], [0.0]], atol=1e-9)


def test_a_trajectory_waits_for_its_start_and_one_that_has_begun_is_joined(ros: Ros, manager: Manager) -> None:
    manager.started(0.0)
    manager.send(trajectory((0.5, 0.1), start=ZERO + SECOND // 2))
    for t in (0.2, 0.4, 0.5):
        np.testing.assert_allclose(reference_at(manager, t), [[np.sin(t)], [np.cos(t)]], atol=1e-9)
    np.testing.assert_allclose(reference_at(manager, 1.0), [[0.1], [0.0]], atol=1e-9)
    event = manager.send(trajectory((0.5, 0.3), start=ZERO))
    assert event.name == "trajectory refused: in the past"
    assert "0.5 s before the newest state" in event.message
    manager.send(trajectory((0.5, 0.3), (1.5, 0.2), start=ZERO))
    np.testing.assert_allclose(reference_at(manager, 1.0), [[0.1], [0.0]], atol=1e-9)
    np.testing.assert_allclose(reference_at(manager, 1.5)[0], [0.2], atol=1e-9)


def test_limits_are_checked_and_named(ros: Ros, manager: Manager) -> None:
    manager.started(0.0, reference__amplitude=[0.0], recovery__join_time=0.0)
    for limits, sentence in (
        ({"limits__acceleration": [1.0]}, r"joint1.*rad/s\^2.*1"),
        ({"limits__link_position_upper": [0.2]}, r"point 0 .*joint1.*0\.3 rad.*0\.2"),
    ):
        assert manager.set(**limits)[0]
        event = manager.send(move())
        assert event.name == "trajectory refused: cannot be followed", event
        assert re.search(sentence, event.message), event.message
        assert manager.set(limits__acceleration=[np.inf])[0]


def test_omitted_joints_hold_if_allowed_and_the_limits_of_the_robot_apply(ros: Ros, manager: Manager) -> None:
    shoulder, elbow = JOINTS
    robot = {"model": "urdf", "urdf": two_link_urdf(), "joint_stiffness": STIFFNESS, "motor_inertia": MOTOR_INERTIA}
    offset = {"reference__amplitude": [0.0, 0.0], "reference__offset": [0.1, 0.2]}
    given = {f"robot__{name}": value for name, value in robot.items()} | offset
    ros.controller(joints=JOINTS, **given, recovery__join_time=0.0)  # the plan may take long enough to be a gap
    names = state_names(JOINTS)
    manager.ask(stamped(0.0, 0.1, names=names))
    message = trajectory((1.0, 0.4), joints=(elbow,))
    refusal = manager.send(message)
    assert refusal.name == "trajectory refused: partial joints"
    assert f"expected ['{shoulder}'] too, or the parameter allow_partial_joints" in refusal.message
    assert manager.set_one("allow_partial_joints", True)[0]
    manager.ask(stamped(0.001, 0.1, names=names))
    manager.events.clear()
    assert manager.send(message).name == "references changed"
    manager.ask(stamped(1.2, 0.1, names=names))
    np.testing.assert_allclose(manager.references[-1].position, [0.1, 0.4], atol=1e-9)
    manager.events.clear()
    upper = fjr.robot_from_urdf(two_link_urdf(), JOINTS, STIFFNESS, MOTOR_INERTIA).limits.upper
    event = manager.send(trajectory((9.0, float(upper[1]) + 0.1), joints=(elbow,)))
    assert event.name == "trajectory refused: cannot be followed"
    assert elbow in event.message


def test_requests_are_refused_before_a_state_while_stopped_and_while_inactive(ros: Ros, manager: Manager) -> None:
    ros.controller(limits__tracking_error=[0.1])
    assert manager.send(move()).name == "trajectory refused: no state"
    manager.ask(stamped(0.0, 0.0))
    manager.ask(stamped(0.001, 0.5))
    ros.until(lambda: "stops" in manager.kinds(), "the stop")
    assert manager.send(move()).name == "trajectory refused: stopped"
    assert manager.change("deactivate")
    assert manager.send(move()).name == "trajectory refused: inactive"
    for name in ("hold", "play", "resume"):
        done, sentence = manager.trigger(name)
        assert not done
        assert "inactive" in sentence


# While a trajectory is planned.


class Gate:
    """A gate that planning waits for until it is opened."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.waiting, self.threads = 0, set()
        self._open, self._solve = threading.Event(), PlanningProblem.outcome
        monkeypatch.setattr(PlanningProblem, "outcome", lambda problem: self._pass(problem))
        self.open = self._open.set

    def _pass(self, problem: PlanningProblem) -> Any:
        self.threads.add(threading.current_thread())
        self.waiting += 1
        assert self._open.wait(HANG)
        return self._solve(problem)


@pytest.fixture
def gate(monkeypatch: pytest.MonkeyPatch) -> Iterator[Gate]:
    gate = Gate(monkeypatch)
    yield gate
    gate.open()


def planned(ros: Ros, manager: Manager, gate: Gate, *messages: JointTrajectory, **parameters: Any) -> Any:
    """Return a controller with a first command, whose planning of the first message waits at the gate."""
    node = manager.started(0.0, **parameters)
    for message in messages:
        manager.trajectories.publish(message)
    ros.until(lambda: gate.waiting, "the planning")
    return node


def test_commands_are_sent_while_a_trajectory_is_planned_and_the_plan_takes_over_without_a_step(
    ros: Ros, manager: Manager, gate: Gate
) -> None:
    node = planned(ros, manager, gate, move(), recovery__join_time=0.0)  # the plan may take long enough to be a gap
    for i in range(1, 21):  # by the active reference
        t = STEP * i
        np.testing.assert_allclose(reference_at(manager, t), [[np.sin(t)], [np.cos(t)]], atol=1e-9)
    assert "references changed" not in manager.kinds()
    before = node._control.step.jets_at(ZERO + SECOND // 50)
    gate.open()
    ros.until(lambda: "references changed" in manager.kinds(), "the plan")
    manager.ask(stamped(0.02, 0.0))
    after = node._control.step.jets_at(ZERO + SECOND // 50)
    np.testing.assert_allclose(after, before, rtol=1e-9, atol=1e-9)
    for t, q in ((0.5, 0.3), (1.0, -0.2)):  # times count from the arrival of the message
        np.testing.assert_allclose(reference_at(manager, t)[0], [q], atol=1e-9)
    assert threading.current_thread() not in gate.threads


def test_plan_that_is_seconds_late_is_joined_within_two_seconds(ros: Ros, manager: Manager, gate: Gate) -> None:
    given = {"recovery__join_time": 0.0, "start__wiring_check": False}  # the states do not follow the effort
    planned(ros, manager, gate, trajectory((20.0, 0.3), (30.0, 0.5)), **given)
    for i in range(1, 13):
        manager.ask(stamped(0.5 * i, 0.0))
    gate.open()
    ros.until(lambda: "references changed" in manager.kinds(), "the plan")
    assert max(abs(reference_at(manager, 6.0 + 0.1 * i)[0][0]) for i in range(21)) < 1.0
    reference = fjr.Spline([20.0, 30.0], [[0.3], [0.5]], start=fjr.Sine(1.0, 1.0).jets(0.0))
    for t in (8.1, 20.0, 25.0):
        np.testing.assert_allclose(reference_at(manager, t)[0], reference.jets(t)[0], atol=1e-9)


def test_refusal_of_the_transition_to_a_late_plan_names_the_delay(ros: Ros, manager: Manager, gate: Gate) -> None:
    """In time, 5 rad in 10 s has a peak velocity of 1.23 rad/s; half of it is over if the plan is 5 s late."""
    limits = {"reference__amplitude": [0.0], "limits__link_velocity": [1.3], "recovery__join_time": 0.0}
    planned(ros, manager, gate, trajectory((10.0, 5.0)), **limits)
    manager.ask(stamped(5.0, 0.0))
    gate.open()
    ros.until(lambda: "trajectory refused: cannot be followed" in manager.kinds(), "the refusal")
    sentence = next(event.message for event in manager.events if "refused" in event.name)
    assert re.search(r"ready 5 s after its start.* transition of 2 s .*joint1.* rad/s.*1\.3.*header\.stamp", sentence)


@pytest.mark.parametrize("service", ["hold", "play"])
def test_request_during_planning_takes_precedence(ros: Ros, manager: Manager, gate: Gate, service: str) -> None:
    planned(ros, manager, gate, move())
    assert manager.trigger(service)[0]
    ros.until(lambda: "trajectories given up" in manager.kinds(), "the event")
    gate.open()
    ros.settle()
    manager.ask(stamped(0.1, 0.0))
    q, dq = reference_at(manager, 3.0)
    if service == "hold":
        assert dq == pytest.approx(0.0, abs=1e-9)
    else:
        np.testing.assert_allclose([q, dq], [[np.sin(3.0)], [np.cos(3.0)]], atol=1e-9)


def test_of_two_trajectories_in_a_row_the_later_one_is_tracked(ros: Ros, manager: Manager, gate: Gate) -> None:
    planned(ros, manager, gate, move())
    manager.trajectories.publish(trajectory((1.0, 0.7)))
    ros.until(lambda: "trajectories given up" in manager.kinds(), "the event")
    gate.open()
    ros.until(lambda: "references changed" in manager.kinds(), "the plan")
    ros.settle()
    assert manager.kinds().count("references changed") == 1
    np.testing.assert_allclose(reference_at(manager, 1.5), [[0.7], [0.0]], atol=1e-9)


def test_a_long_message_is_read_beside_the_executor_and_replaced_by_a_newer_one(ros: Ros, manager: Manager) -> None:
    times = np.arange(1, LONG // 20) * 0.01
    long = trajectory_message(("joint1",), times, *(np.zeros((len(times), 1)) for _ in range(3)))
    node, reading = ros.controller(), threading.Event()
    manager.ask(stamped(0.0, 0.0))
    planner = node._control._interface.planner
    planner._worker.submit(reading.wait)
    manager.trajectories.publish(long)
    manager.trajectories.publish(trajectory((1.0, 0.7)))
    ros.until(lambda: planner._request is not None, "the newer one")
    reading.set()
    ros.until(lambda: {"trajectories given up", "references changed"} <= set(manager.kinds()), "both outcomes")
    np.testing.assert_allclose(reference_at(manager, 1.5), [[0.7], [0.0]], atol=1e-9)
    manager.trajectories.publish(long)
    ros.until(lambda: manager.kinds().count("references changed") == 2, "the long one")


def test_limits_that_change_during_planning_apply(ros: Ros, manager: Manager, gate: Gate) -> None:
    planned(ros, manager, gate, move(), reference__amplitude=[0.0])
    assert manager.set(limits__link_velocity=[0.5])[0]
    gate.open()
    ros.until(lambda: "trajectory refused: cannot be followed" in manager.kinds(), "the refusal")
    assert "references changed" not in manager.kinds()


def test_deactivation_discards_the_trajectory_being_planned(ros: Ros, manager: Manager, gate: Gate) -> None:
    planned(ros, manager, gate, move())
    assert manager.change("deactivate")
    ros.until(lambda: "trajectories given up" in manager.kinds(), "the event")
    assert manager.change("activate")
    gate.open()
    manager.answer(stamped(1.0, 0.0))
    ros.settle()
    manager.answer(stamped(2.0, 0.0))
    np.testing.assert_allclose(manager.references[-1].position, [np.sin(1.0)], atol=1e-9)
    assert "references changed" not in manager.kinds()


def failing(*_: object) -> None:
    raise ZeroDivisionError("injected failure")


@pytest.mark.parametrize("simulated", [False, True], ids=["real time", "simulated time"])
def test_unexpected_errors_of_planning_and_of_a_callback_are_logged_and_the_node_continues(
    ros: Ros, manager: Manager, simulated: bool, monkeypatch: pytest.MonkeyPatch, capfd
) -> None:
    node = manager.started(0.0, use_sim_time=simulated)
    with monkeypatch.context() as patched:
        patched.setattr("fjr_controller.planner.check_motion", failing)
        event = manager.send(move())
    assert event.name == "trajectory refused: failed"
    assert "injected failure" in event.message
    assert "Traceback" in capfd.readouterr().err
    with monkeypatch.context() as patched:
        patched.setattr(node._control._interface, "on_replaced", failing)
        manager.trajectories.publish(move())
        ros.until(lambda: "injected failure" in capfd.readouterr().err, "the log")
    np.testing.assert_allclose(reference_at(manager, 0.5), [[np.sin(0.5)], [np.cos(0.5)]], atol=1e-9)
    assert manager.send(move()).name == "references changed"


def test_in_simulated_time_a_trajectory_is_planned_at_once(ros: Ros, manager: Manager, gate: Gate) -> None:
    gate.open()
    planned(ros, manager, gate, move(), use_sim_time=True)
    assert gate.threads == {threading.current_thread()}
    np.testing.assert_allclose(reference_at(manager, 0.5)[0], [0.3], atol=1e-9)


# Services.


def test_an_empty_trajectory_holds_at_a_standstill_and_play_continues(ros: Ros, manager: Manager) -> None:
    manager.started(0.0)
    assert manager.send(JointTrajectory()).name == "holds"
    manager.ask(stamped(0.001, 0.0))
    assert reference_at(manager, 2.5)[1] == pytest.approx(0.0, abs=1e-9)
    assert manager.set(reference__amplitude=[0.4], reference__frequency=[2.0])[0]
    assert reference_at(manager, 2.6)[1] == pytest.approx(0.0, abs=1e-9)
    assert manager.trigger("play")[0]
    start = 2.6  # of the newest state
    np.testing.assert_allclose(reference_at(manager, start)[1], [0.0], atol=1e-9)
    for t in (4.0, 5.0):
        q, dq = reference_at(manager, t)
        np.testing.assert_allclose(q, [0.4 * np.sin(2.0 * (t - start))], atol=1e-9)
        np.testing.assert_allclose(dq, [0.8 * np.cos(2.0 * (t - start))], atol=1e-9)


def test_play_refuses_a_reference_or_a_transition_that_violates_the_limits(ros: Ros, manager: Manager) -> None:
    manager.started(0.0, reference__amplitude=[0.1], limits__link_velocity=[1.0], recovery__join_time=0.5)
    assert manager.set(reference__frequency=[19.0])[0]
    assert not manager.trigger("play")[0]
    assert manager.set(reference__frequency=[1.0], reference__offset=[1.0])[0]
    done, sentence = manager.trigger("play")
    assert not done
    assert "joint 'joint1' would reach" in sentence
    assert "its limit is 1 rad/s" in sentence
    assert manager.set(recovery__join_time=3.0)[0]
    assert manager.trigger("play")[0]
    manager.ask(stamped(0.001, 0.0))
    for t in (0.4, 1.5, 2.9):
        assert abs(reference_at(manager, t)[1]) < 1.0
    np.testing.assert_allclose(reference_at(manager, 4.0)[0], 1.0 + 0.1 * np.sin(4.0), atol=1e-9)


def test_resume_is_refused_outside_the_limits_and_each_stop_and_what_follows_is_logged(
    ros: Ros, manager: Manager, capfd
) -> None:
    manager.started(0.0, limits__link_velocity=[2.0])
    assert list(manager.ask(stamped(0.001, 0.0, 3.0)).effort) == [0.0]
    done, sentence = manager.trigger("resume")
    assert (done, sentence.partition(":")[0]) == (False, "the controller stays stopped")
    for t in (0.002, 0.005):
        assert list(manager.ask(stamped(t, 0.0)).effort) == [0.0]
        ros.until_said(capfd, "stopped: link velocity")
        assert manager.trigger("resume")[0]
        manager.ask(stamped(t + 0.001, 0.0))
        ros.until_said(capfd, "recovery: transition to the reference")
        assert list(manager.ask(stamped(t + 0.002, 0.0, 3.0)).effort) == [0.0]
    ros.until_said(capfd, "stopped: link velocity")


def test_a_long_trajectory_that_waits_while_the_controller_is_cleaned_up_raises_nothing(
    ros: Ros, manager: Manager
) -> None:
    """An exception would end the process: it is read in a task of the events executor."""
    planner = manager.started(0.0)._control._interface.planner
    assert manager.change("deactivate")
    assert manager.change("cleanup")
    found: list[Any] = []
    planner.read(bytes(LONG + 1), found.append)
    assert found


JUMPS = {
    "position jump of joint1": [stamped(0.002, 4.0)],
    "the time of the states jumped forward": [stamped(10.0, 0.0), stamped(10.001, 0.0)],
}


@pytest.mark.parametrize("jump", JUMPS)
def test_a_jump_names_the_sources_of_the_states_if_there_are_two(ros: Ros, manager: Manager, capfd, jump: str) -> None:
    other = Stranger("joint_states", JUMPS[jump][0])
    node = manager.started(0.0, limits__link_velocity=[2.0], state_timeout=5.0)
    named = lambda: [info.node_name for info in node.get_publishers_info_by_topic("joint_states")]  # noqa: E731
    ros.until(lambda: "other" in named(), "the name of the second source")
    for state in JUMPS[jump]:
        other.publisher.publish(state)
        ros.settle()
    said = ros.until_said(capfd, jump, "states come from")
    assert "/other" in said.partition("states come from")[2]
    other.close()
