# SPDX-License-Identifier: Apache-2.0
"""The plant node with a peer as the controller; results are exact in time under any load of the machine.

Robot time follows a /clock of another node with use_sim_time; stamps are near the clock and never go back.
"""

from __future__ import annotations

import struct
import time
from xml.etree import ElementTree

import numpy as np
import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import SetBool, Trigger

from fjr_core.config.robot import description
from fjr_msgs_py.names import LATCHED
from fjr_msgs_py.native.loop import NO_TIME
from fjr_plant import plant_node
from fjr_plant.host import NativePlantHost
from fjr_plant.native import plant_program
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


def assert_one_motion(
    states: list[JointState], x: np.ndarray | None = None, stamp: int = 0, effort: float = 0.0
) -> None:
    """Check that the motion under an effort agrees with the stamps; x, stamp [ns]: its begin, None: the first state."""
    if x is None:
        x, stamp = state_of(states[0]), nanoseconds(states[0])
    for state in states:
        steps, rest = divmod(nanoseconds(state) - stamp, INNER)
        assert rest == 0
        x, stamp = integrate(x, effort, steps), nanoseconds(state)
        np.testing.assert_allclose(state_of(state), x, rtol=1e-12, atol=1e-15)


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
    assert_one_motion(in_motion(peer), state_of(peer.states[0]), node._time_base.offset, effort=0.3)


