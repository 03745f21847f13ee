# SPDX-License-Identifier: Apache-2.0
"""Stamps of /joint_states: near the clock from the first state on, after a pause and after a reset; never back."""

from __future__ import annotations

import time

import numpy as np
from std_srvs.srv import SetBool, Trigger

from fjr_msgs_py.native.host import NO_TIME
from nodes.harness import Peer, Ros, nanoseconds
from nodes.plants import PERIOD, call, command
from nodes.test_sim_time import SECOND, Player


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
        call(ros, peer, SetBool, "fjr_plant/pause", data=kind is SetBool)
        count, instant = len(peer.states), time.time_ns()
        call(ros, peer, kind, f"fjr_plant/{name}", **request)
        ros.until(lambda count=count: len(peer.states) > count + 5, "states again")
        assert nanoseconds(peer.states[-1]) >= instant
        stamped_after(ros, peer, instant)
    assert node._time_base.plant.origin == NO_TIME, "after a reset the plant must wait for a command"
    stamps = [nanoseconds(state) for state in peer.states]
    assert stamps == sorted(stamps)


def test_a_controller_recovers_from_a_reset(ros: Ros, peer: Peer) -> None:
    """The controller detects a silence and joins the reference without a jump or a large effort."""
    player = Player(ros, peer)
    controller = peer.controller(use_sim_time=True, state_timeout=0.5)
    player.run(50 * SECOND, 50)
    ros.until(lambda: peer.states[-1].position[0] != 0.5, "motion")
    assert call(ros, peer, Trigger, "fjr_plant/reset").success
    ros.settle()
    count = len(peer.efforts)  # commands for states before the reset have arrived
    for k in range(105):
        player.play(50 * SECOND + 50 * PERIOD + k * 10 * PERIOD)
    player.run(51 * SECOND + 100 * PERIOD, 100)
    counters = controller._control.step.counters
    assert (counters["silences"], counters["recoveries"]) == (1, 1)
    assert counters["reference restarts"] == counters["stops"] == 0
    assert max(abs(message.data[0]) for message in peer.efforts[count:]) < 2.0
    stamps = [nanoseconds(state) for state in peer.states]
    assert np.all(np.diff(stamps) >= 0)
    assert stamps[-1] > 51 * SECOND + 100 * PERIOD
