# SPDX-License-Identifier: Apache-2.0
"""Lock-step with a peer as the controller: no sample is skipped, only valid commands advance, runs are repeatable.

~/advance: the exact number of samples, with the states of a continuous run.
"""

from __future__ import annotations

import threading

import numpy as np
import pytest
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from fjr_core import StateError
from fjr_plant.lock_step import START, LockStepError
from nodes.harness import PATIENCE, Listener, Peer, Ros, nanoseconds
from nodes.plants import PERIOD, CommandLoop, answer, command, integrate, numbers, state_of


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


# ~/advance, also in real time.


@pytest.mark.usefixtures("either_executor")
def test_lockstep_advances_by_the_exact_number_of_samples(ros: Ros, peer: Peer) -> None:
    node = ros.plant(lockstep=True, start_paused=True)
    CommandLoop(peer).listen()
    for samples, time in ((1, "1.001"), (7, "1.008"), (7, "1.015")):
        assert node.set_parameters([Parameter("advance_samples", value=samples)])[0].successful
        response = peer.advance()
        assert (response.success, response.message) == (
            True,
            f"advanced by {samples} samples: the time is {time}000000 s",
        )
        ros.settle()
        assert nanoseconds(peer.states[-1]) == START + node._robot.time
    assert not node.set_parameters([Parameter("advance_samples", value=0)])[0].successful
    assert sorted({nanoseconds(state) for state in peer.states}) == [START + k * PERIOD for k in range(16)]


def test_lockstep_in_steps_is_bit_identical_to_a_run(ros: Ros, peer: Peer) -> None:
    node = ros.plant(lockstep=True, start_paused=True, advance_samples=10)
    CommandLoop(peer).listen()
    for _ in range(3):
        assert peer.advance().success
    strides = numbers(peer.states)
    del peer.states[:]
    peer.reset()
    assert not peer.states, "a paused robot must send nothing"
    peer.pause(False)
    ros.until(lambda: node._robot.time > 30 * PERIOD)
    run = dict(numbers(peer.states))
    ros.until(lambda: len(strides) == 31)
    assert [(stamp, run[stamp]) for stamp, _ in strides] == strides


def test_real_time_advances_at_once_with_the_held_effort(ros: Ros, peer: Peer) -> None:
    node = peer.plant(command_timeout=100.0, advance_samples=25, restart_silence=0.1)
    peer.effort_publisher.publish(command(0.3))
    ros.until(lambda: peer.states[-1].effort[1] == 0.3)
    peer.pause(True)
    ros.settle()
    time, x, count = node._robot.time, node._robot.x, len(peer.states)
    assert peer.advance().success
    assert node._robot.time == time + 25 * PERIOD
    np.testing.assert_allclose(node._robot.x, integrate(x, 0.3, 100), rtol=1e-13, atol=1e-16)
    ros.until(lambda: nanoseconds(peer.states[-1]) == node._time_base.stamp)
    stamps = [nanoseconds(state) for state in peer.states[count:]]
    assert stamps == [node._time_base.stamp - (24 - k) * PERIOD for k in range(25)]
    peer.pause(False)
    assert node._robot.time == time + 25 * PERIOD, "the motion must continue from its state"
    count = len(peer.states)
    ros.until(lambda: len(peer.states) > count)
    assert nanoseconds(peer.states[count]) > stamps[-1]


@pytest.mark.parametrize("lockstep", [True, False])
def test_advance_is_refused_while_running(ros: Ros, peer: Peer, lockstep: bool) -> None:
    ros.plant(lockstep=lockstep)
    response = peer.advance()
    assert not response.success
    assert response.message == "robot time is running; expected a paused robot: call ~/pause with true first"


INTERRUPTIONS = {
    "reset": (Trigger, "fjr_plant/reset", {}, "reset after 2 of 5 samples: the time is 1.002000000 s"),
    "pause": (SetBool, "fjr_plant/pause", {"data": True}, "paused after 2 of 5 samples: the time is 1.002000000 s"),
    "go": (SetBool, "fjr_plant/pause", {"data": False}, "resumed after 2 of 5 samples: the time is 1.002000000 s"),
}


