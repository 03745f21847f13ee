# SPDX-License-Identifier: Apache-2.0
"""The controller node with each law sends the effort of that law; features specific to v-dPBC are off."""

from __future__ import annotations

import numpy as np
import pytest
from rclpy.parameter import Parameter
from std_msgs.msg import Float64MultiArray

import fjr_core as fjr
from fjr_core.config.law import control_law
from fjr_core.extensions.law_registry import LAWS
from fjr_msgs_py import names as ros_names
from nodes.harness import Listener, Peer, Ros, stamped

OTHERS = tuple(name for name in LAWS if name != "v_dpbc")
every_law = pytest.mark.parametrize("name", OTHERS)


@every_law
def test_publishes_the_effort_of_the_selected_law(ros: Ros, peer: Peer, name: str) -> None:
    node = ros.controller(law__type=name, law__start_error=[0.5])
    law = control_law(node.values, fjr.single_link())
    peer.meet_controller()
    for k in range(5):
        t, position, velocity = 0.001 * k, [0.5 - 0.01 * k, 0.5 + 0.02 * k], [0.1 * k, -0.1 * k]
        command = peer.ask(stamped(t, position, velocity))
        expected, _ = law.measured_command(position, velocity, fjr.Sine(1.0, 1.0).jets(t))
        np.testing.assert_allclose(command.effort, expected, rtol=1e-9)


@every_law
def test_tracks_on_two_nodes_in_lock_step(ros: Ros, name: str) -> None:
    """Run 700 samples: efforts are finite, the error decreases, no certificate is published."""
    heard: list[Float64MultiArray] = []
    listener = Listener(ros)
    listener.create_subscription(
        Float64MultiArray, f"fjr_controller/{ros_names.CERTIFICATE.split('/')[-1]}", heard.append, 10
    )
    ros.controller(law__type=name, law__start_error=[0.5])
    ros.plant(lockstep=True)
    ros.until(lambda: len(listener.errors) >= 700, "700 answers")
    efforts = np.array([command.effort for command in listener.commands])
    assert np.isfinite(efforts).all()
    assert np.abs(efforts).max() < 60.0
    errors = np.array([error.position[0] for error in listener.errors])
    assert np.abs(errors[650:700]).max() < (0.1 if name in ("pd_gravity", "torque_feedback") else 0.02)
    assert not heard


def test_a_state_without_a_finite_effort_gets_the_stop_effort(ros: Ros, peer: Peer) -> None:
    """A non-finite effort stops the arm; a law without a storage (nan) does not."""
    ros.controller(law__type="singular_perturbation")
    peer.meet_controller()
    assert peer.ask(stamped(0.0)).effort[0] != 0.0
    assert peer.ask(stamped(0.001, 1e200)).effort[0] == 0.0
    assert np.isfinite(peer.ask(stamped(0.002)).effort[0])


def test_gains_of_v_dpbc_cannot_change_under_another_law(ros: Ros) -> None:
    node = ros.controller(law__type="lqr")
    (result,) = node.set_parameters([Parameter("gains.K_ld", value=[1.2])])
    assert not result.successful
    assert result.reason == "parameters 'gains.*' are of the law v_dpbc; the law is lqr"
    (result,) = node.set_parameters([Parameter("reference.amplitude", value=[0.5])])
    assert result.successful


def test_the_law_cannot_change_while_the_node_runs(ros: Ros) -> None:
    node = ros.controller(law__type="lqr")
    (result,) = node.set_parameters([Parameter("law.type", value="pd_gravity")])
    assert not result.successful
    assert "'law.type' can be set only while the node is unconfigured" in result.reason


def test_natural_frequency_and_damping_ratio_are_those_of_the_parameters(ros: Ros, peer: Peer) -> None:
    ros.controller(
        law__type="feedback_linearisation", law__tuned=False, law__natural_frequency=30.0, law__damping_ratio=1.0
    )
    peer.meet_controller()
    kind, robot = LAWS["feedback_linearisation"], fjr.single_link()
    law = kind.make(robot, kind.standard(robot, np.zeros(1), 30.0, 1.0))
    expected, _ = law.measured_command([0.5, 0.5], [0.0, 0.0], fjr.Sine(1.0, 1.0).jets(0.0))
    np.testing.assert_allclose(peer.ask(stamped(0.0)).effort, expected, rtol=1e-9)


def test_gravity_hold_uses_the_motor_damping_of_the_law(ros: Ros, peer: Peer) -> None:
    node = ros.controller(
        law__type="pd_gravity", on_stop="gravity_hold", limits__tracking_error=[0.1], recovery__join_time=0.0
    )
    law = control_law(node.values, fjr.single_link())
    peer.meet_controller()
    command = peer.ask(stamped(0.0, 0.5, [0.0, 0.3]))
    wanted = 0.8 * np.sin(0.5) - law.hold_damping[0, 0] * 0.3
    assert command.effort[0] == pytest.approx(wanted)


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"law__type": "pid"}, "law.type"),
        ({"law__type": "lqr", "law__start_error": [0.1, 0.2]}, "law.start_error"),
        ({"law__type": "pd_gravity", "law__tuned": False, "law__natural_frequency": 0.1}, "law.type"),
    ],
)
def test_an_invalid_law_is_refused_by_the_constructor(ros: Ros, parameters: dict, words: str) -> None:
    with pytest.raises(fjr.ParameterError, match=words):
        ros.controller(**parameters)