def test_the_native_loop_applies_a_command_from_the_first_inner_step_at_or_after_its_arrival(
    ros: Ros, peer: Peer
) -> None:
    node = peer.plant(command_timeout=100.0)
    peer.effort_publisher.publish(command(0.3))
    ros.until(lambda: in_motion(peer), "motion")
    base, lib = node._time_base, plant_program().lib
    assert isinstance(base.host, NativePlantHost)
    data = serialize_message(command(-0.3))

    def arrive() -> int:
        """Return the robot time [ns] at which a command arrives."""
        now = base.host.now()
        assert not lib.fjr_real_time_command(base.plant, 0, data, len(data), now, plant_program().ffi.NULL)
        return now - base.plant.origin

    before = -(-base.host.run(arrive) // INNER)
    ros.until(lambda: time_in_motion(node, peer) > (before + 100) * INNER, "states")
    x = integrate(state_of(peer.states[0]), 0.3, before)
    after = [state for state in in_motion(peer) if nanoseconds(state) >= base.offset + before * INNER]
    assert_one_motion(after, x, base.offset + before * INNER, effort=-0.3)


def test_last_command_is_held_until_command_timeout(ros: Ros, peer: Peer) -> None:
    """The effort acts for exactly the timeout after the command, then it is zero."""
    node = peer.plant(command_timeout=0.05)
    peer.effort_publisher.publish(command(0.3))
    ros.until(lambda: in_motion(peer) and time_in_motion(node, peer) > 200 * PERIOD)
    start, last = peer.states[0], peer.states[-1]
    assert last.effort[1] == 0.0
    steps = time_in_motion(node, peer) // INNER
    expected = integrate(integrate(state_of(start), 0.3, 200), 0.0, steps - 200)
    np.testing.assert_allclose(state_of(last), expected, rtol=1e-12, atol=1e-15)
    peer.reported(node, "command timeouts")


BIG_ENDIAN = bytes(4) + struct.pack(">3I4xd", 0, 0, 1, 0.5)
BAD_COMMANDS = [
    (command(1.0, 2.0), "wrong lengths", "data has length 2; expected 1, one per joint"),
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


def test_use_sim_time_cannot_change_while_running(ros: Ros, peer: Peer) -> None:
    node = ros.plant(use_sim_time=True)
    kept, other = (Parameter("use_sim_time", value=value) for value in (True, False))
    (result,) = node.set_parameters([other])
    refusal = "parameter 'use_sim_time' can be set only before the node starts"
    assert (result.successful, result.reason) == (False, refusal)
    assert node.get_parameter("use_sim_time").value
    assert node.get_clock().ros_time_is_active
    assert node.set_parameters([kept])[0].successful
    assert not node.set_parameters_atomically([Parameter("advance_samples", value=7), other]).successful
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


# use_sim_time.


SECOND = 1_000_000_000
LONGEST_BACKLOG = plant_program().lib.FJR_LONGEST_BACKLOG


class Player:
    """Publish /clock to a plant, one message at a time."""

    def __init__(self, ros: Ros, peer: Peer, begun: int = 0, **parameters: object) -> None:
        """begun: samples from 50 s on that are played at once, after a first message with that time."""
        self._ros, self._peer = ros, peer
        self._publisher = peer.create_publisher(Clock, "/clock", 1)
        self.node = ros.plant(use_sim_time=True, **parameters)
        if begun:
            self.play(50 * SECOND)
            self.run(50 * SECOND, begun)

    def play(self, time: int) -> None:
        """Publish a time [ns] and wait until the plant has processed it."""
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(time, SECOND)
        self._publisher.publish(message)
        self._ros.until(lambda: self.node.get_clock().now().nanoseconds == time, "the clock")
        self._ros.settle(5)

    def command(self, effort: float) -> None:
        """Publish a command and wait until the plant has received it."""
        before = self.node._health.count["commands received"]
        self._peer.effort_publisher.publish(command(effort))
        self._ros.until(lambda: self.node._health.count["commands received"] == before + 1, "the command")

    def run(self, start: int, samples: int) -> list[int]:
        """Publish a number of periods from `start` on; return the stamps of the states received."""
        before = len(self._peer.states)
        for k in range(samples + 1):
            self.play(start + k * PERIOD)
        return [nanoseconds(state) for state in self._peer.states[before:]]


def test_stamps_follow_the_clock_from_its_first_message_on_and_stop_with_it(ros: Ros, peer: Peer) -> None:
    player = Player(ros, peer)
    ros.settle(100)
    player.play(0)
    assert not peer.states
    assert player.node._health.count["states published"] == 0
    stamps = player.run(50 * SECOND, 30)
    assert stamps[-30:] == [50 * SECOND + (k + 1) * PERIOD for k in range(30)]
    count = len(peer.states)
    for _ in range(5):
        player.play(50 * SECOND + 30 * PERIOD)
    assert len(peer.states) == count
    player.play(50 * SECOND + 31 * PERIOD)
    player.play(50 * SECOND + 41 * PERIOD)
    assert [nanoseconds(state) for state in peer.states[count:]] == [50 * SECOND + k * PERIOD for k in (31, 41)]
    assert {tuple(state.position) for state in peer.states} == {(0.5, 0.5)}, "at rest until the first command"


def test_commands_act_and_end_by_the_clock(ros: Ros, peer: Peer) -> None:
    player = Player(ros, peer, command_timeout=0.005)
    player.run(50 * SECOND, 2)
    start = state_of(peer.states[-1])
    player.command(0.3)
    ros.settle(200)
    assert nanoseconds(peer.states[-1]) == 50 * SECOND + 2 * PERIOD, "the clock must not have advanced"
    player.run(50 * SECOND + 2 * PERIOD, 20)
    expected = integrate(integrate(start, 0.3, 20), 0.0, 60)
    np.testing.assert_allclose(state_of(peer.states[-1]), expected, rtol=1e-12)
    assert player.node._health.count["command timeouts"] == 1


@pytest.mark.parametrize(
    ("earlier", "after", "delay"),
    [
        (1, 1, 0),
        (100_000, 100_000, 0),
        (INNER, INNER, 0),
        (INNER // 2, INNER, 0),  # the later one acts at once
        (100_000, 100_000, 300_000),
        (INNER, INNER, 2 * INNER),
    ],
)
def test_a_command_acts_from_the_first_inner_step_at_or_after_its_arrival_and_replaces_one_that_has_not_acted(
    ros: Ros, peer: Peer, earlier: int, after: int, delay: int
) -> None:
    """Never earlier: it answers a state of before. earlier, after, delay [ns]: since a tick, and of its channel."""
    player = Player(ros, peer, begun=2, wait_for_command=False, imperfections__command_delay=delay * 1e-9)
    x = state_of(peer.states[-1])
    for arrival, effort in ((earlier, 0.2), (after, 0.3)):
        player.play(50 * SECOND + 2 * PERIOD + arrival)
        player.command(effort)
    player.run(50 * SECOND + 3 * PERIOD, 2)
    before = -(-(after + delay) // INNER)
    expected = integrate(integrate(x, 0.0, before), 0.3, 12 - before)
    assert nanoseconds(peer.states[-1]) == 50 * SECOND + 5 * PERIOD
    np.testing.assert_allclose(state_of(peer.states[-1]), expected, rtol=1e-12)


def test_a_reset_forgets_a_command_that_has_not_acted(ros: Ros, peer: Peer) -> None:
    player = Player(ros, peer, begun=2, wait_for_command=False, restart_silence=0.0)
    player.play(50 * SECOND + 2 * PERIOD + 1)
    player.command(0.3)
    peer.reset()
    player.run(50 * SECOND + 3 * PERIOD, 5)
    assert_one_motion(peer.states[-5:], effort=0.0)


def test_forward_jump_is_integrated_partly_and_counted(ros: Ros, peer: Peer) -> None:
    player = Player(ros, peer, begun=5, wait_for_command=False)
    count, before = len(peer.states), nanoseconds(peer.states[-1])
    player.play(51 * SECOND)
    assert [nanoseconds(state) for state in peer.states[count:]] == [before + LONGEST_BACKLOG]
    player.run(51 * SECOND + PERIOD, 4)
    assert nanoseconds(peer.states[-1]) == before + LONGEST_BACKLOG + 5 * PERIOD
    assert player.node._health.count["time lost"] == 1
    assert_one_motion(peer.states)


def test_stamps_continue_from_the_new_time_after_a_far_jump_of_the_clock(ros: Ros, peer: Peer, capfd) -> None:
    player = Player(ros, peer, begun=5, wait_for_command=False)
    assert_one_motion(peer.states)
    count = len(peer.states)
    assert player.run(60 * SECOND, 4) == [60 * SECOND + k * PERIOD for k in range(5)]
    assert_one_motion(peer.states[count:])
    for start in (20 * SECOND, 10 * SECOND):
        count, x = len(peer.states), state_of(peer.states[-1])
        stamps = player.run(start, 10)
        assert start < stamps[0] <= start + 2 * PERIOD, "at the first tick after the jump"
        np.testing.assert_array_equal(state_of(peer.states[count]), x)
        assert stamps[-1] == start + 10 * PERIOD
        assert_one_motion(peer.states[count:])
    assert player.node._health.count["clock jumps back"] == 2
    assert capfd.readouterr().err.count("jumped back") == 1
    last = nanoseconds(peer.states[-1])
    player.play(0)  # time stands still until the clock has a time again
    assert nanoseconds(peer.states[-1]) == last
    assert player.run(SECOND, 5)[-1] == SECOND + 5 * PERIOD
    assert all(nanoseconds(state) > 0 for state in peer.states)


def test_a_reset_after_a_jump_back_returns_to_a_time_of_the_clock(ros: Ros, peer: Peer) -> None:
    player = Player(ros, peer, wait_for_command=False, restart_silence=0.0)
    player.play(50 * SECOND)
    for k in range(20):
        player.play(50 * SECOND + k * 100 * PERIOD)
    player.run(SECOND, 10)
    peer.reset()
    player.play(SECOND + 11 * PERIOD)
    assert nanoseconds(peer.states[-1]) == SECOND + 11 * PERIOD
    np.testing.assert_allclose(state_of(peer.states[-1]), integrate(np.array([0.5, 0.5, 0, 0]), 0.0, 4), rtol=1e-12)


@pytest.mark.parametrize("jump", [1, -1])
def test_a_pause_outlasts_a_jump_of_the_clock(ros: Ros, peer: Peer, jump: int) -> None:
    player = Player(ros, peer, begun=5, wait_for_command=False, restart_silence=0.0)
    x, count = state_of(peer.states[-1]), len(peer.states)
    peer.pause(True)
    start = (50 + 40 * jump) * SECOND
    player.run(start, 5)
    assert len(peer.states) == count
    peer.pause(False)
    player.run(start + 6 * PERIOD, 5)
    np.testing.assert_allclose(state_of(peer.states[-1]), integrate(x, 0.0, 24), rtol=1e-12)


def test_advance_is_refused_before_the_first_clock_message(ros: Ros, peer: Peer) -> None:
    player = Player(ros, peer, start_paused=True, advance_samples=3)
    response = peer.advance()
    assert (response.success, response.message) == (False, "no time has been received on /clock; expected one first")
    player.play(SECOND)
    response = peer.advance()
    assert (response.success, response.message) == (True, "advanced by 3 samples: the time is 1.003000000 s")


def test_samples_are_delayed_by_the_period_jitter_while_enabled(ros: Ros, peer: Peer) -> None:
    """Ticks are 4 ms apart and the clock has steps of 1 ms, to which the delay of a sample is rounded up."""
    player = Player(ros, peer, wait_for_command=False, publish_rate=250.0, inner_steps=16)
    player.play(50 * SECOND)
    assert set(np.diff(player.run(50 * SECOND, 20))) == {4 * PERIOD}
    assert player.node.set_parameters([Parameter("imperfections.period_jitter", value=0.0025)])[0].successful
    late = np.array(player.run(50 * SECOND + 21 * PERIOD, 60)) % (4 * PERIOD)
    assert len(set(late)) > 2
    assert late.max() <= 3 * PERIOD
    assert_one_motion(peer.states)


# Stamps near the clock from the first state on, after a pause and after a reset; never back.


def stamped_after(ros: Ros, peer: Peer, instant: int) -> None:
    """Wait for a state stamped after the instant [ns]; fail if a stamp is in the future."""
    ros.until(lambda: nanoseconds(peer.states[-1]) >= instant, "a stamp of now")
    assert nanoseconds(peer.states[-1]) <= time.time_ns()


def test_stamps_equal_the_clock_when_time_starts_or_resumes(ros: Ros, peer: Peer) -> None:
    node = peer.plant(restart_silence=0.1, command_timeout=100.0)
    stamped_after(ros, peer, time.time_ns())
    end = time.monotonic() + 0.2
    ros.until(lambda: time.monotonic() > end)  # the first command is late
    stamped_after(ros, peer, time.time_ns())
    commanded = time.time_ns()
    peer.effort_publisher.publish(command(0.3))
    ros.until(lambda: peer.states[-1].effort[1] == 0.3, "motion")
    stamped_after(ros, peer, commanded)
    for kind, name, request in (
        (SetBool, "pause", {"data": False}),
        (Trigger, "reset", {}),
    ):
        peer.pause(kind is SetBool)
        instant = time.time_ns()
        peer.call(kind, f"fjr_plant/{name}", **request)
        answered, silent_until = time.time_ns(), instant + SECOND // 10
        stamped_after(ros, peer, silent_until)
        assert not [t for t in map(nanoseconds, peer.states) if answered < t < silent_until]
    assert node._time_base.plant.origin == NO_TIME, "after a reset the plant must wait for a command"
    stamps = [nanoseconds(state) for state in peer.states]
    assert stamps == sorted(stamps)
