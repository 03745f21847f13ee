# SPDX-License-Identifier: Apache-2.0
"""Robot time follows a /clock of another node with use_sim_time; stamps are near the clock and never go back."""

from __future__ import annotations

import time

import numpy as np
import pytest
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool, Trigger

from fjr_msgs_py.native.loop import NO_TIME
from fjr_plant.native import plant_program
from nodes.harness import Peer, Ros, nanoseconds
from nodes.plants import INNER, PERIOD, command, integrate, state_of

SECOND = 1_000_000_000
LONGEST_BACKLOG = plant_program().lib.FJR_LONGEST_BACKLOG


class Player:
    """Publish /clock to a plant, one message at a time."""

    def __init__(self, ros: Ros, peer: Peer, **parameters: object) -> None:
        self._ros, self._peer = ros, peer
        self._publisher = peer.create_publisher(Clock, "/clock", 1)
        self.node = ros.plant(use_sim_time=True, **parameters)

    def play(self, time: int) -> None:
        """Publish a time [ns] and wait until the plant has processed it."""
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(time, SECOND)
        self._publisher.publish(message)
        self._ros.until(lambda: self.node.get_clock().now().nanoseconds == time, "the clock")
        self._ros.settle(5)

    def run(self, start: int, samples: int) -> list[int]:
        """Publish a number of periods from `start` on; return the stamps of the states received."""
        before = len(self._peer.states)
        for k in range(samples + 1):
            self.play(start + k * PERIOD)
        return [nanoseconds(state) for state in self._peer.states[before:]]


def assert_one_motion(states: list) -> None:
    """Check that the motion without effort between two states agrees with their stamps."""
    x, stamp = state_of(states[0]), nanoseconds(states[0])
    for state in states[1:]:
        steps, rest = divmod(nanoseconds(state) - stamp, INNER)
        assert rest == 0
        x, stamp = integrate(x, 0.0, steps), nanoseconds(state)
        np.testing.assert_allclose(state_of(state), x, rtol=1e-12, atol=1e-15)


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
    peer.effort_publisher.publish(command(0.3))
    ros.until(lambda: player.node._health.count["commands received"] == 1)
    ros.settle(200)
    assert nanoseconds(peer.states[-1]) == 50 * SECOND + 2 * PERIOD, "the clock must not have advanced"
    player.run(50 * SECOND + 2 * PERIOD, 20)
    expected = integrate(integrate(start, 0.3, 20), 0.0, 60)
    np.testing.assert_allclose(state_of(peer.states[-1]), expected, rtol=1e-12)
    assert player.node._health.count["command timeouts"] == 1


def test_forward_jump_is_integrated_partly_and_counted(ros: Ros, peer: Peer) -> None:
    player = Player(ros, peer, wait_for_command=False)
    player.play(50 * SECOND)
    player.run(50 * SECOND, 5)
    count, before = len(peer.states), nanoseconds(peer.states[-1])
    player.play(51 * SECOND)
    assert [nanoseconds(state) for state in peer.states[count:]] == [before + LONGEST_BACKLOG]
    player.run(51 * SECOND + PERIOD, 4)
    assert nanoseconds(peer.states[-1]) == before + LONGEST_BACKLOG + 5 * PERIOD
    assert player.node._health.count["time lost"] == 1
    assert_one_motion(peer.states)


def test_stamps_continue_from_the_new_time_after_a_far_jump_of_the_clock(ros: Ros, peer: Peer, capfd) -> None:
    player = Player(ros, peer, wait_for_command=False)
    player.play(50 * SECOND)
    player.run(50 * SECOND, 5)
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
    player = Player(ros, peer, wait_for_command=False, restart_silence=0.0)
    player.play(50 * SECOND)
    player.run(50 * SECOND, 5)
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
        count, instant = len(peer.states), time.time_ns()
        peer.call(kind, f"fjr_plant/{name}", **request)
        ros.until(lambda count=count: len(peer.states) > count + 5, "states again")
        assert nanoseconds(peer.states[-1]) >= instant
        stamped_after(ros, peer, instant)
    assert node._time_base.plant.origin == NO_TIME, "after a reset the plant must wait for a command"
    stamps = [nanoseconds(state) for state in peer.states]
    assert stamps == sorted(stamps)