@pytest.mark.parametrize("case", INTERRUPTIONS)
def test_interrupted_advance_fails_with_a_sentence(ros: Ros, peer: Peer, case: str) -> None:
    kind, name, request, sentence = INTERRUPTIONS[case]
    node = ros.plant(lockstep=True, start_paused=True, advance_samples=5)
    pending = peer.request(Trigger, "fjr_plant/advance")
    for k in range(2):
        ros.until(lambda k=k: peer.states and nanoseconds(peer.states[-1]) == START + k * PERIOD)
        peer.command_publisher.publish(answer(peer.states[-1], 0.1))
    ros.until(lambda: node._robot.time == 2 * PERIOD)
    again = peer.advance()
    assert (again.success, again.message) == (False, "already advancing: 3 of 5 samples are left")
    assert peer.call(kind, name, **request).success
    ros.until(pending.done, "the answer")
    assert (pending.result().success, pending.result().message) == (False, sentence)
    assert node._time_base.paused == (case != "go")
    peer.command_publisher.publish(answer(peer.states[-1], 0.1))
    ros.settle()
    assert node._robot.time == {"reset": 0, "pause": 2 * PERIOD, "go": 3 * PERIOD}[case]


@pytest.mark.parametrize("what", ["reset", "pause"])
def test_an_advance_is_interrupted_on_the_thread_that_counts_its_samples(ros: Ros, what: str) -> None:
    """Else that thread may overwrite the end with the samples that were left, and the robot moves on after a reset."""
    base = ros.plant(lockstep=True, start_paused=True)._time_base
    replied: list[int] = []
    base.advance(5, lambda *_: replied.append(threading.get_ident()))
    base.reset() if what == "reset" else base.pause(True)
    assert replied == [base.host.run(threading.get_ident)] != [threading.get_ident()]


def test_advance_fails_with_a_sentence_when_the_node_ends(ros: Ros, peer: Peer) -> None:
    node = ros.plant(lockstep=True, lockstep_timeout=0.2, start_paused=True, advance_samples=5)
    pending = peer.request(Trigger, "fjr_plant/advance")
    ros.until(lambda: peer.states, "a state")
    peer.command_publisher.publish(answer(peer.states[-1], 0.1))
    ros.until(pending.done, "the answer")
    assert isinstance(node.ended, LockStepError)
    assert not pending.result().success
    assert pending.result().message == "ended after 1 of 5 samples: the time is 1.001000000 s"


def test_divergence_during_an_advance_ends_the_node_with_a_response(ros: Ros, peer: Peer) -> None:
    node = peer.plant(advance_samples=100, command_timeout=100.0)
    peer.pause(True)
    node._robot.u = np.array([1e308])
    response = peer.advance()
    assert isinstance(node.ended, StateError)
    assert not response.success
    assert response.message.startswith("ended after ")
    assert str(node.ended).startswith("the state of the robot is not finite after ")
    assert all(np.isfinite(state.position).all() for state in peer.states)
    time = node._robot.time
    peer.call(SetBool, "fjr_plant/pause", data=False)
    ros.settle()
    assert node._robot.time == time, "it must do nothing more"


def test_vanished_client_does_not_disturb_others(ros: Ros, peer: Peer) -> None:
    node = ros.plant(lockstep=True, start_paused=True)
    client = peer.create_client(Trigger, "fjr_plant/advance")
    ros.until(client.service_is_ready)
    client.call_async(Trigger.Request())
    ros.until(lambda: peer.states)
    peer.destroy_client(client)
    peer.command_publisher.publish(answer(peer.states[-1], 0.1))
    ros.until(lambda: node._robot.time == PERIOD)
    CommandLoop(peer).listen()
    assert peer.advance().success
