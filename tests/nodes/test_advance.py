# SPDX-License-Identifier: Apache-2.0
"""~/advance: the exact number of samples, with the states of a continuous run."""

from __future__ import annotations

import numpy as np
import pytest
from rclpy.parameter import Parameter
from std_srvs.srv import SetBool, Trigger

from fjr_core import StateError
from fjr_plant.lock_step import START, LockStepError
from nodes.harness import Peer, Ros, nanoseconds
from nodes.plants import PERIOD, CommandLoop, answer, command, integrate, numbers


def assert_close(x: np.ndarray, expected: np.ndarray) -> None:
    """Compare states; the oracle is not compiled and rounds each product and sum."""
    np.testing.assert_allclose(x, expected, rtol=1e-13, atol=1e-16)


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
    assert_close(node._robot.x, integrate(x, 0.3, 100))
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
