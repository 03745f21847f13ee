# SPDX-License-Identifier: Apache-2.0
"""The native loop of the plant: the states of the loop in rclpy, and a fault that is not silent."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from std_srvs.srv import Trigger

from fjr_plant.host import NativePlantHost, RclpyPlantHost
from fjr_plant.native import plant_program
from fjr_plant.time_base import SendError
from nodes.harness import Peer, Ros, nanoseconds
from nodes.plants import INNER, PERIOD, CommandLoop, call, command, integrate, numbers, state_of
from time_limits import Limit

SAMPLES = 300
BAD = {
    "imperfections__motor_coulomb_friction": [0.05],
    "imperfections__actuator_lag": [2e-3],
    "imperfections__motor_encoder_bits": [14.0],
    "imperfections__link_position_noise": [1e-4],
    "imperfections__link_velocity_noise": [1e-2],
    "imperfections__state_delay": 1.5e-3,
    "imperfections__state_jitter": 2e-3,
    "imperfections__state_loss": 0.1,
    "imperfections__state_repetition": 0.1,
    "imperfections__command_jitter": 1e-3,
    "imperfections__command_loss": 0.1,
    "imperfections__period_jitter": 0.4e-3,
}


def states_of(host: str, **parameters: Any) -> tuple[list[tuple[int, bytes]], dict[str, int]]:
    """Return the states of SAMPLES samples in lock-step, and the counters of the plant."""
    ros = Ros()
    try:
        peer = Peer(ros)
        options = {"lockstep": True, "start_paused": True, "advance_samples": SAMPLES}
        node = ros.plant(executor=host, compile=True, **options, **parameters)
        assert isinstance(node._time_base.host, NativePlantHost if host == "native" else RclpyPlantHost)
        CommandLoop(peer).listen()
        assert call(ros, peer, Trigger, "fjr_plant/advance").success
        ros.settle()
        count = dict(node._health.count)
        for busy in ("states sent again", "answers to other states"):
            del count[busy]
        return numbers(peer.states), count
    finally:
        ros.close()


@pytest.mark.parametrize("parameters", [{}, BAD], ids=["ideal", "non-ideal"])
def test_both_hosts_send_the_same_bits_in_lock_step(parameters: dict[str, Any]) -> None:
    one, other = states_of("events", **parameters), states_of("native", **parameters)
    assert one == other
    assert len(one[0]) > SAMPLES / 2


def test_the_native_plant_keeps_its_time_while_the_executor_is_blocked(ros: Ros, peer: Peer) -> None:
    node = peer.plant(executor="native", compile=True, command_timeout=100.0)
    peer.effort_publisher.publish(command(0.3))
    ros.until(lambda: node._robot.time > 0, "motion")
    before, published = node._robot.time, node._health.count["states published"]
    limit = Limit(10.0)
    while node._robot.time < before + 50 * PERIOD:  # nothing spins
        assert not limit.passed()
    assert node._health.count["states published"] > published
    ros.settle()
    start, last = state_of(peer.states[0]), peer.states[-1]
    steps, rest = divmod(nanoseconds(last) - node._time_base.offset, INNER)
    assert rest == 0
    np.testing.assert_allclose(state_of(last), integrate(start, 0.3, steps), rtol=1e-11, atol=1e-14)


@pytest.mark.parametrize("lockstep", [False, True])
def test_a_fault_in_the_thread_ends_the_node_with_one_sentence(ros: Ros, peer: Peer, lockstep: bool, capfd) -> None:
    node = ros.plant(executor="native", compile=True, lockstep=lockstep)
    peer.meet_plant(lockstep=lockstep)
    host = node._time_base.host
    assert isinstance(host, NativePlantHost)
    host.state.publisher[0] = plant_program().ffi.cast("void*", host.subscription.address)  # no publisher
    ros.until(lambda: node.ended, "the end")
    assert isinstance(node.ended, SendError)
    assert str(node.ended).startswith("a message could not be sent: rcl_publish_serialized_message returned")
    said = [""]
    ros.until(lambda: said.append(capfd.readouterr().err) or "ended: " in "".join(said), "the sentence in the log")
    ros.settle()
    assert ("".join(said) + capfd.readouterr().err).count("ended: ") == 1


@pytest.mark.parametrize(
    ("parameters", "why"),
    [
        ({"compile": False}, "the plant is evaluated in Python (compile is false, or a plant of one's own)"),
        ({"compile": True, "use_sim_time": True}, "the time comes from /clock"),
    ],
)
def test_the_reason_for_another_host_is_logged(ros: Ros, capfd, parameters: dict[str, Any], why: str) -> None:
    node = ros.plant(executor="native", **parameters)
    assert isinstance(node._time_base.host, RclpyPlantHost)
    assert f"the plant runs in rclpy's executor instead of a native thread: {why}\n" in capfd.readouterr().err
