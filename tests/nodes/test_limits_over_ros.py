# SPDX-License-Identifier: Apache-2.0
"""Safety and measurement in the node. tests/tracking/test_limits.py tests that each parameter reaches the settings."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus

import fjr_core as fjr
from nodes.harness import Peer, Ros, stamped
from nodes.managed import Manager
from tracking.tracked import OBSERVED

ROBOT = fjr.single_link()
PLACE = ([0.5, 0.52], [0.3, -0.2])  # positions and velocities of link and motor


def at(t: float = 0.0) -> Any:
    return stamped(t, *PLACE)


def effort(ros: Ros, peer: Peer, **parameters: Any) -> float:
    """Return the first effort of a controller with these parameters."""
    peer.controller(**parameters)
    return float(peer.ask(at()).effort[0])


def check_observed(peer: Peer, state: Any) -> None:
    """Check that the effort is zero while the observer settles, then the law's with the observer's velocities."""
    law, observer = fjr.TrackingLaw(ROBOT, fjr.PAPER_GAINS), fjr.VelocityObserver(ROBOT, 150.0)
    for k in range(OBSERVED + 1):
        observer.update(k * 1_000_000, [0.5], [0.52], [0.0])
        state.header.stamp = at(0.001 * k).header.stamp
        command = peer.ask(state)
        assert bool(command.effort[0]) == (k == OBSERVED)
    u, _ = law.measured_command(observer.state[:2], observer.state[2:], fjr.Sine(1.0, 1.0).jets(0.001 * OBSERVED))
    np.testing.assert_allclose(command.effort, u, rtol=1e-9)


def test_a_violated_limit_of_the_state_stops_until_a_resume(ros: Ros) -> None:
    manager = Manager(ros)
    manager.controller(on_stop="gravity_hold")
    assert manager.set(limits__motor_velocity=[0.21]) == (True, "")
    law = float(manager.ask(at()).effort[0])
    assert abs(law) > 5.0
    assert manager.set(limits__motor_velocity=[0.19]) == (True, "")
    held = ROBOT.grad_P_l([0.5])[0] - 0.3 * -0.2
    assert float(manager.ask(at(0.001)).effort[0]) == pytest.approx(held)
    ros.until(lambda: any(e.name == "stops" and "motor velocity" in e.message for e in manager.events), "the event")
    assert manager.set(limits__motor_velocity=[0.21], on_stop="zero")[0]
    assert float(manager.ask(at(0.002)).effort[0]) == 0.0, "a stop must be latched"
    assert manager.trigger("resume")[0]
    assert float(manager.ask(at(0.003)).effort[0]) == 0.0, "the first effort must be the last one sent"
    assert float(manager.ask(at(0.05)).effort[0]) != 0.0


def test_the_effort_changes_no_faster_than_its_rate(ros: Ros, peer: Peer) -> None:
    assert effort(ros, peer, limits__effort_rate=[100.0]) == 0.0
    efforts = [float(peer.ask(at(0.001 * k)).effort[0]) for k in range(1, 4)]
    np.testing.assert_allclose(efforts, [-0.1, -0.2, -0.3])
    ros.until(lambda: peer.count("efforts rate limited", "fjr_controller"), "the counter")
    (status,) = [each for each in peer.diagnostics[-1].status if each.name == "fjr_controller"]
    assert status.level == DiagnosticStatus.OK, "a limited rate is what its setting asks for"


def test_a_start_begins_with_a_transition_from_the_measured_state(ros: Ros, peer: Peer) -> None:
    peer.controller(start__join_time=0.5, limits__acceleration=[50.0])
    peer.answer(at())
    first, wanted = peer.references[-1], fjr.Sine(1.0, 1.0)
    assert (first.position[0], first.velocity[0]) == pytest.approx((0.5, 0.3), abs=1e-12)
    peer.answer(at(0.49))
    assert peer.references[-1].position[0] != wanted.jets(0.49)[0, 0]
    peer.answer(at(0.5))
    assert peer.references[-1].position[0] == pytest.approx(wanted.jets(0.5)[0, 0])


def test_positions_alone_suffice_with_an_observer(ros: Ros, peer: Peer) -> None:
    peer.controller(measurement__velocity="observer")
    bare = at()
    bare.velocity = []
    check_observed(peer, bare)


def test_motor_turns_are_divided_by_the_gear_ratio(ros: Ros, peer: Peer) -> None:
    plain = effort(ros, peer, measurement__gear_ratio=[50.0])
    law = fjr.TrackingLaw(ROBOT, fjr.PAPER_GAINS)
    x = ROBOT.state(0.5, 0.52 / 50, 0.3, -0.2 / 50)
    assert plain == pytest.approx(float(law.command(x, fjr.Sine(1.0, 1.0).jets(0.0))[0]))


def test_a_torque_sensor_replaces_the_motor_encoder(ros: Ros, peer: Peer) -> None:
    peer.controller(measurement__motor="torque", measurement__velocity="observer")
    state = stamped(0.0, 0.5, names=["joint1"])
    state.velocity, state.effort = [], [31.0 * 0.02]
    check_observed(peer, state)


def test_the_bandwidth_of_the_observer_is_the_parameter(ros: Ros) -> None:
    seen = []
    for bandwidth in (50.0, 300.0):
        peer = Peer(ros)
        node = peer.controller(measurement__velocity="observer", measurement__observer_bandwidth=bandwidth)
        for k in range(40):
            state = stamped(0.001 * k, [0.5 + 1e-5 * k**2, 0.52])
            state.velocity = []
            seen.append(float(peer.ask(state).effort[0]))
        for each in (node, peer):
            ros.executor.remove_node(each)
            each.destroy_node()
        ros._nodes = [each for each in ros._nodes if each not in (node, peer)]
    assert seen[0] == pytest.approx(seen[40])
    assert seen[39] != pytest.approx(seen[79], rel=1e-3)
