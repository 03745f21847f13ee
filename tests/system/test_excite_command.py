# SPDX-License-Identifier: Apache-2.0
"""`fjr excite` writes a scenario whose motion the controller can follow within its limits."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fjr_core.config.scenario import load_scenario
from fjr_identification import excitation
from system.executables import fjr_here, scenario

pytestmark = pytest.mark.system
DURATION = 3.0


@pytest.fixture(autouse=True)
def short_search(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(excitation, "STARTS", 1)
    monkeypatch.setattr(excitation, "STEPS", 25)


def test_the_written_scenario_follows_its_motion_from_rest(tmp_path: Path) -> None:
    target = tmp_path / "moves.yaml"
    shown = fjr_here("excite", "two_link", "--duration", f"{DURATION}", "--output", f"{target}", "--json")
    values, _ = json.JSONDecoder().raw_decode(shown)
    assert values["scenario_file"] == str(target)
    narrower = np.divide(*(values[f"relative_half_width{end}"]["joint_stiffness"] for end in ("_before", "")))
    assert np.all(narrower > 1)
    loop = load_scenario(target)
    run = loop.simulate(DURATION)
    n = loop.robot.n
    assert np.abs(run.x[:, :n] - run.jets[:, 0]).max() < 2e-3
    assert np.abs(run.jets[0, 1:]).max() < 1e-6
    assert np.abs(run.jets[:, 0] - run.jets[0, 0]).max() > 0.1


def test_a_robot_file_gets_gains(tmp_path: Path) -> None:
    robot, target = Path(scenario("two_link")).parents[1] / "robots" / "paper_joint.yaml", tmp_path / "moves.yaml"
    fjr_here("excite", f"{robot}", "--duration", f"{DURATION}", "--output", f"{target}")
    assert "stable" in fjr_here("check", f"{target}")


TABLE = ("torsion_deflection:=[0.05, 0.05, 0.1, 0.1]", "torsion_torque:=[2.5, 2.0, 8.0, 6.0]")


@pytest.mark.parametrize("curve", [("cubic_stiffness:=[4.0e3, 2.5e3]",), TABLE], ids=["cubic", "table"])
def test_the_motion_of_springs_with_a_curve_keeps_their_limits(tmp_path: Path, curve: tuple[str, ...]) -> None:
    target = tmp_path / "moves.yaml"
    given = *(f"robot.{each}" for each in curve), "limits.deflection:=[0.1, 0.06]"
    sets = [part for each in given for part in ("--set", each)]
    fjr_here("excite", "two_link", "--duration", f"{DURATION}", "--output", f"{target}", *sets)
    loop = load_scenario(target)
    assert loop.robot.curve
    run = loop.simulate(DURATION)
    zeta = np.abs(run.x[:, 2:4] - run.x[:, :2]).max(axis=0)
    assert np.all(zeta <= [0.1, 0.06])
    assert np.abs(run.x[:, :2] - run.jets[:, 0]).max() < 2e-3
