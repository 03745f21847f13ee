# SPDX-License-Identifier: Apache-2.0
"""Each parameter of safety and measurement has its effect in the node."""

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
STOPS = [  # parameter, a value violated at PLACE, one that is not, kind
    ("link_position_lower", 0.51, 0.49, "link position"),
    ("link_position_upper", 0.49, 0.51, "link position"),
    ("motor_position_lower", 0.53, 0.51, "motor position"),
    ("motor_position_upper", 0.51, 0.53, "motor position"),
    ("link_velocity", 0.29, 0.31, "link velocity"),
    ("motor_velocity", 0.19, 0.21, "motor velocity"),
    ("deflection", 0.019, 0.021, "deflection"),
    ("tracking_error", 0.49, 0.51, "tracking error"),
]


def at(t: float = 0.0) -> Any:
    return stamped(t, *PLACE)


def effort(ros: Ros, peer: Peer, **parameters: Any) -> float:
    """Return the first effort of a controller with these parameters."""
    ros.controller(**parameters)
    peer.meet_controller()
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


@pytest.mark.parametrize(("name", "broken", "kept", "kind"), STOPS, ids=[stop[0] for stop in STOPS])
def test_a_violated_limit_of_the_state_stops(ros: Ros, name: str, broken: float, kept: float, kind: str) -> None:
    manager = Manager(ros)
    ros.controller(on_stop="gravity_hold")
    manager.meet_controller()
    assert manager.set(**{f"limits__{name}": [kept]}) == (True, "")
    law = float(manager.ask(at()).effort[0])
    assert abs(law) > 5.0
    assert manager.set(**{f"limits__{name}": [broken]}) == (True, "")
    held = ROBOT.grad_P_l([0.5])[0] - 0.3 * -0.2
    assert float(manager.ask(at(0.001)).effort[0]) == pytest.approx(held)
    ros.until(lambda: any(event.name == "stops" and kind in event.message for event in manager.events), "the event")
    assert manager.set(**{f"limits__{name}": [kept], "on_stop": "zero"})[0]
    assert float(manager.ask(at(0.002)).effort[0]) == 0.0, "a stop must be latched"
    assert manager.trigger("resume")[0]
    assert float(manager.ask(at(0.003)).effort[0]) == 0.0, "the first effort must be the last one sent"
    assert float(manager.ask(at(0.05)).effort[0]) != 0.0


def test_the_effort_saturates_at_its_limit(ros: Ros, peer: Peer) -> None:
    assert effort(ros, peer, limits__effort=[1.5]) == pytest.approx(-1.5)


def test_the_effort_changes_no_faster_than_its_rate(ros: Ros, peer: Peer) -> None:
    assert effort(ros, peer, limits__effort_rate=[100.0]) == 0.0
    efforts = [float(peer.ask(at(0.001 * k)).effort[0]) for k in range(1, 4)]
    np.testing.assert_allclose(efforts, [-0.1, -0.2, -0.3])
    ros.until(lambda: peer.count("efforts rate limited", "fjr_controller"), "the counter")
    (status,) = [each for each in peer.diagnostics[-1].status if each.name == "fjr_controller"]
    assert status.level == DiagnosticStatus.OK, "a limited rate is what its setting asks for"


def test_a_start_too_far_away_is_refused(ros: Ros, peer: Peer) -> None:
    assert effort(ros, peer, limits__start_error=[0.4]) == 0.0


def test_limits_from_a_robot_without_limits_are_refused(ros: Ros) -> None:
    with pytest.raises(fjr.ParameterError, match="from_robot' is true; expected false for a robot without limits"):
        ros.controller(limits__from_robot=True)


def test_the_effort_is_ramped_from_the_stop_effort(ros: Ros, peer: Peer) -> None:
    assert effort(ros, peer, start__ramp_time=0.1) == 0.0
    assert float(peer.ask(at(0.05)).effort[0]) != 0.0


def test_a_start_begins_with_a_transition_from_the_measured_state(ros: Ros, peer: Peer) -> None:
    effort(ros, peer, start__join_time=0.5, limits__acceleration=[50.0])
    first, wanted = peer.references[-1], fjr.Sine(1.0, 1.0)
    assert (first.position[0], first.velocity[0]) == pytest.approx((0.5, 0.3), abs=1e-12)
    peer.ask(at(0.49))
    assert peer.references[-1].position[0] != wanted.jets(0.49)[0, 0]
    peer.ask(at(0.5))
    assert peer.references[-1].position[0] == pytest.approx(wanted.jets(0.5)[0, 0])


@pytest.mark.parametrize("join_time", [0.0, 1.0])
def test_a_recovery_reaches_the_reference_within_its_time(ros: Ros, peer: Peer, join_time: float) -> None:
    effort(
        ros, peer, recovery__join_time=join_time, state_timeout=0.2, use_sim_time=True
    )  # a jump is confirmed at once
    peer.answer(at(1.0))
    wanted = fjr.Sine(1.0, 1.0).jets(1.0)[0, 0]
    assert peer.references[-1].position[0] == pytest.approx(0.5 if join_time else wanted)
    peer.answer(at(1.1))
    assert peer.count("forward jumps", "fjr_controller") <= 1


@pytest.mark.parametrize(("deceleration", "seconds"), [(2.0, 0.5), (0.5, 2.0)])
def test_a_hold_brakes_with_the_deceleration_of_the_parameter(ros: Ros, deceleration: float, seconds: float) -> None:
    manager = Manager(ros)
    ros.controller(hold__deceleration=deceleration)
    manager.meet_controller()
    manager.ask(at())
    assert manager.trigger("hold")[0]
    for t in (0.0, 0.9 * seconds, seconds, 3.0):
        manager.ask(at(t))
    velocities = [message.velocity[0] for message in manager.references[-3:]]
    assert velocities[0] > 1e-6
    assert velocities[1:] == pytest.approx([0.0, 0.0], abs=1e-12)


def test_positions_alone_suffice_with_an_observer(ros: Ros, peer: Peer) -> None:
    ros.controller(measurement__velocity="observer")
    peer.meet_controller()
    bare = at()
    bare.velocity = []
    check_observed(peer, bare)


def test_motor_turns_are_divided_by_the_gear_ratio(ros: Ros, peer: Peer) -> None:
    plain = effort(ros, peer, measurement__gear_ratio=[50.0])
    law = fjr.TrackingLaw(ROBOT, fjr.PAPER_GAINS)
    x = ROBOT.state(0.5, 0.52 / 50, 0.3, -0.2 / 50)
    assert plain == pytest.approx(float(law.command(x, fjr.Sine(1.0, 1.0).jets(0.0))[0]))


def test_a_torque_sensor_replaces_the_motor_encoder(ros: Ros, peer: Peer) -> None:
    ros.controller(measurement__motor="torque", measurement__velocity="observer")
    peer.meet_controller()
    state = stamped(0.0, 0.5, names=["joint1"])
    state.velocity, state.effort = [], [31.0 * 0.02]
    check_observed(peer, state)


def test_the_bandwidth_of_the_observer_is_the_parameter(ros: Ros) -> None:
    seen = []
    for bandwidth in (50.0, 300.0):
        peer = Peer(ros)
        node = ros.controller(measurement__velocity="observer", measurement__observer_bandwidth=bandwidth)
        peer.meet_controller()
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
