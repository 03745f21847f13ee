# SPDX-License-Identifier: Apache-2.0
"""The nodes run a law and a plant of the user by their name module:Class, and a motion from a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rclpy.parameter import Parameter

import fjr_core as fjr
import own_code
from fjr_controller.controller_node import SUCCESS
from nodes.harness import Listener, Peer, Ros, seconds, stamped


def test_publishes_the_effort_of_the_law_with_its_options(ros: Ros, peer: Peer) -> None:
    node = ros.controller(law__type="own_code:Pd", law__options__K_p=30.0, law__options__weights=[2.0])
    law = own_code.Pd(fjr.single_link(), K_p=30.0, weights=(2.0,))
    assert node.get_parameter("law.options.K_d").value == 2.0
    assert "or module:Class of your own" in node.describe_parameter("law.type").additional_constraints
    peer.meet_controller()
    for k in range(3):
        t, position, velocity = 0.001 * k, [0.5, 0.5 + 0.02 * k], [0.1 * k, -0.1 * k]
        command = peer.ask(stamped(t, position, velocity))
        expected = law.effort(np.array(position), np.array(velocity), fjr.Sine(1.0, 1.0).jets(t))
        np.testing.assert_allclose(command.effort, expected, rtol=1e-9)


def test_an_exception_in_the_law_stops_the_arm_and_the_node_continues(ros: Ros, peer: Peer) -> None:
    peer.controller(law__type="own_code:FailsAtSpeed")
    assert peer.ask(stamped(0.0, 0.2)).effort[0] != 0.0
    for k in range(1, 4):
        assert peer.ask(stamped(0.001 * k, 0.2, [0.0, -0.1])).effort[0] == 0.0
    ros.until(lambda: peer.count("stops: law", "fjr_controller"), "the counter")


def test_own_law_and_own_plant_track_in_lock_step(ros: Ros) -> None:
    listener = Listener(ros, only=["fjr_controller/tracking_error", "joint_commands"])
    ros.controller(law__type="own_code:Wrapped", start__join_time=0.2)
    ros.plant(lockstep=True, plant__type="own_code:Ideal", plant__options__damping=0.01)
    ros.until(lambda: len(listener.errors) >= 600, "600 answers")
    assert np.isfinite([command.effort for command in listener.commands]).all()
    assert max(abs(error.position[0]) for error in listener.errors[550:600]) < 0.02


def test_options_are_ignored_by_the_other_node_and_fixed_while_the_node_is_active(ros: Ros) -> None:
    ros.plant(law__type="own_code:Pd", law__options__K_p=30.0)
    node = ros.controller(law__type="own_code:Pd", law__options__K_p=30.0, plant__options__damping=1.0)
    (result,) = node.set_parameters([Parameter("law.options.K_p", value=40.0)])
    assert not result.successful
    assert "'law.options.K_p' can be set only while the node is unconfigured" in result.reason


def test_law_and_options_change_while_the_node_is_unconfigured(ros: Ros) -> None:
    node = ros.controller(autostart=False)
    for name, value in {"law.type": "own_code:Pd", "law.options.K_p": 30.0}.items():
        (result,) = node.set_parameters([Parameter(name, value=value)])
        assert result.successful, result.reason
    (result,) = node.set_parameters([Parameter("law.option.K_p", value=30.0)])
    assert "unknown parameter 'law.option.K_p'" in result.reason
    assert node.trigger_configure() == SUCCESS
    assert (node.values["law.options.K_p"], node.values["law.options.K_d"]) == (30.0, 2.0)


# A motion from a file, which the controller reads when it is configured.


T = np.arange(1501) / 1000  # s


def motion_file(folder: Path, q: np.ndarray) -> str:
    file = folder / "motion.csv"
    np.savetxt(file, np.stack([T, q], axis=1), "%.6f", ",", header="time,joint1", comments="")
    return str(file)


def test_tracks_the_file_on_two_nodes_in_lock_step(ros: Ros, tmp_path: Path) -> None:
    path = motion_file(tmp_path, 0.5 * (1 - np.cos(3 * T)))
    listener = Listener(ros)
    ros.controller(reference__type="file", reference__file__path=path)
    ros.plant(lockstep=True, initial_link_position=[0.0], initial_motor_position=[0.0])
    ros.until(lambda: len(listener.errors) >= 1200, "1200 answers")
    zero = seconds(listener.references[0])
    for message in listener.references[:1200]:
        t = seconds(message) - zero
        assert message.position[0] == pytest.approx(0.5 * (1 - np.cos(3 * t)), abs=1e-6)
        assert message.velocity[0] == pytest.approx(1.5 * np.sin(3 * t), abs=1e-4)
    errors = np.array([error.position[0] for error in listener.errors[:1200]])
    assert np.abs(errors).max() < 0.05
    assert np.abs(errors[1000:]).max() < 0.01


def test_a_running_node_changes_to_the_file_that_it_read_when_it_was_configured(ros: Ros, tmp_path: Path) -> None:
    path = motion_file(tmp_path, np.sin(T))
    node = ros.controller(reference__file__path=path)
    Path(path).unlink()
    (result,) = node.set_parameters([Parameter("reference.type", value="file")])
    assert result.successful, result.reason
    (result,) = node.set_parameters([Parameter("reference.file.path", value="other.csv")])
    assert not result.successful
    assert "can be set only while the node is unconfigured" in result.reason
