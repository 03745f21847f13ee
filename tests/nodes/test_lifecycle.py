# SPDX-License-Identifier: Apache-2.0
"""The lifecycle of the controller node."""

from __future__ import annotations

import gc
import time
from functools import partial

import numpy as np
import pytest
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

import fjr_core as fjr
from fjr_controller.controller_node import ControllerNode
from nodes.harness import Listener, Ros, nanoseconds, stamped
from nodes.managed import Manager, trajectory

GRAVITY = 0.8 * np.sin(0.5)  # N m; the paper's link at 0.5 rad


@pytest.fixture
def manager(ros: Ros) -> Manager:
    return Manager(ros)


def effort(t: float, gains: fjr.Gains = fjr.PAPER_GAINS) -> float:
    """Return the law's effort t [s] after the first state, at standstill at 0.5 rad."""
    robot = fjr.single_link()
    x = robot.state(0.5, 0.5, 0.0, 0.0)
    return float(fjr.TrackingLaw(robot, gains).effort(x, x, fjr.Sine(1.0, 1.0).jets(t))[0])


def test_lifecycle_transitions_are_those_of_a_managed_node(ros: Ros, manager: Manager) -> None:
    ros.controller(autostart=False)
    for transition, state in (
        (None, "unconfigured"),
        ("configure", "inactive"),
        ("activate", "active"),
        ("deactivate", "inactive"),
        ("activate", "active"),
        ("deactivate", "inactive"),
        ("cleanup", "unconfigured"),
        ("configure", "inactive"),
    ):
        assert transition is None or manager.change(transition)
        assert manager.state() == state
    assert {"unconfigured", "inactive", "active", "finalized"} <= set(manager.labels())
    assert manager.transitions() == {"activate", "cleanup", "shutdown"}


def test_states_are_answered_only_once_other_controllers_are_discovered(ros: Ros, manager: Manager) -> None:
    since = time.monotonic() + 1.0
    node = ros.start(partial(ControllerNode, since), executor=ros.host, compile=ros.host == "native")
    manager.meet_controller()
    assert node.state == "active"
    while not manager.commands:
        manager.state_publisher.publish(stamped(time.monotonic() - since + 1.0))
        ros.executor.spin_once(timeout_sec=0.01)
    assert time.monotonic() >= since


def test_nothing_is_computed_or_sent_unless_active(ros: Ros, manager: Manager) -> None:
    node = ros.controller(autostart=False)
    manager.ask(stamped(0.0), answered=False)
    assert manager.change("configure")
    ros.until(lambda: ros.matched(manager.state_publisher, 2), "the controller")
    for _ in range(3):
        manager.ask(stamped(0.0), answered=False)
    assert node._control.step.last_stamp is None
    assert not manager.efforts
    assert manager.change("activate")
    manager.meet_controller()
    manager.ask(stamped(0.1))
    assert manager.change("deactivate")
    ros.until(lambda: len(manager.commands) == 2, "the last command")
    last = node._control.step.last_stamp
    manager.ask(stamped(0.2), answered=False)
    assert node._control.step.last_stamp == last
    assert len(manager.efforts) == 2


@pytest.mark.parametrize("transition", ["deactivate", "shutdown", "stop"])
@pytest.mark.parametrize(("on_stop", "last"), [("zero", 0.0), ("gravity_hold", GRAVITY)])
def test_last_command_is_the_stop_effort(ros: Ros, manager: Manager, transition: str, on_stop: str, last) -> None:
    node = manager.started(on_stop=on_stop)
    end = {"deactivate": lambda: manager.change("deactivate"), "shutdown": node.trigger_shutdown, "stop": node.stop}
    end[transition]()
    ros.until(lambda: len(manager.efforts) == len(manager.commands) == 2, "the last command")
    assert list(manager.efforts[-1].data) == list(manager.commands[-1].effort)
    np.testing.assert_allclose(manager.commands[-1].effort, [last], atol=1e-12)
    assert nanoseconds(manager.commands[-1]) == nanoseconds(manager.commands[0])
    node.stop()  # a second call does nothing
    ros.settle()
    assert len(manager.efforts) == 2


def test_no_last_command_without_an_earlier_command(ros: Ros, manager: Manager) -> None:
    node = manager.controller()
    node.stop()
    ros.settle()
    assert not manager.efforts


def test_activation_restarts_the_reference(ros: Ros, manager: Manager) -> None:
    manager.controller()
    first = manager.ask(stamped(0.0))
    manager.ask(stamped(0.3))
    assert manager.change("deactivate")
    assert manager.change("activate")
    manager.meet_controller()
    ros.until(lambda: len(manager.commands) == 3, "the last command")
    manager.state_publisher.publish(stamped(5.0))
    ros.until(lambda: len(manager.commands) == 4, "the answer")
    assert list(manager.commands[-1].effort) == list(first.effort)


