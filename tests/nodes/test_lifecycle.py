# SPDX-License-Identifier: Apache-2.0
"""The lifecycle of the controller node, its safety and measurement while it is active, and what it logs."""

from __future__ import annotations

import gc
import os
import time
from functools import partial
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus

import fjr_core as fjr
from fjr_controller.controller_node import ControllerNode
from nodes.harness import Listener, Peer, Ros, nanoseconds, stamped
from nodes.managed import Manager
from tracking.tracked import OBSERVED

SINE = fjr.Sine(1.0, 1.0)
GRAVITY = 0.8 * np.sin(0.5)  # N m; the paper's link at 0.5 rad


def effort(t: float, gains: fjr.Gains = fjr.PAPER_GAINS, reference: fjr.Sine = SINE) -> float:
    """Return the law's effort t [s] after the first state, at standstill at 0.5 rad."""
    robot = fjr.single_link()
    x = robot.state(0.5, 0.5, 0.0, 0.0)
    return float(fjr.TrackingLaw(robot, gains).effort(x, x, reference.jets(t))[0])


def infos(text: str, node: str) -> list[str]:
    return [line.partition(f"[{node}]: ")[2] for line in text.splitlines() if "[INFO]" in line and f"[{node}]" in line]


DOMAIN = f"in ROS domain {os.environ.get('ROS_DOMAIN_ID', 0)}"
LIFE = {
    "configure": ("inactive", "configured", "configured: law v_dpbc for joint1"),
    "activate": ("active", "activated", f"activated: waiting for states on /joint_states {DOMAIN}"),
    "ask": ("active", "tracking", "tracking: the effort is the law's own"),
    "deactivate": ("inactive", "deactivated", "deactivated: no further efforts are sent"),
    "cleanup": ("unconfigured", "cleaned up", "cleaned up: all parameters may change"),
}
"""State after a transition, and kind and sentence of its event."""


def test_transitions_are_those_of_a_managed_node_and_each_is_logged_once(ros: Ros, manager: Manager, capfd) -> None:
    ros.controller(autostart=False)
    assert manager.state() == "unconfigured"
    for transition, (state, *_) in LIFE.items():
        if transition == "ask":
            for k in range(3):
                manager.ask(stamped(0.001 * k))
        else:
            assert manager.change(transition)
        assert manager.state() == state
    ros.until(lambda: len(manager.events) >= len(LIFE), "the events")
    assert [[event.name, event.message] for event in manager.events] == [event for _, *event in LIFE.values()]
    assert infos(capfd.readouterr().err, "fjr_controller") == [event.message for event in manager.events]
    for transition in ("configure", "activate", "deactivate", "activate", "deactivate"):
        assert manager.change(transition)
    assert {"unconfigured", "inactive", "active", "finalized"} <= set(manager.labels())
    assert manager.transitions() == {"activate", "cleanup", "shutdown"}


def test_states_are_answered_only_once_other_controllers_are_discovered(ros: Ros, manager: Manager) -> None:
    since = time.monotonic() + 0.5
    node = ros.start(partial(ControllerNode, since), executor=ros.host, compile=ros.host == "native")
    assert node.state == "active"
    while not manager.commands:
        manager.state_publisher.publish(stamped(time.monotonic() - since + 1.0))
        ros.executor.spin_once(timeout_sec=0.01)
    assert time.monotonic() >= since


def test_nothing_is_computed_or_sent_unless_active(ros: Ros, manager: Manager) -> None:
    node = ros.controller(autostart=False)
    manager.ask(stamped(0.0), answered=False)
    assert manager.change("configure")
    for _ in range(3):
        manager.ask(stamped(0.0), answered=False)
    assert node._control.step.last_stamp is None
    assert not manager.efforts
    for transition in ("activate", "deactivate", "activate"):  # without a command there is no last one either
        assert manager.change(transition)
    assert not manager.efforts
    manager.ask(stamped(0.1))
    assert manager.change("deactivate")
    ros.until(lambda: len(manager.commands) == 2, "the last command")
    last = node._control.step.last_stamp
    manager.ask(stamped(0.2), answered=False)
    assert node._control.step.last_stamp == last
    assert len(manager.efforts) == 2


