# SPDX-License-Identifier: Apache-2.0
"""The controller node, with v-dPBC or another law, with a peer in the role of the robot driver."""

from __future__ import annotations

import re
from unittest.mock import Mock

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock

import fjr_core as fjr
from fjr_controller import command_loop
from fjr_core.config.law import control_law
from fjr_core.extensions.law_registry import LAWS
from nodes.harness import Peer, Ros, nanoseconds, stamped
from nodes.managed import Manager


def paper_effort(t: float, q_l: float, q_m: float, dq_l: float = 0.0, dq_m: float = 0.0):
    robot = fjr.single_link()
    x = robot.state(q_l, q_m, dq_l, dq_m)
    return fjr.TrackingLaw(robot, fjr.PAPER_GAINS).effort(x, x, fjr.Sine(1.0, 1.0).jets(t))


def test_every_state_is_answered_with_effort_reference_and_tracking_error(ros: Ros, peer: Peer) -> None:
    node = ros.controller()
    for k in range(20):
        t, q_l, q_m, dq_l, dq_m = 0.001 * k, 0.5 - 0.01 * k, 0.5 + 0.02 * k, 0.1 * k, -0.1 * k
        state = stamped(t, [q_l, q_m], [dq_l, dq_m])
        command, reference, error = peer.answer(state), peer.references[-1], peer.errors[-1]
        assert command.header.stamp == state.header.stamp
        assert list(command.name) == ["joint1"]
        np.testing.assert_allclose(command.effort, paper_effort(t, q_l, q_m, dq_l, dq_m), rtol=1e-9)
        desired = np.array([np.sin(t), np.cos(t)])
        np.testing.assert_allclose([reference.position[0], reference.velocity[0]], desired)
        np.testing.assert_allclose([error.position[0], error.velocity[0]], [q_l, dq_l] - desired, atol=1e-15)
        ros.until(lambda k=k: len(peer.efforts) == k + 1)
        assert list(peer.efforts[-1].data) == list(command.effort)
    names, wrong = ["gripper", "joint1_motor", "other", "joint1"], float("nan")
    shuffled = stamped(0.019, [wrong, q_m, wrong, q_l], [9.0, dq_m, wrong, dq_l], names)  # the last state
    assert list(peer.ask(shuffled).effort) == list(command.effort)
    assert len(peer.commands) == len(peer.references) == len(peer.errors) == 21
    node.stop()
    ros.until(lambda: len(peer.efforts) == len(peer.commands) == 22, "the last command")
    assert list(peer.efforts[-1].data) == list(peer.commands[-1].effort) == [0.0]


@pytest.mark.parametrize("name", [name for name in LAWS if name != "v_dpbc"])
def test_publishes_the_effort_of_the_selected_law_without_a_certificate(ros: Ros, peer: Peer, name: str, capfd) -> None:
    node = ros.controller(law__type=name, law__start_error=[0.5])
    law = control_law(node.values, fjr.single_link()).sampled
    memory, sent = law.memory, 0.0
    for k in range(5):
        t, position, velocity = 0.001 * k, [0.5 - 0.01 * k, 0.5 + 0.02 * k], [0.1 * k, -0.1 * k]
        command = peer.ask(stamped(t, position, velocity))
        jets, dt = fjr.Sine(1.0, 1.0).jets(t).T, 0.001 if k else 0.0
        expected, _, memory = law.step_function(position, velocity, jets, law.gain_values, memory, sent, dt)
        sent = command.effort[0]
        np.testing.assert_allclose(sent, float(expected), rtol=1e-8)
    assert f"the law {name} has no certificate: none is published" in capfd.readouterr().err
    assert node.count_publishers("fjr_controller/certificate") == 0
    (result,) = node.set_parameters([Parameter("gains.K_ld", value=[1.2])])
    assert not result.successful
    assert result.reason == f"parameters 'gains.*' are of the law v_dpbc; the law is {name}"
    assert node.set_parameters([Parameter("reference.amplitude", value=[0.5])])[0].successful


def test_gravity_hold_uses_the_motor_damping_of_the_law(ros: Ros, peer: Peer) -> None:
    node = ros.controller(
        law__type="pd_gravity", on_stop="gravity_hold", limits__tracking_error=[0.1], recovery__join_time=0.0
    )
    law = control_law(node.values, fjr.single_link())
    for t in (0.0, 0.001, 0.002):  # the motor moves as its velocity says
        command = peer.ask(stamped(t, [0.5, 0.5 + 0.3 * t], [0.0, 0.3]))
    wanted = 0.8 * np.sin(0.5) - law.hold_damping[0, 0] * 0.3
    assert command.effort[0] == pytest.approx(wanted)


def with_fields(**fields: list[float]):
    message = stamped(0.1)
    for name, values in fields.items():
        setattr(message, name, values)
    return message


BAD_STATES = [
    (stamped(0.1, names=["joint1"]), "missing joints"),
    (stamped(0.1, names=["joint1", "joint1_motor", "joint1"]), "duplicate joints"),
    (stamped(0.1, [0.5, float("nan")]), "not finite"),
    (with_fields(velocity=[]), "wrong lengths"),
    (stamped(-100.0), "no stamp"),
]
"""One of each kind; the others: tests/msgs."""