def test_activation_discards_pending_requests(ros: Ros, manager: Manager) -> None:
    manager.controller(limits__tracking_error=[0.6], limits__start_error=[0.6])
    first = manager.ask(stamped(0.0))
    assert manager.send(trajectory((0.5, 0.3))).name == "references changed"
    manager.ask(stamped(0.1))
    manager.send(trajectory((0.5, 0.3), start=104 * 10**9))  # still pending
    manager.ask(stamped(0.2, 2.0))
    ros.until(lambda: "stops" in manager.kinds(), "the stop")
    assert activated_again(manager, 5.0).effort == first.effort
    manager.answer(stamped(5.5))
    np.testing.assert_allclose(manager.references[-1].position, [np.sin(0.5)], rtol=1e-9)
    assert list(activated_again(manager, 6.0, 2.0).effort) == [0.0]
    ros.until(lambda: "starts refused" in manager.kinds(), "the refusal")


def test_a_reference_set_while_inactive_is_tracked_when_active(ros: Ros, manager: Manager) -> None:
    manager.started(limits__link_velocity=[2.0])
    assert manager.change("deactivate")
    assert manager.set(reference__amplitude=[0.4], reference__offset=[0.1])[0]
    assert manager.change("activate")
    activated_again(manager, 5.0)
    manager.answer(stamped(5.5))
    np.testing.assert_allclose(manager.references[-1].position, [0.1 + 0.4 * np.sin(0.5)], rtol=1e-9)
    assert manager.change("deactivate")
    assert manager.set(reference__frequency=[9.0])[0]
    assert not manager.change("activate")
    assert manager.state() == "inactive"


def activated_again(manager: Manager, t: float, q: float = 0.5) -> JointState:
    """Deactivate and activate the controller; return the command for a state at t [s]."""
    if manager.state() == "active":
        assert manager.change("deactivate")
        assert manager.change("activate")
    manager.meet_controller()
    return manager.answer(stamped(t, q))


def test_configure_refuses_a_reference_that_violates_its_limits(ros: Ros) -> None:
    with pytest.raises(fjr.ParameterError, match=r"'reference\.\*': joint 'joint1' would reach 1 rad/s.* limit is 0.5"):
        ros.controller(limits__link_velocity=[0.5])


def test_refused_configure_leaves_no_objects_on_the_node(ros: Ros, manager: Manager) -> None:
    node = ros.controller(autostart=False)

    def parts() -> list[int]:
        return [len(list(each)) for each in (node.publishers, node.subscriptions, node.services, node.timers)]

    before = parts()
    for name, bad, good in (
        ("constraints.goal", [0.1, 0.1], [0.1]),  # exists without control_msgs, too
        ("constraints.trajectory", [0.1, 0.1], [0.1]),
        ("limits.acceleration", [1.0, 1.0], [9.0]),
        ("limits.link_position_upper", [0.5], [2.0]),
        ("measurement.gear_ratio", [0.0], [1.0]),
    ):
        assert manager.set_one(name, bad)[0]
        assert not manager.change("configure")
        assert name.split(".")[0] in str(node.trouble) or "reference.*" in str(node.trouble)
        assert parts() == before
        assert manager.set_one(name, good)[0]
    assert manager.change("configure")


def test_invalid_parameters_can_be_corrected_while_unconfigured(ros: Ros, manager: Manager, capfd) -> None:
    node = ros.controller(autostart=False, gains__Pi_l=[-20.0], robot__joint_stiffness=[3.1])
    assert not manager.change("configure")
    assert manager.state() == "unconfigured"
    assert "gains.Pi_l" in str(node.trouble)
    assert "gains.Pi_l" in capfd.readouterr().err
    assert manager.set(gains__Pi_l=[20.0], robot__joint_stiffness=[31.0])[0]
    assert manager.change("configure")
    assert node.trouble is None
    assert manager.change("activate")
    manager.meet_controller()
    np.testing.assert_allclose(manager.ask(stamped(0.0)).effort, [effort(0.0)], rtol=1e-9)


def test_parameters_of_a_wrong_type_can_be_corrected_while_unconfigured(ros: Ros, manager: Manager) -> None:
    ros.controller(autostart=False, gains__K_ld="much")
    assert not manager.change("configure")
    assert manager.set(gains__K_ld=[0.6])[0]
    assert manager.change("configure")


def test_robot_can_change_only_while_unconfigured(ros: Ros, manager: Manager) -> None:
    ros.controller()
    for transition in (None, "deactivate"):
        assert transition is None or manager.change(transition)
        done, reason = manager.set(robot__joint_stiffness=[3.1])
        assert not done
        assert "robot.joint_stiffness" in reason
        assert "unconfigured" in reason


