# SPDX-License-Identifier: Apache-2.0
"""The controller node with reference.type `file` tracks the motion of a file that it reads when it is configured."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow
import pytest
from pyarrow import parquet
from rclpy.parameter import Parameter

import fjr_core as fjr
from fjr_core.config.reference import reference
from nodes.harness import Listener, Ros, seconds

T = np.arange(1501) / 1000  # s


def motion_file(folder: Path, q: np.ndarray) -> str:
    file = folder / "motion.csv"
    np.savetxt(file, np.stack([T, q], axis=1), "%.6f", ",", header="time,joint1", comments="")
    return str(file)


def test_a_parquet_file_is_the_same_reference_as_its_csv_file(ros: Ros, tmp_path: Path) -> None:
    q = 0.5 * (1 - np.cos(3 * T))
    parquet.write_table(pyarrow.table({"time": T, "joint1": np.round(q, 6)}), tmp_path / "motion.parquet")
    node = ros.controller(
        reference__type="file",
        reference__file__path=str(tmp_path / "motion.parquet"),
        reference__file__tolerance=[2e-3],
    )
    found, expected = node.values, {**node.values, "reference.file.path": motion_file(tmp_path, q)}
    jets = [reference(values, 1).jets(T) for values in (found, expected)]
    np.testing.assert_array_equal(jets[0], jets[1])


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


def test_a_node_refuses_a_file_that_is_no_motion(ros: Ros, tmp_path: Path) -> None:
    file = tmp_path / "motion.csv"
    file.write_text("time,joint1\n0,0\n1,x\n")
    with pytest.raises(fjr.ParameterError, match="line 3, column joint1: 'x'; expected a finite number"):
        ros.controller(reference__type="file", reference__file__path=str(file))
