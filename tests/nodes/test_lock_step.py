# SPDX-License-Identifier: Apache-2.0
"""Lock-step against a peer that plays the controller: nothing is skipped, nothing advances by mistake, runs repeat."""

from __future__ import annotations

import numpy as np
import pytest
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from fjr_plant.lock_step import START, LockStepError
from nodes.harness import Peer, Ros, nanoseconds
from nodes.plants import PERIOD, Answering, answer, integrate, numbers, state_of


@pytest.mark.parametrize("ignored", [(2,), (3, 4, 5), (2, 4, 7, 11)])
def test_a_state_without_an_answer_is_sent_again_and_never_skipped(ros: Ros, peer: Peer, ignored) -> None:
    node = ros.plant(lockstep=True)
    peer.meet_plant(lockstep=True)
    first = len(peer.states)
    Answering(peer, tuple(first + k for k in ignored)).until(ros, 12)
    stamps = [nanoseconds(state) for state in peer.states]
    assert sorted(set(stamps)) == [START + k * PERIOD for k in range(13)]
    assert stamps == sorted(stamps)
    assert len({bits for state in peer.states for bits in numbers([state])}) == 13, "sent again with the same numbers"
    count = node._health.count
    assert count["states published"] == 13
    assert count["states sent again"] == len(stamps) - 13 >= len(ignored)
    assert count["commands received"] == 12
    assert count["states unanswered"] == 0


def test_what_is_not_the_answer_never_advances(ros: Ros, peer: Peer) -> None:
    node = ros.plant(lockstep=True)
    peer.meet_plant(lockstep=True)
    first = peer.states[-1]
    later = answer(first, 5.0)
    later.header.stamp.nanosec += PERIOD
    missing = JointState(header=first.header, effort=[1.0])
    twice = JointState(header=first.header, name=["joint1", "joint1"], effort=[1.0, 1.0])
    for wrong in (later, missing, twice, answer(first, 1.0, ("joint2",)), answer(first, float("inf"))):
        peer.command_publisher.publish(wrong)
        ros.settle()
    assert {nanoseconds(state) for state in peer.states} == {START}
    assert node._health.count["answers to other states"] == 1
    assert node._health.count["commands received"] == 0
    named = answer(first, 0.25, ("elsewhere", "joint1"))
    named.effort = [9.0, 0.25]
    peer.command_publisher.publish(named)
    ros.until(lambda: nanoseconds(peer.states[-1]) == START + PERIOD)
    np.testing.assert_allclose(state_of(peer.states[-1]), integrate(state_of(first), 0.25, 4), rtol=1e-12)


def test_two_runs_are_bit_identical_whatever_is_lost(ros: Ros, peer: Peer) -> None:
    ros.plant(lockstep=True)
    peer.meet_plant(lockstep=True)
    plain = Answering(peer)
    plain.until(ros, 200)
    one = numbers(peer.states)
    ros.close()
    other_ros = Ros()
    try:
        other = Peer(other_ros)
        other_ros.plant(lockstep=True)
        other.meet_plant(lockstep=True)
        first = len(other.states)
        Answering(other, (first + 3, first + 90)).until(other_ros, 200)
        assert numbers(other.states) == one
    finally:
        other_ros.close()


def test_clock_comes_with_every_state_and_never_goes_back(ros: Ros, peer: Peer) -> None:
    clocks: list[int] = []
    peer.create_subscription(
        Clock, "/clock", lambda m: clocks.append(m.clock.sec * 10**9 + m.clock.nanosec), QoSProfile(depth=1000)
    )
    ros.plant(lockstep=True)
    peer.meet_plant(lockstep=True)
    ros.until(lambda: clocks, "the clock")
    before = len(peer.states) - len(clocks)
    Answering(peer).until(ros, 30)
    ros.settle()
    ros.until(lambda: len(clocks) == len(peer.states) - before, "a clock for each state")
    assert clocks == [nanoseconds(state) for state in peer.states[before:]]
    assert clocks == sorted(clocks)


def test_a_controller_that_falls_silent_ends_the_plant_with_a_sentence(ros: Ros, peer: Peer) -> None:
    ros.plant(lockstep=True, lockstep_timeout=0.3)
    peer.meet_plant(lockstep=True)
    resent = len(peer.states)
    ros.until(lambda: len(peer.states) > resent + 5, "more than the timeout without a first answer")
    Answering(peer).until(ros, 3)
    with pytest.raises(LockStepError) as ended:
        ros.until(lambda: False)
    assert str(ended.value) == (
        "the state of 1.003000000 s was not answered for 0.3 s (lockstep_timeout); expected a message on "
        "/joint_commands with that stamp and an effort for every joint, none has come"
    )


def test_a_paused_plant_does_not_count_the_silence(ros: Ros, peer: Peer) -> None:
    node = ros.plant(lockstep=True, lockstep_timeout=0.2)
    peer.meet_plant(lockstep=True)
    Answering(peer).until(ros, 3)
    node._pace.pause(True)
    ros.settle(200)
    node._pace.pause(False)
    Answering(peer).until(ros, 5)


def test_a_reset_waits_for_a_first_answer_again(ros: Ros, peer: Peer) -> None:
    node = ros.plant(lockstep=True, lockstep_timeout=0.2)
    peer.meet_plant(lockstep=True)
    Answering(peer).until(ros, 3)
    node._pace.reset()
    count = len(peer.states)
    ros.until(lambda: len(peer.states) > count + 5, "the first state, again and again")
    assert {nanoseconds(state) for state in peer.states[count:]} == {START}


def test_with_use_sim_time_the_plant_follows_its_own_clock(ros: Ros, peer: Peer) -> None:
    node = ros.plant(lockstep=True, use_sim_time=True)
    peer.meet_plant(lockstep=True)
    Answering(peer).until(ros, 30)
    ros.until(lambda: node.get_clock().now().nanoseconds == START + 30 * PERIOD, "its own clock")