def test_malformed_states_are_refused_counted_and_reported_once_and_the_node_continues(
    ros: Ros, manager: Manager, capfd
) -> None:
    peer, node, times = manager, manager.started(), 2
    refused = node._control.reports.count
    for message, kind in BAD_STATES:
        for k in range(1, times + 1):  # one by one, as the queue keeps the newest only
            peer.state_publisher.publish(message)
            ros.until(lambda k=k, kind=kind: refused[f"state refused: {kind}"] == k, kind)
    np.testing.assert_allclose(peer.ask(stamped(0.2)).effort, paper_effort(0.2, 0.5, 0.5), rtol=1e-9)
    assert len(peer.commands) == 2
    told = [f"state refused: {kind}" for _, kind in BAD_STATES]
    ros.until(lambda: set(told) <= set(manager.kinds()), "an event of each kind")
    assert sorted(told) == sorted(kind for kind in manager.kinds() if kind in told), "once"
    node.stop()
    for _, kind in BAD_STATES:
        key = f"state refused: {kind}"
        ros.until(lambda key=key: peer.count(key, "fjr_controller") == times, "the counter")
    said = capfd.readouterr().err
    assert said.count("state refused") == len(BAD_STATES)
    assert "state refused: names are ['joint1']; expected ['joint1_motor'] among them (logged once" in said


def test_diagnostics_say_for_how_long_states_are_missing_while_they_are(ros: Ros, peer: Peer) -> None:
    """What the controller would do, such as tracking, is no answer while the driver is dead."""
    node = ros.controller(state_timeout=0.3)

    def silent() -> int:
        """Return for how many seconds the latest status and its state miss states, 0 unless it is an error."""
        own = peer.diagnostics[-1].status[0] if peer.diagnostics else DiagnosticStatus()
        state = {pair.key: pair.value for pair in own.values}.get("state", "")
        said = re.fullmatch(r"(no states for (\d+) s)(, silences)?", own.message)
        right = said is not None and own.level == DiagnosticStatus.ERROR and state == said[1]
        return int(said[2]) if right else 0

    ros.until(silent, "the first states are missing")
    assert silent() < 60, "since the node began, not since the machine did"
    peer.ask(stamped(0.0))
    ros.until(lambda: not silent(), "states")
    ros.until(silent, "a silence")
    first = silent()
    ros.until(lambda: silent() > first, "a longer silence")
    peer.state_publisher.publish(stamped(5.0))
    ros.until(lambda: not silent(), "states again")
    node.stop()


def test_use_sim_time_changes_only_while_unconfigured(ros: Ros, manager: Manager) -> None:
    ros.controller(autostart=False, state_timeout=0.5)
    assert manager.set(use_sim_time=True) == (True, "")
    assert manager.change("configure")
    refusal = "parameter 'use_sim_time' can be set only while the node is unconfigured"
    assert manager.set(use_sim_time=False) == (False, refusal)
    assert manager.change("activate")
    assert manager.set(use_sim_time=False) == (False, refusal)
    assert manager.set_one("use_sim_time", False) == (False, refusal)
    assert manager.set(use_sim_time=True)[0]
    manager.ask(stamped(0.0))
    manager.answer(stamped(0.6))  # a stop comes with it
    ros.until(lambda: "silences" in manager.kinds(), "the silence by the stamps")


def test_simulated_time_without_a_clock_is_told(ros: Ros, manager: Manager, capfd, monkeypatch) -> None:
    monkeypatch.setattr(command_loop, "TIMELESS", 2)
    ros.controller(use_sim_time=True)
    for k in range(4):
        manager.ask(stamped(1e-3 * k))
    ros.until_said(capfd, "use_sim_time is true, but no time comes on /clock: silences are not noticed")


def test_process_settings_are_applied_after_configure(ros: Ros, manager: Manager) -> None:
    node = ros.controller(autostart=False, cpu_affinity="both")
    node.host = Mock()
    assert not manager.change("configure"), "invalid cores"
    assert manager.set(cpu_affinity="0", realtime_priority=3) == (True, "")
    assert manager.change("configure")
    (((values,), _),) = node.host.apply_process_settings.call_args_list
    assert (values["cpu_affinity"], values["realtime_priority"]) == ("0", 3)


def answers_across_a_silence(clock_first: bool) -> list[float]:
    """Return the efforts after the first, with the clock before or after the state that ends the silence."""
    with Ros() as ros:
        manager = Manager(ros)
        clock = manager.create_publisher(Clock, "/clock", 1)
        node = ros.controller(state_timeout=0.5, use_sim_time=True)
        manager.ask(stamped(0.0))
        for k, t in enumerate((0.6, 0.601, 0.602, 0.7)):
            if clock_first:
                clock.publish(Clock(clock=stamped(t).header.stamp))
                ros.until(lambda: node.get_clock().now().nanoseconds == nanoseconds(stamped(t)), "the clock")  # noqa: B023
                ros.until(lambda: "silences" in manager.kinds(), "the silence")
            manager.state_publisher.publish(stamped(t, 0.4))
            ros.until(lambda: len(manager.commands) == k + 3, "an answer")  # noqa: B023
        ros.until(lambda: "silences" in manager.kinds(), "the silence")
        assert manager.kinds().count("silences") == 1
        return [command.effort[0] for command in manager.commands[1:]]


def test_in_simulated_time_the_command_after_a_silence_does_not_depend_on_the_clock() -> None:
    efforts = answers_across_a_silence(clock_first=True)
    assert len(efforts) == 5
    assert efforts[:2] == [0.0, 0.0], "the stop effort of the silence, then a continuous effort"
    assert answers_across_a_silence(clock_first=False) == efforts
