# SPDX-License-Identifier: Apache-2.0
"""The controller runs a law of the user by its name module:Class, and a motion of a file; docs/own_law.md: a plant."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rclpy.parameter import Parameter

import fjr_core as fjr
import own_code
from fjr_controller.controller_node import SUCCESS
from nodes.harness import Peer, Ros, stamped


def test_publishes_the_effort_of_the_law_with_its_options(ros: Ros, peer: Peer) -> None:
    node = ros.controller(law__type="own_code:Pd", law__options__K_p=30.0, law__options__weights=[2.0])
    law = own_code.Pd(fjr.single_link(), K_p=30.0, weights=(2.0,))
    assert node.get_parameter("law.options.K_d").value == 2.0
    assert "or module:Class of your own" in node.describe_parameter("law.type").additional_constraints
    for k in range(3):
        t, position, velocity = 0.001 * k, [0.5, 0.5 + 0.02 * k], [0.1 * k, -0.1 * k]
        command = peer.ask(stamped(t, position, velocity))
        expected = law.effort(np.array(position), np.array(velocity), fjr.Sine(1.0, 1.0).jets(t))
        np.testing.assert_allclose(command.effort, expected, rtol=1e-9)


def test_an_exception_in_the_law_stops_the_arm_and_the_node_continues(ros: Ros, peer: Peer) -> None:
    node = ros.controller(law__type="own_code:FailsAtSpeed")
    assert peer.ask(stamped(0.0, 0.2)).effort[0] != 0.0
    for k in range(1, 4):
        assert peer.ask(stamped(0.001 * k, 0.2, [0.0, -0.1])).effort[0] == 0.0
    peer.reported(node, "stops: law")


def test_law_and_options_change_while_the_node_is_unconfigured(ros: Ros) -> None:
    ros.plant(law__type="own_code:Pd", law__options__K_p=30.0)  # ignores the options of the controller
    node = ros.controller(autostart=False, plant__options__damping=1.0)

    def set_one(name: str, value: object) -> tuple[bool, str]:
        (result,) = node.set_parameters([Parameter(name, value=value)])
        return result.successful, result.reason

    for name, value in {"law.type": "own_code:Pd", "law.options.K_p": 30.0}.items():
        assert set_one(name, value) == (True, "")
    assert "unknown parameter 'law.option.K_p'" in set_one("law.option.K_p", 30.0)[1]
    assert node.trigger_configure() == SUCCESS
    assert (node.values["law.options.K_p"], node.values["law.options.K_d"]) == (30.0, 2.0)
    done, reason = set_one("law.options.K_p", 40.0)
    assert not done
    assert "'law.options.K_p' can be set only while the node is unconfigured" in reason


# A motion from a file, which the controller reads when it is configured.


T = np.arange(1501) / 1000  # s


def test_a_running_node_changes_to_the_file_that_it_read_when_it_was_configured(ros: Ros, tmp_path: Path) -> None:
    file = tmp_path / "motion.csv"
    np.savetxt(file, np.stack([T, np.sin(T)], axis=1), "%.6f", ",", header="time,joint1", comments="")
    node = ros.controller(reference__file__path=str(file))
    file.unlink()
    (result,) = node.set_parameters([Parameter("reference.type", value="file")])
    assert result.successful, result.reason
    (result,) = node.set_parameters([Parameter("reference.file.path", value="other.csv")])
    assert not result.successful
    assert "can be set only while the node is unconfigured" in result.reason
