# SPDX-License-Identifier: Apache-2.0
"""The paper's scenarios over ROS 2: two processes in lock-step, evaluated from the bag by an independent reader."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fjr_core.config.scenario import load_scenario
from system import shared_runs
from system.executables import fjr_here, scenario
from system.recorded import Recorded, reader, recorded_run
from system.shared_runs import shared_run

pytestmark = pytest.mark.system

PEAK = {"paper_k31": 26.203, "paper_k3p1": 255.762}  # N m, by an independent integration
DURATION = 2.5  # s


@pytest.fixture(scope="module", params=PEAK)
def recorded(request, tmp_path_factory) -> Recorded:
    assert shared_runs.DURATION[request.param] == DURATION
    folder = shared_run(tmp_path_factory, request.param)
    return recorded_run(folder, (folder.parent / "said").read_text())


def test_bag_contains_every_sample_of_the_run(recorded: Recorded) -> None:
    assert recorded.t[-1] >= DURATION
    np.testing.assert_array_equal(np.round(np.diff(recorded.t) * 1e9), 1_000_000)


def test_link_reaches_the_reference_within_2_s(recorded: Recorded) -> None:
    assert np.max(recorded.error[recorded.t > 2.0]) <= 3e-5


def test_peak_effort_is_that_of_the_paper(recorded: Recorded) -> None:
    assert np.max(np.abs(recorded.u)) == pytest.approx(PEAK[recorded.folder.name], rel=0.01)


def test_nodes_agree_with_fjr_core(recorded: Recorded) -> None:
    """Lock-step over ROS equals the sampled loop of fjr_core to rounding."""
    run = load_scenario(scenario(recorded.folder.name)).simulate(DURATION)
    k = len(run.t)
    assert np.max(np.abs(recorded.q_l[:k] - run.x[:, :1])) <= 1e-9
    assert np.max(np.abs(recorded.u[:k] - run.u)) <= 1e-9 * np.max(np.abs(run.u))


def test_run_writes_report_page_and_figure_from_the_bag(recorded: Recorded) -> None:
    report = json.loads((recorded.folder / "report.json").read_text())
    assert report["tracking"]["peak_effort_nm"] == pytest.approx(np.max(np.abs(recorded.u)))
    inside = (recorded.t >= 2.0) & (recorded.t < DURATION - 1e-9)
    error = np.max(recorded.error[inside])
    assert report["tracking"]["max_error_after_2s_rad"] == pytest.approx(error, rel=1e-6)
    counts = report["counts"]
    assert counts["nominal"] == counts["published"] == counts["answered"] == 2500
    assert counts["missing"] == counts["gaps"] == counts["unanswered"] == 0
    picture = recorded.folder / "overview.png"
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert picture.stat().st_size > 10_000
    assert (recorded.folder / "report.html").read_text().startswith("<!doctype html>")
    assert "peak effort" in recorded.said
    assert "report.json" in recorded.said


def test_the_last_effort_in_the_bag_is_zero(recorded: Recorded) -> None:
    with reader(recorded.folder) as bag:
        topic = "/effort_controller/commands"
        connections = [connection for connection in bag.connections if connection.topic == topic]
        efforts = [bag.deserialize(raw, c.msgtype).data[0] for c, _, raw in bag.messages(connections)]
    assert efforts[-1] == 0.0


def test_an_override_changes_the_run(tmp_path: Path) -> None:
    """Doubling the stiffness of the soft joint changes plant, law and metrics."""
    arguments = ("--lockstep", "--duration", "0.5", "--output", str(tmp_path), "--set", "robot.joint_stiffness:=[6.2]")
    fjr_here("run", "paper_k3p1", "--no-report", *arguments)
    report = json.loads((tmp_path / "paper_k3p1" / "report.json").read_text())
    kept = load_scenario(tmp_path / "paper_k3p1" / "scenario.yaml")
    assert kept.robot.K.tolist() == kept.plant.robot.K.tolist() == [[6.2]]
    assert report["tracking"]["peak_effort_nm"] == pytest.approx(np.max(np.abs(kept.simulate(0.5).u)), rel=1e-6)
