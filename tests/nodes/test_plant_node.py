# SPDX-License-Identifier: Apache-2.0
"""The plant node with a peer as the controller; results are exact in time under any load of the machine."""

from __future__ import annotations

import struct
import time
from xml.etree import ElementTree

import numpy as np
import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String

from fjr_core.config.robot import description
from fjr_msgs_py.names import LATCHED
from fjr_plant import plant_node
from fjr_plant.plant_node import PlantConflictError, PlantNode
from nodes.harness import Peer, Ros, nanoseconds
from nodes.plants import INNER, PERIOD, command, integrate, state_of

TWO = {f"initial_{side}_{what}": [0.1, 0.2] for side in ("link", "motor") for what in ("position", "velocity")}


def in_motion(peer: Peer) -> list[JointState]:
    """Return the states from the first one in motion on."""
    moving = [i for i, state in enumerate(peer.states) if list(state.position) != list(peer.states[0].position)]
    return peer.states[moving[0] :] if moving else []


def time_in_motion(node: PlantNode, peer: Peer) -> int:
    """Return the stamped time [ns] since the start of the motion; the last state at rest may be lost."""
    return nanoseconds(peer.states[-1]) - node._time_base.offset


def block(node: PlantNode, seconds: float) -> None:
    """Keep the thread of the plant busy."""

    def busy() -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            pass

    node._time_base.host.run(busy)


def test_a_plant_of_the_same_name_that_is_discovered_late_must_be_heard(ros: Ros, peer: Peer, monkeypatch) -> None:
    """A plant that was killed stays listed for seconds, and the one that replaces it goes on."""
    monkeypatch.setattr(plant_node, "SETTLING", settling := 0.5)
    node = peer.plant()
    other = Ros()
    ros.at_close(other.close)
    namesake = other.add(Node("fjr_plant", context=other.context))
    states = namesake.create_publisher(JointState, "joint_states", 10)
    ros.until(lambda: node._namesake.listed() and states.get_subscription_count() >= 2, "the listed plant")
    count = len(peer.states)
    ros.until(lambda: len(peer.states) > count + 2 * settling / 1e-3, "states after the time to settle")
    assert node.ended is None

    def ended() -> bool:
        states.publish(peer.states[-1])
        return node.ended is not None

    ros.until(ended, "the end")
    assert isinstance(node.ended, PlantConflictError)
    assert "are published on /joint_states by /fjr_plant; expected one robot" in str(node.ended)


def test_stamps_are_the_exact_times_of_the_states_also_after_ticks_that_were_skipped(ros: Ros, peer: Peer) -> None:
    """Two states are separated by whole inner steps with the held effort, according to their stamps."""
    node = peer.plant(command_timeout=100.0)
    ros.until(lambda: len(peer.states) > 30)
    assert {tuple(state.position) for state in peer.states} == {(0.5, 0.5)}, "at rest until the first command"
    peer.effort_publisher.publish(command(0.3))
    ros.until(lambda: len(in_motion(peer)) > 20, "states in motion")
    skipped = node._health.count["ticks skipped"]
    block(node, 0.05)
    ros.until(lambda: node._health.count["ticks skipped"] >= skipped + 45, "the counter")
    ros.settle()
    x, stamp = state_of(peer.states[0]), node._time_base.offset
    for state in in_motion(peer):
        steps, rest = divmod(nanoseconds(state) - stamp, INNER)
        assert rest == 0
        x = integrate(x, 0.3, steps)
        stamp = nanoseconds(state)
        np.testing.assert_allclose(state_of(state), x, rtol=1e-11, atol=1e-14)


def test_last_command_is_held_until_command_timeout(ros: Ros, peer: Peer) -> None:
    """The effort acts for exactly the timeout after the command, then it is zero."""
    node = peer.plant(command_timeout=0.05)
    peer.effort_publisher.publish(command(0.3))
    ros.until(lambda: in_motion(peer) and time_in_motion(node, peer) > 200 * PERIOD)
    start, last = peer.states[0], peer.states[-1]
    assert last.effort[1] == 0.0
    steps = time_in_motion(node, peer) // INNER
    expected = integrate(integrate(state_of(start), 0.3, 200), 0.0, steps - 200)
    np.testing.assert_allclose(state_of(last), expected, rtol=1e-11, atol=1e-14)
    peer.reported(node, "command timeouts")


BIG_ENDIAN = bytes(4) + struct.pack(">3I4xd", 0, 0, 1, 0.5)
BAD_COMMANDS = [
    (command(1.0, 2.0), "wrong lengths", "data has 2 entries; expected 1, one per joint"),
    (command(), "wrong lengths", ""),
    (command(float("nan")), "not finite", "data holds joint1 = nan; expected finite numbers"),
    (command(float("-inf")), "not finite", ""),
    (BIG_ENDIAN, "not a message", "its CDR header is 00 00; expected 00 01, little-endian"),
]
"""Commands, the kind of their refusal, and the sentence of the first one of its kind."""


