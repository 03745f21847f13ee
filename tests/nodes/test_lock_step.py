# SPDX-License-Identifier: Apache-2.0
"""Lock-step with a peer as the controller: no sample is skipped, only valid commands advance, runs are repeatable."""

from __future__ import annotations

import numpy as np
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from fjr_plant.lock_step import START, LockStepError
from nodes.harness import PATIENCE, Listener, Peer, Ros, nanoseconds
from nodes.plants import PERIOD, CommandLoop, answer, integrate, numbers, state_of


def test_unanswered_state_is_sent_again_and_never_skipped_without_a_change_of_any_bit(ros: Ros, peer: Peer) -> None:
    ignored = (2, 4, 5, 6, 11)
    node = peer.plant(lockstep=True)
    first = len(peer.states)
    CommandLoop(peer, tuple(first + k for k in ignored)).until(ros, 12)
    stamps = [nanoseconds(state) for state in peer.states]
    assert sorted(set(stamps)) == [START + k * PERIOD for k in range(13)]
    assert stamps == sorted(stamps)
    count = node._health.count
    assert count["states published"] == 13
    assert count["states sent again"] == len(stamps) - 13 >= len(ignored)
    assert (count["commands received"], count["states unanswered"]) == (12, 0)
    ros.close()
    with Ros() as again:
        plain = Peer(again)
        plain.plant(lockstep=True)
        CommandLoop(plain).until(again, 12)
        sent = {bits for state in peer.states for bits in numbers([state])}
        assert sent == set(numbers(plain.states)), "repeated states have the same numbers"


def test_only_the_command_for_the_state_advances(ros: Ros, peer: Peer) -> None:
    node = peer.plant(lockstep=True)
    first = peer.states[-1]
    later = answer(first, 5.0)
    later.header.stamp.nanosec += PERIOD
    missing = JointState(header=first.header, effort=[1.0])
    twice = JointState(header=first.header, name=["joint1", "joint1"], effort=[1.0, 1.0])
    for wrong in (later, missing, twice, answer(first, 1.0, ("joint2",)), answer(first, float("inf"))):
        peer.command_publisher.publish(wrong)
        ros.settle()
    assert {nanoseconds(state) for state in peer.states} == {START}
    count, refused = node._health.count, ("not finite", "duplicate joints", "missing joints")
    assert (count["answers to other states"], count["commands received"]) == (1, 0)
    assert [count[f"command refused: {kind}"] for kind in refused] == [1, 1, 2]
    assert peer.effort_publisher.get_subscription_count() == 1, "only this peer subscribes to the unstamped topic"
    named = answer(first, 0.25, ("elsewhere", "joint1"))
    named.effort = [9.0, 0.25]
    peer.command_publisher.publish(named)
    ros.until(lambda: nanoseconds(peer.states[-1]) == START + PERIOD)
    np.testing.assert_allclose(state_of(peer.states[-1]), integrate(state_of(first), 0.25, 4), rtol=1e-12)


def test_clock_shows_the_times_of_all_states_also_of_lost_ones(ros: Ros, peer: Peer) -> None:
    shown: list[int] = []
    peer.create_subscription(
        Clock, "/clock", lambda m: shown.append(m.clock.sec * 10**9 + m.clock.nanosec), QoSProfile(depth=1000)
    )
    lost = {"advance_samples": 40, "imperfections__state_loss": 0.5}
    node = ros.plant(lockstep=True, start_paused=True, use_sim_time=True, **lost)
    CommandLoop(peer).listen()
    assert peer.advance().success
    times = [START + k * PERIOD for k in range(41)]
    ros.until(lambda: shown[-1:] == times[-1:], "the last time")
    assert sorted(set(shown)) == times
    assert shown == sorted(shown)
    assert len({nanoseconds(state) for state in peer.states}) < 35, "many states must be lost"
    ros.until(lambda: node.get_clock().now().nanoseconds == times[-1], "its own clock")


def test_effort_expires_after_command_timeout_while_states_are_lost(ros: Ros, peer: Peer) -> None:
    """The first state arrives, and its command acts for command_timeout of robot time."""
    options = {"start_paused": True, "advance_samples": 30, "command_timeout": 0.02, "imperfections__state_loss": 1.0}
    node = ros.plant(lockstep=True, **options)
    CommandLoop(peer, effort=lambda _: 0.3).listen()
    for _ in range(2):  # twice: before and after a reset
        assert peer.advance().success
        expected = integrate(integrate(np.array([0.5, 0.5, 0.0, 0.0]), 0.3, 80), 0.0, 40)
        np.testing.assert_allclose(node._robot.x, expected, rtol=1e-13, atol=1e-16)  # the oracle is not compiled
        peer.reset()
    assert node._health.count["command timeouts"] == 2


def run_with_losses() -> tuple[list[tuple[int, bytes]], int]:
    """Return the states of 600 samples, most of them lost, and the number of silences that the controller detected."""
    with Ros() as ros:
        listener = Listener(ros)
        controller = ros.controller(use_sim_time=True, state_timeout=0.02, autostart=False)
        node = ros.plant(lockstep=True, start_paused=True, advance_samples=600, imperfections__state_loss=0.9)
        controller.trigger_configure()
        controller.trigger_activate()
        ros.meet()
        assert listener.advance().success
        assert node._robot.time == 600 * PERIOD
        ros.settle()
        return numbers(listener.states), controller._control.step.counters["silences"]


def test_two_runs_with_silences_in_simulated_time_are_bit_identical() -> None:
    one, other = run_with_losses(), run_with_losses()
    assert one == other
    assert len(one[0]) > 30
    assert one[1] > 3


def test_silent_controller_ends_the_plant_with_a_sentence(ros: Ros, peer: Peer, capfd) -> None:
    node = peer.plant(lockstep=True, lockstep_timeout=0.3)
    resent = len(peer.states)
    ros.until(lambda: len(peer.states) > resent + 5, "more than the timeout without a first answer")
    node._time_base.plant.timeout = round(PATIENCE * 1e9)  # commands may be late
    CommandLoop(peer).until(ros, 3)
    node._time_base.plant.timeout = 300_000_000
    ros.until(lambda: node.ended, "the end")
    assert isinstance(node.ended, LockStepError)
    assert str(node.ended).startswith(
        "the state of 1.003000000 s was not answered for 0.3 s (lockstep_timeout); expected a message on "
        "/joint_commands with that stamp and an effort for every joint, "
    )
    ros.until_said(capfd, f"ended: {node.ended}")  # only standard error reports it here, soon after
    count = len(peer.states)
    peer.command_publisher.publish(answer(peer.states[-1], 1.0))
    ros.settle(100)
    assert len(peer.states) == count
    assert node._robot.time == 3 * PERIOD


def test_silence_is_not_counted_while_paused_and_a_reset_waits_for_a_first_command_again(ros: Ros, peer: Peer) -> None:
    node = peer.plant(lockstep=True, lockstep_timeout=PATIENCE)
    loop = CommandLoop(peer)
    loop.until(ros, 3)
    node._time_base.pause(True)
    node._time_base.plant.first_sent_at -= round(2e9 * PATIENCE)
    ros.settle()
    node._time_base.pause(False)
    loop.until(ros, 5)
    node._time_base.reset()
    count = len(peer.states)
    node._time_base.plant.first_sent_at -= round(2e9 * PATIENCE)
    ros.until(lambda: len(peer.states) > count + 2, "the first state, again and again")
    assert {nanoseconds(state) for state in peer.states[count:]} == {START}
