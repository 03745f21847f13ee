# SPDX-License-Identifier: Apache-2.0
"""The controller publishes the torque that is sent to the plant's ~/external_torque, through a low-pass."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import signal
from sensor_msgs.msg import JointState

from nodes.harness import Listener, Ros, nanoseconds

STEP = 0.3  # N m
L = 30.0  # 1/s
SAMPLES = 500
OBSERVED = {"measurement__velocity": "observer", "measurement__observer_bandwidth": 200.0}


@pytest.mark.parametrize(
    ("more", "poles", "tolerance"),
    [({}, [-L], 1e-3), ({"compile": False}, [-L], 1e-3), (OBSERVED, [-L, -200.0, -200.0], 0.07)],
    ids=["measured", "in Python", "observed"],
)
def test_torque_on_the_plant_is_published_through_the_low_pass(
    ros: Ros, more: dict[str, Any], poles: list[float], tolerance: float
) -> None:
    """With estimated velocities also through their observer; damping times their error, 0.2 / 0.031 * 2 / 200, adds."""
    peer, found = Listener(ros, only=()), []
    peer.create_subscription(JointState, "fjr_controller/external_torque", found.append, 1000)
    publisher = peer.create_publisher(JointState, "fjr_plant/external_torque", 1)
    ros.controller(use_sim_time=True, external_torque_bandwidth=L, **more)
    start = {"initial_link_position": [0.5], "initial_motor_position": [0.5]}
    node = ros.plant(lockstep=True, start_paused=True, advance_samples=SAMPLES, **start)

    def advanced(to: int) -> np.ndarray:
        """Advance the plant; return the estimates at the present state, which it repeats, and at the next SAMPLES."""
        assert peer.advance().success
        ros.until(lambda: found and nanoseconds(found[-1]) == 10**9 + to * 10**6, "the estimates")
        return np.array([message.effort[0] for message in found[-SAMPLES - 1 :]])

    assert np.abs(advanced(SAMPLES)[-100:]).max() < tolerance * STEP
    assert nanoseconds(found[0]) == 10**9 + (5_000_000 if more is OBSERVED else 0)  # until the velocities have settled
    publisher.publish(JointState(name=["joint1"], effort=[STEP]))
    ros.until(lambda: node._health.count["external torques received"] == 1)
    t = np.arange(SAMPLES + 1) * 1e-3
    wanted = STEP * signal.step(signal.ZerosPolesGain([], poles, np.prod(np.negative(poles))), T=t)[1]
    assert advanced(2 * SAMPLES) == pytest.approx(wanted, abs=tolerance * STEP)
    assert {tuple(message.name) for message in found} == {("joint1",)}