def test_malformed_commands_are_refused_counted_and_logged_once_by_kind(ros: Ros, peer: Peer, capfd) -> None:
    assert deserialize_message(BIG_ENDIAN, Float64MultiArray) == command(0.5)
    node = peer.plant()
    for message, kind, _ in BAD_COMMANDS:
        for _ in range(2):
            key = f"command refused: {kind}"
            before = node._health.count[key]
            peer.effort_publisher.publish(message)
            ros.until(lambda key=key, before=before: node._health.count[key] == before + 1, "the refusal")
    count = len(peer.states)
    ros.until(lambda: len(peer.states) > count)
    assert not in_motion(peer), "the motion must not have started"
    peer.reported(node, "command refused: wrong lengths", 4)
    wanted = [sentence for *_, sentence in BAD_COMMANDS if sentence]
    assert ros.until_said(capfd, *wanted).count("command refused") == len(wanted)


def test_a_pause_stops_publication_and_motion_and_a_reset_returns_after_a_silence(ros: Ros, peer: Peer) -> None:
    node = ros.plant(start_paused=True, restart_silence=0.2)
    ros.settle()
    assert not peer.states
    peer.pause(False)
    ros.until(lambda: peer.states)
    peer.effort_publisher.publish(command(0.3))
    ros.until(lambda: len(in_motion(peer)) > 20)
    peer.pause(True)
    ros.settle()
    stopped, count, moved = nanoseconds(peer.states[-1]), len(peer.states), node._robot.time
    ros.settle()
    assert (len(peer.states), node._robot.time) == (count, moved)
    peer.pause(False)
    ros.until(lambda: len(peer.states) > count)
    assert nanoseconds(peer.states[count]) >= stopped + 0.2e9
    peer.reset()
    ros.until(lambda: list(peer.states[-1].position) == [0.5, 0.5], "the initial state")
    last, first = [nanoseconds(state) for state in peer.states[-2:]]
    assert first >= last + 0.2e9


def test_reset_while_paused_does_not_block_the_motion_after_resume(ros: Ros, peer: Peer) -> None:
    node = ros.plant(wait_for_command=False, restart_silence=0.0)
    ros.until(lambda: len(peer.states) > 10)
    peer.pause(True)
    end = time.monotonic() + 0.5
    ros.until(lambda: time.monotonic() > end)
    peer.reset()
    assert node._robot.time == 0
    peer.pause(False)
    assert node._time_base.plant.origin <= time.monotonic_ns()


def test_plant_slower_than_real_time_skips_time_and_reports_it(ros: Ros, peer: Peer) -> None:
    node = ros.plant(wait_for_command=False)
    ros.until(lambda: peer.states)
    block(node, 0.4)
    ros.until(lambda: node._health.count["time lost"] >= 1, "the counter")


@pytest.mark.parametrize("simulated", [False, True])
def test_use_sim_time_cannot_change_while_running(ros: Ros, peer: Peer, simulated: bool) -> None:
    node = ros.plant(use_sim_time=simulated)
    (result,) = node.set_parameters([Parameter("use_sim_time", value=not simulated)])
    assert (result.successful, result.reason) == (
        False,
        "parameter 'use_sim_time' can be set only before the node starts",
    )
    assert node.get_parameter("use_sim_time").value == simulated
    assert node.get_clock().ros_time_is_active == simulated
    assert node.set_parameters([Parameter("use_sim_time", value=simulated)])[0].successful
    assert not node.set_parameters_atomically(
        [Parameter("advance_samples", value=7), Parameter("use_sim_time", value=not simulated)]
    ).successful
    assert node.values["advance_samples"] == 1


def test_late_subscribers_receive_the_urdf_unless_its_publication_is_disabled(ros: Ros) -> None:
    """Its joint names are those of /joint_states, as viewers and robot_state_publisher require."""
    with Ros() as without:
        assert without.plant(publish_description=False).count_publishers("robot_description") == 0
    node = ros.plant(robot__model="planar_two_link", joints=["shoulder", "elbow"], **TWO)
    heard: list[String] = []
    late = ros.add(Node("viewer", context=ros.context))
    late.create_subscription(String, "robot_description", heard.append, LATCHED)
    ros.until(lambda: heard, "the description")
    assert heard[0].data == description(node.values)
    joints = {joint.get("name") for joint in ElementTree.fromstring(heard[0].data).iter("joint")}
    assert joints == {"shoulder", "elbow"}
