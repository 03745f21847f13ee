# SPDX-License-Identifier: Apache-2.0
"""The controller node with reference.type `file` tracks the motion of a file that it reads when it is configured."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rclpy.parameter import Parameter

from nodes.harness import Listener, Ros, seconds

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
