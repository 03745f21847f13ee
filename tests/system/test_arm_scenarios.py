# SPDX-License-Identifier: Apache-2.0
"""Arms of two and seven joints over ROS 2: two processes in lock-step, evaluated from the bag."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fjr_core.config.controller import safety
from fjr_core.config.scenario import load_scenario
from fjr_core.runtime.events import State
from system import shared_runs
from system.executables import scenario
from system.recorded import Recorded, record, recorded_run
from system.shared_runs import shared_run
from tracking.tracked import Loop

pytestmark = pytest.mark.system

ARMS = ("two_link", "arm7")
DURATION = 3.2  # s


@pytest.fixture(scope="module", params=ARMS)
def recorded(request, tmp_path_factory) -> Recorded:
    assert shared_runs.DURATION[request.param] == DURATION
    folder = shared_run(tmp_path_factory, request.param)
    return recorded_run(folder, (folder.parent / "said").read_text())


def test_all_links_reach_the_reference_within_3_s(recorded: Recorded) -> None:
    assert recorded.error[0] >= 0.05 - 1e-9
    assert np.max(recorded.error[recorded.t >= 3.0]) < 1e-4


@pytest.mark.parametrize("name", ARMS)
def test_nodes_agree_with_fjr_core(name: str, tmp_path: Path) -> None:
    """Lock-step over ROS equals the sampled loop of fjr_core to rounding if no ramp or rate limit acts."""
    loaded = load_scenario(scenario(name))
    n = loaded.robot.n
    recorded = record(name, 1.0, tmp_path, "start.ramp_time:=0.0", f"limits.effort_rate:=[{', '.join(['.inf'] * n)}]")
    run = loaded.simulate(1.0)
    k = len(run.t)
    assert np.max(np.abs(recorded.q_l[:k] - run.x[:, :n])) <= 1e-9
    assert np.max(np.abs(recorded.u[:k] - run.u)) <= 1e-8 * np.max(np.abs(run.u))


@pytest.mark.parametrize(("at", "lost"), [(3.451, 0.263), (3.62, 0.24), (3.663, 0.208), (3.835, 0.233), (3.926, 0.263)])
def test_a_fall_within_the_limits_does_not_end_in_a_stop(at: float, lost: float) -> None:
    """Up to 0.99 of a velocity limit, towards a position limit that no transition of join_time or longer respects."""
    made = load_scenario(scenario("arm7"))
    loop = Loop(made.law, made.reference, safety(made.controller_values, made.robot), made.x0)
    loop.run(at)
    largest = np.abs(loop.efforts[2000:]).max()
    loop.run(0.1, answered=False)
    loop.u = np.zeros(made.robot.n)  # the plant's command_timeout
    loop.run(lost - 0.1, answered=False)
    before = len(loop.efforts)
    loop.step()
    loop.run_through_transition(0.1)
    assert loop.tracker.state is State.TRACKING, loop.tracker.reason
    assert np.abs(loop.efforts[before:]).max() < 1.5 * largest


def test_report_contains_peak_effort_and_limit_of_each_joint(recorded: Recorded) -> None:
    tracking = json.loads((recorded.folder / "report.json").read_text())["tracking"]
    made = load_scenario(recorded.folder / "scenario.yaml")
    inside = recorded.t < DURATION - 1e-9
    peaks = dict(zip(made.joints, np.abs(recorded.u[inside]).max(axis=0), strict=True))
    assert tracking["peak_effort_by_joint_nm"] == pytest.approx(peaks)
    assert tracking["peak_effort_nm"] == pytest.approx(max(peaks.values()))
    limits = [None] * made.robot.n if made.robot.limits is None else made.robot.limits.effort.tolist()
    assert list(tracking["effort_limit_by_joint_nm"].values()) == limits
    share = tracking["largest_share_of_effort_limit"]
    assert share is None if made.robot.limits is None else 0.0 < share < 1.0


def test_rate_of_a_run_is_proven_for_the_positions_that_it_visits(recorded: Recorded) -> None:
    storage = json.loads((recorded.folder / "report.json").read_text())["storage"]
    assert storage["guarantee_is_proven"] is True
    assert "(proven:" in recorded.said
    sampled = load_scenario(recorded.folder / "scenario.yaml").law.rate(recorded.q_l[::10])
    assert 0.5 * sampled.beta < storage["guaranteed_decay_rate_per_s"] / 2 <= sampled.beta


def test_saved_scenario_is_self_contained(recorded: Recorded, monkeypatch: pytest.MonkeyPatch) -> None:
    original = load_scenario(scenario(recorded.folder.name))
    monkeypatch.delenv("AMENT_PREFIX_PATH")
    kept = load_scenario(recorded.folder / "scenario.yaml")
    assert "package://" not in (recorded.folder / "scenario.yaml").read_text()
    assert kept.plant_values["lockstep"] is True
    q_l = np.linspace(0.2, -0.9, kept.robot.n)
    np.testing.assert_array_equal(kept.robot.M_l(q_l), original.robot.M_l(q_l))
    np.testing.assert_array_equal(kept.robot.K, original.robot.K)
    np.testing.assert_array_equal(kept.x0, original.x0)