def test_gains_change_between_two_states(ros: Ros, manager: Manager) -> None:
    manager.controller()
    np.testing.assert_allclose(manager.ask(stamped(0.0)).effort, [effort(0.0)], rtol=1e-9)
    assert manager.set(gains__K_ld=[0.9], gains__Pi_l=[30.0]) == (True, "")
    other = fjr.Gains(10.0, 30.0, 0.9, 15.0, 60.0, 0.3)
    np.testing.assert_allclose(manager.ask(stamped(0.001)).effort, [effort(0.001, other)], rtol=1e-9)
    assert manager.set_one("gains.K_ld", [0.6])[0]
    assert manager.set_one("gains.Pi_l", [20.0])[0]
    np.testing.assert_allclose(manager.ask(stamped(0.002)).effort, [effort(0.002)], rtol=1e-9)
    ros.until(lambda: manager.kinds().count("gains changed") == 3, "the events")
    event = next(event for event in manager.events if event.name == "gains changed")
    assert event.level == event.OK
    assert event.message
    assert event.hardware_id == ""


def test_invalid_gains_change_nothing(ros: Ros, manager: Manager) -> None:
    node = manager.started()
    for values in (
        {"gains__Pi_l": [-20.0]},
        {"gains__Pi_l": [float("nan")]},
        {"gains__Pi_l": [30.0], "gains__K_ld": [-1.0]},
        {"gains__Pi_l": [30.0, 30.0]},
        {"gains__Pi_l": "stiff"},
        {"gains__Pi_l": [30.0], "gains__K": [1.0]},
        {"limits__effort": [-1.0]},
        {"gains__Pi_l": [1e160]},
        {"gains__Lambda_m": [1e300]},
        {"gains__Pi_l": [30.0], "limits__link_position_upper": [-1.0], "limits__link_position_lower": [1.0]},
    ):
        done, reason = manager.set(**values)
        assert not done, values
        assert reason
        assert "\n" not in reason
    np.testing.assert_allclose(manager.ask(stamped(0.001)).effort, [effort(0.001)], rtol=1e-9)
    assert list(node.get_parameter("gains.Pi_l").value) == [20.0]
    assert "gains changed" not in manager.kinds()


def test_limits_change_between_two_states(ros: Ros, manager: Manager) -> None:
    manager.started()
    assert manager.set(limits__effort=[2.0])[0]
    assert list(manager.ask(stamped(0.001)).effort) == [np.sign(effort(0.001)) * 2.0]
    assert manager.set(limits__effort=[float("inf")])[0]
    np.testing.assert_allclose(manager.ask(stamped(0.002)).effort, [effort(0.002)], rtol=1e-9)


def test_gains_changed_while_inactive_apply_when_active(ros: Ros, manager: Manager) -> None:
    ros.controller()
    assert manager.change("deactivate")
    assert manager.set(gains__K_ld=[0.9])[0]
    assert manager.change("activate")
    manager.meet_controller()
    other = fjr.Gains(10.0, 20.0, 0.9, 15.0, 60.0, 0.3)
    np.testing.assert_allclose(manager.ask(stamped(0.0)).effort, [effort(0.0, other)], rtol=1e-9)


def test_a_silence_sends_the_stop_effort_once(ros: Ros, manager: Manager) -> None:
    manager.started(state_timeout=0.05, on_stop="gravity_hold")
    ros.until(lambda: "silences" in manager.kinds(), "the silence")
    ros.settle()
    assert len(manager.efforts) == 2
    np.testing.assert_allclose(manager.efforts[-1].data, [GRAVITY], atol=1e-12)


def test_silence_is_measured_in_simulated_time(ros: Ros, manager: Manager) -> None:
    ros.controller(state_timeout=0.5, use_sim_time=True)
    clock = manager.create_publisher(Clock, "/clock", 1)
    manager.meet_controller()
    ros.until(lambda: ros.matched(clock), "the clock's reader")
    manager.ask(stamped(0.0))
    clock.publish(Clock(clock=stamped(0.4).header.stamp))
    ros.settle()
    assert "silences" not in manager.kinds()
    for t in (0.6, 0.7, 0.8):
        clock.publish(Clock(clock=stamped(t).header.stamp))
        ros.settle()
    ros.until(lambda: "silences" in manager.kinds(), "the silence")
    assert nanoseconds(manager.commands[-1]) == nanoseconds(manager.commands[0])


def test_a_destroyed_node_leaves_the_graph_without_the_garbage_collector(ros: Ros) -> None:
    looking = ros.add(Listener(ros))
    collecting = gc.isenabled()
    gc.disable()
    try:
        node = ros.controller()
        ros.until(lambda: "fjr_controller" in looking.get_node_names(), "the node")
        ros.executor.remove_node(node)
        node.destroy_node()
        del node
        ros.until(lambda: "fjr_controller" not in looking.get_node_names(), "its leaving")
    finally:
        if collecting:
            gc.enable()