@pytest.mark.parametrize(
    ("transition", "on_stop", "last"),
    [("deactivate", "zero", 0.0), ("shutdown", "gravity_hold", GRAVITY), ("stop", "gravity_hold", GRAVITY)],
)
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


def test_a_reference_and_gains_set_while_inactive_apply_when_active(ros: Ros, manager: Manager) -> None:
    manager.started(limits__link_velocity=[2.0])
    assert manager.change("deactivate")
    assert manager.set(reference__amplitude=[0.4], reference__offset=[0.1], gains__K_ld=[0.9])[0]
    assert manager.change("activate")
    wanted = effort(0.0, fjr.Gains(10.0, 20.0, 0.9, 15.0, 60.0, 0.3), fjr.Sine(0.4, 1.0, 0.1))
    np.testing.assert_allclose(manager.answer(stamped(5.0)).effort, [wanted], rtol=1e-9)
    manager.answer(stamped(5.5))
    np.testing.assert_allclose(manager.references[-1].position, [0.1 + 0.4 * np.sin(0.5)], rtol=1e-9)
    assert manager.change("deactivate")
    assert manager.set(reference__frequency=[9.0])[0]
    assert not manager.change("activate")
    assert manager.state() == "inactive"


def test_invalid_parameters_are_refused_by_configure_and_can_be_corrected(ros: Ros, manager: Manager, capfd) -> None:
    node = ros.controller(autostart=False, gains__K_ld="much", robot__joint_stiffness=[3.1])

    def parts() -> list[int]:
        return [len(list(each)) for each in (node.publishers, node.subscriptions, node.services, node.timers)]

    before = parts()
    assert not manager.change("configure")
    assert manager.set_one("gains.K_ld", [0.6])[0]
    for name, bad, good in (
        ("gains.Pi_l", [-20.0], [20.0]),
        ("constraints.goal", [0.1, 0.1], [0.1]),  # exists without control_msgs, too
        ("constraints.trajectory", [0.1, 0.1], [0.1]),
        ("limits.acceleration", [1.0, 1.0], [9.0]),
        ("limits.link_position_upper", [0.5], [2.0]),
        ("measurement.gear_ratio", [0.0], [1.0]),
    ):
        assert manager.set_one(name, bad)[0]
        assert not manager.change("configure")
        assert name.split(".")[0] in str(node.trouble) or "reference.*" in str(node.trouble)
        assert parts() == before, "a refused transition must leave no objects"
        assert manager.set_one(name, good)[0]
    assert manager.state() == "unconfigured"
    ros.until(lambda: manager.events, "the event of the failed transition")
    assert (manager.events[0].name, manager.events[0].level) == ("transition failed", b"\x02")
    assert "gains.K_ld" in manager.events[0].message
    assert "gains.Pi_l" in capfd.readouterr().err
    assert manager.set_one("robot.joint_stiffness", [31.0])[0]
    assert manager.change("configure")
    assert node.trouble is None
    assert manager.change("activate")
    np.testing.assert_allclose(manager.ask(stamped(0.0)).effort, [effort(0.0)], rtol=1e-9)


def test_gains_change_between_two_states_and_invalid_ones_change_nothing(ros: Ros, manager: Manager) -> None:
    node = manager.started()
    assert manager.set(gains__K_ld=[0.9], gains__Pi_l=[30.0]) == (True, "")
    other = fjr.Gains(10.0, 30.0, 0.9, 15.0, 60.0, 0.3)
    np.testing.assert_allclose(manager.ask(stamped(0.001)).effort, [effort(0.001, other)], rtol=1e-9)
    assert manager.set_one("gains.K_ld", [0.6])[0]
    assert manager.set_one("gains.Pi_l", [20.0])[0]
    for values in (
        {"gains__Pi_l": [-20.0]},
        {"gains__Pi_l": [float("nan")]},
        {"gains__Pi_l": [30.0], "gains__K_ld": [-1.0]},
        {"gains__Pi_l": [30.0, 30.0]},
        {"gains__Pi_l": "stiff"},
        {"gains__Pi_l": [30.0], "gains__K": [1.0]},
        {"limits__effort": [-1.0]},
        {"gains__Pi_l": [1e160]},
        {"gains__Pi_l": [30.0], "limits__link_position_upper": [-1.0], "limits__link_position_lower": [1.0]},
    ):
        done, reason = manager.set(**values)
        assert not done, values
        assert reason
        assert "\n" not in reason
    np.testing.assert_allclose(manager.ask(stamped(0.002)).effort, [effort(0.002)], rtol=1e-9)
    assert list(node.get_parameter("gains.Pi_l").value) == [20.0]
    ros.settle()
    events = [event for event in manager.events if event.name == "gains changed"]
    assert [(event.level, event.hardware_id, bool(event.message)) for event in events] == [(b"\x00", "", True)] * 3


