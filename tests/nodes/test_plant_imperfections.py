# SPDX-License-Identifier: Apache-2.0
"""Imperfections of the plant node: each can change while it runs, invalid values are refused, runs are repeatable."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from rclpy.parameter import Parameter
from scipy.integrate import solve_ivp
from sensor_msgs.msg import JointState

import fjr_core as fjr
from fjr_core.config.plant import imperfection_parameters
from fjr_plant.lock_step import START
from nodes.harness import Peer, Ros, nanoseconds
from nodes.plants import INNER, PERIOD, CommandLoop, command, integrate, numbers, state_of

STRIDE = 8  # samples
TABLE = {parameter.name.removeprefix("imperfections."): parameter for parameter in imperfection_parameters(1)}
DEFAULTS = {
    name: list(parameter.default) if isinstance(parameter.default, tuple) else parameter.default
    for name, parameter in TABLE.items()
    if parameter.dynamic
}


def put(node: Any, **imperfections: Any) -> Any:
    """Set imperfections of the running node; return the result of the parameter service."""
    named = [Parameter(f"imperfections.{name}", value=value) for name, value in imperfections.items()]
    return node.set_parameters_atomically(named)


class Run:
    """A plant in lock-step and a peer that answers it; every run begins with an ideal robot and a reset."""

    def __init__(self, ros: Ros) -> None:
        self.ros, self.peer = ros, Peer(ros)
        self.node = ros.plant(lockstep=True, start_paused=True, advance_samples=STRIDE, initial_link_velocity=[3.0])
        CommandLoop(self.peer, effort=lambda s: 0.5 - 0.2 * s.position[0]).listen()

    def __call__(self, base: dict[str, Any], later: dict[str, Any]) -> tuple[list, list, int]:
        """Return stamps and numbers before and after the change to `later`, and the number of published states."""
        defaults = {
            name.removeprefix("imperfections."): value for name, value in DEFAULTS.items() if "seed" not in name
        }
        assert put(self.node, **{**defaults, **base}).successful
        self.peer.reset()
        published = self.node._health.count["states published"]
        before = self.stride()
        assert put(self.node, **later).successful
        after = self.stride()
        return before, after, self.node._health.count["states published"] - published

    def stride(self) -> list[tuple[int, bytes]]:
        del self.peer.states[:]
        response = self.peer.advance()
        assert response.success
        self.ros.settle(10)
        return numbers(self.peer.states)


@pytest.fixture(scope="module")
def run() -> Iterator[Run]:
    with Ros() as ros:
        yield Run(ros)


CASES: dict[str, tuple[dict[str, Any], Any]] = {  # one of each part: values set before it, its new value
    "motor_coulomb_friction": ({"friction_smoothing_velocity": [0.1]}, [0.002]),
    "payload_position": ({"payload_mass": 0.2}, [0.1, 0.0, -0.2]),
    "link_position_noise": ({}, [1e-3]),
    "publish_velocity": ({}, False),
    "state_jitter": ({}, 0.004),
    "command_repetition": ({"command_jitter": 0.003}, 1.0),
    "messages_in_order": ({"command_jitter": 0.005}, False),
    "period_jitter": ({}, 0.0009),
}


@pytest.mark.parametrize("name", CASES)
def test_imperfection_takes_effect_at_its_change(run: Run, name: str) -> None:
    base, value = CASES[name]
    unchanged, changed = run(base, {}), run(base, {name: value})
    assert changed[0] == unchanged[0], "runs must be bit-identical until then"
    assert changed[1:] != unchanged[1:]


NONSENSE = {
    "link_coulomb_friction": ([-1.0], "0.0"),
    "period_jitter": (0.001, "less than the period"),
    "motor_coulomb_friction": ([1e6], "friction damps with"),
    "seed": (3, "read-only"),
}


@pytest.mark.parametrize("name", NONSENSE)
def test_invalid_values_are_refused_with_a_sentence_and_change_nothing(run: Run, name: str) -> None:
    value, words = NONSENSE[name]
    before = run({}, {})
    old = dict(run.node.values)
    result = put(run.node, link_velocity_noise=[0.1], **{name: value})
    assert not result.successful
    assert words in result.reason
    assert run.node.values == old
    run.peer.reset()
    assert (run.stride(), run.stride()) == before[:2], "valid values set together with it must be refused, too"


def test_delayed_command_acts_exactly_after_the_delay(run: Run) -> None:
    """With a delay of 2.5 samples, u_k takes effect in the middle of a sample."""
    later, x = [], fjr.single_link().state([0.5], [0.5], [3.0], [0.0])
    before, after, _ = run({"command_delay": 0.0025}, {})
    states = dict(before + after)
    efforts = []
    for k in range(2 * STRIDE):
        efforts.append(0.5 - 0.2 * float(np.frombuffer(states[START + k * PERIOD])[0]))
        for step in range(4):
            due = (4 * k + step - 10) // 4
            x = integrate(x, efforts[due] if due >= 0 else 0.0, 1)
        later.append(x)
    position = [np.frombuffer(states[START + k * PERIOD])[:2] for k in range(1, 2 * STRIDE + 1)]
    np.testing.assert_allclose(position, [x[:2] for x in later], rtol=1e-13)


def test_delayed_state_is_answered_on_arrival(run: Run) -> None:
    """Each state arrives two samples late; the robot does not wait for it."""
    before, after, _ = run({"state_delay": 0.002}, {})
    assert list(dict(before + after)) == [START + k * PERIOD for k in range(2 * STRIDE - 1)]
    assert run.node._robot.time == 2 * STRIDE * PERIOD


def test_lost_state_is_not_waited_for_and_runs_with_losses_are_repeatable(run: Run) -> None:
    losses = {"state_loss": 0.4, "command_loss": 0.2, "state_jitter": 0.002, "link_position_noise": [1e-3]}
    one, other = run(losses, {}), run(losses, {})
    assert one == other
    assert len(one[0] + one[1]) < 2 * STRIDE
    assert run.node._robot.time == 2 * STRIDE * PERIOD


def test_plant_that_loses_all_messages_can_be_stopped(run: Run) -> None:
    run({}, {"state_loss": 1.0})
    run.peer.pause(False)
    time = run.node._robot.time
    run.ros.until(lambda: run.node._robot.time > time + 1200 * PERIOD, "the passing of samples")
    run.peer.pause(True)
    time = run.node._robot.time
    run.ros.settle()
    assert run.node._robot.time == time


# Real time.


def test_real_time_states_are_late_lost_and_repeated(ros: Ros, peer: Peer) -> None:
    node, ages = peer.plant(command_timeout=1000.0), []
    peer.effort_publisher.publish(command(0.3))
    ros.until(lambda: peer.states[-1].effort[1] == 0.3)

    def heard(state: JointState) -> None:
        node._time_base.change(lambda: None)  # robot time equals clock time only then
        ages.append(node._time_base.stamp - nanoseconds(state))

    peer.create_subscription(JointState, "joint_states", heard, 1000)
    assert put(node, state_delay=0.05).successful
    count = len(peer.states)
    ros.until(lambda: len(peer.states) > count + 30, "delayed states")
    assert min(ages[-20:]) >= 50 * PERIOD - INNER
    assert put(node, state_delay=0.0).successful
    ros.until(lambda: node._time_base.stamp - nanoseconds(peer.states[-1]) < 50 * PERIOD)
    stamps = [nanoseconds(state) for state in peer.states]
    assert stamps == sorted(stamps)
    assert put(node, state_loss=1.0, command_loss=1.0).successful
    count = 0

    def silent() -> bool:
        nonlocal count
        before, count = count, ros.settle() or len(peer.states)
        return count == before

    ros.until(silent, "the end of the states")
    peer.effort_publisher.publish(command(0.1))
    ros.until(lambda: node._health.count["commands received"] == 2)
    ros.settle()
    assert len(peer.states) == count
    assert put(node, state_loss=0.0, state_repetition=1.0).successful
    ros.until(lambda: len(peer.states) > count + 20, "states again")
    stamps = [nanoseconds(state) for state in peer.states[count:]]
    assert stamps[0:20:2] == stamps[1:20:2]
    assert peer.states[-1].effort[1] == 0.3, "the second command must be lost"


# External torques.


def pushed(x: np.ndarray, torque: float, seconds: float) -> np.ndarray:
    """Integrate eq. (36) with a torque on the link by SciPy."""
    plant = fjr.Plant(fjr.single_link())
    push = np.array([0.0, 0.0, torque, 0.0])
    solved = solve_ivp(lambda _, x: plant.derivative(x, [0.0]) + push, (0, seconds), x, rtol=1e-11, atol=1e-13)
    return solved.y[:, -1]


def test_external_torque_acts_until_the_next_message_or_a_reset(ros: Ros, peer: Peer) -> None:
    publisher = peer.create_publisher(JointState, "fjr_plant/external_torque", 1)
    node = ros.plant(start_paused=True, advance_samples=100)
    publisher.publish(JointState(name=["elbow"], effort=[0.8]))
    ros.until(lambda: node._health.count["external torque refused: unknown joints"] == 1)
    assert not node._robot.external.any()
    x = np.array([0.5, 0.5, 0.0, 0.0])
    for count, (names, effort) in enumerate(((["joint1"], [0.8]), (["joint1"], [-0.3]), ([], [])), 1):
        publisher.publish(JointState(name=names, effort=effort))
        ros.until(lambda count=count: node._health.count["external torques received"] == count)
        assert peer.advance().success
        x = pushed(x, sum(effort), 0.1)
        ros.until(lambda count=count: len(peer.states) == 100 * count)
        np.testing.assert_allclose(state_of(peer.states[-1]), x, rtol=1e-6, atol=1e-8)
    publisher.publish(JointState(name=["joint1"], effort=[0.8]))
    ros.until(lambda: node._health.count["external torques received"] == 4)
    peer.reset()
    assert not node._robot.external.any()