def test_an_active_controller_refuses_an_effort_limit_below_the_weight_of_links_or_reference(
    ros: Ros, manager: Manager
) -> None:
    ros.controller(reference__offset=[1.0])
    for t, q_l, weight in ((0.0, 0.5, 0.8 * np.sin(1.0)), (0.001, 1.5, 0.8 * np.sin(1.5))):  # of Table 1
        manager.ask(stamped(t, [q_l, q_l], [0.0, 0.0]))
        done, reason = manager.set(limits__effort=[0.99 * weight])
        assert not done
        said = f"'limits.effort' of joint1 is {0.99 * weight:g} N m; expected at least its weight, {weight:.3g} N m"
        assert said in reason
    assert manager.set(limits__effort=[1.01 * weight]) == (True, "")
    assert manager.change("deactivate")
    assert manager.set(limits__effort=[0.1]) == (True, "")


def test_a_destroyed_node_leaves_the_graph_without_the_garbage_collector(ros: Ros) -> None:
    looking = Listener(ros)
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


# Safety and measurement.


ROBOT = fjr.single_link()
PLACE = ([0.5, 0.52], [0.3, -0.2])  # positions and velocities of link and motor


def at(t: float = 0.0) -> Any:
    return stamped(t, *PLACE)


def test_the_effort_changes_no_faster_than_its_rate(ros: Ros, peer: Peer) -> None:
    node = ros.controller(limits__effort_rate=[100.0])
    efforts = [float(peer.ask(at(0.001 * k)).effort[0]) for k in range(4)]
    np.testing.assert_allclose(efforts, [0.0, -0.1, -0.2, -0.3])
    peer.reported(node, "efforts rate limited", 4)
    (status,) = [each for each in peer.diagnostics[-1].status if each.name == "fjr_controller"]
    assert status.level == DiagnosticStatus.OK, "a limited rate is what its setting asks for"


def test_positions_of_links_and_joint_torques_suffice_with_an_observer(ros: Ros, peer: Peer) -> None:
    """The effort is zero while the observer settles, then the law's with the observer's velocities."""
    ros.controller(measurement__motor="torque", measurement__velocity="observer", measurement__observer_bandwidth=200.0)
    state = stamped(0.0, 0.5, names=["joint1"])
    state.velocity, state.effort = [], [31.0 * 0.02]
    law, observer = fjr.TrackingLaw(ROBOT, fjr.PAPER_GAINS), fjr.VelocityObserver(ROBOT, 200.0)
    for k in range(OBSERVED + 1):
        observer.update(k * 1_000_000, [0.5], [0.52], [0.0])
        state.header.stamp = at(0.001 * k).header.stamp
        command = peer.ask(state)
        assert bool(command.effort[0]) == (k == OBSERVED)
    u, _ = law.measured_command(observer.state[:2], observer.state[2:], fjr.Sine(1.0, 1.0).jets(0.001 * OBSERVED))
    np.testing.assert_allclose(command.effort, u, rtol=1e-9)


@pytest.mark.parametrize("lockstep", [True, False])
def test_plant_logs_waiting_and_start_of_motion(ros: Ros, manager: Manager, lockstep: bool, capfd) -> None:
    node = ros.plant(lockstep=lockstep)
    ros.controller(use_sim_time=lockstep)
    ros.until(lambda: node._robot.time > 0, "motion")
    said = ros.until_said(capfd, "moving: ")
    topic, first = ("/joint_commands", "answer") if lockstep else ("/effort_controller/commands", "command")
    time = "in lock-step" if lockstep else "with the clock"
    assert infos(said, "fjr_plant") == [
        f"configured: joint1 at 1000 Hz {time}; waiting for commands on {topic} {DOMAIN}",
        f"moving: the first {first} has arrived",
    ]
    assert manager.states
