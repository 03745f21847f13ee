# SPDX-License-Identifier: Apache-2.0
"""A real record, `fjr identify`, `fjr check`, and the loop in lock-step with a plant drawn from the posterior."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from docs.pages import ROOT
from fjr_core.config.scenario import load_scenario
from fjr_design.uncertainty.posterior import Identification
from system.executables import fjr_here

pytestmark = pytest.mark.system
EXAMPLE = ROOT / "examples/kr300"
ARM = ("joint_stiffness", "motor_inertia", "link_damping", "motor_damping")
FRICTION = ("link_coulomb_friction", "motor_coulomb_friction")
ROBUST = "    robust: {motor_residual_gain: [10.0, 10.0, 10.0, 10.0, 10.0, 10.0]}\n"


def with_drawn_plant(folder: Path) -> Path:
    """Write robot.yaml with a plant from the posterior, whose controller keeps the identified model; return it."""
    found = Identification.from_dict(json.loads((folder / "identification.json").read_text()))
    row = found.draws(1, seed=3)
    arm, friction = (
        {name: [float(each[0]) for each in found.drawn_values(row, name).values()] for name in names}
        for names in (ARM, FRICTION)
    )
    text = (folder / "robot.yaml").read_text()
    section = "    publish_rate: 1000.0"
    assert text.count(section) == 1
    plant = f"    robot: {json.dumps(arm)}\n    imperfections: {json.dumps(friction)}\n{section}"
    (folder / "drawn.yaml").write_text(text.replace(section, plant))
    return folder / "drawn.yaml"


@pytest.mark.full  # 40 s
def test_a_real_record_becomes_a_loop_that_tracks_on_a_plant_of_its_posterior(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    robot = identified(tmp_path / "out")
    posterior = str(robot.parent / "identification.json")
    shown = fjr_here("gains", str(robot), "--beta", "2.5", "--from", posterior, "--write")
    assert "0 of 4,603 robots drawn afresh from the identification are unstable" in shown
    assert "at most 0.1 % with 99 %" in shown
    assert "as sampled          stable" in fjr_here("check", str(robot))
    drawn = with_drawn_plant(robot.parent)
    scenario = load_scenario(drawn)
    assert not np.allclose(scenario.plant_values["robot.joint_stiffness"], np.diag(scenario.robot.K), rtol=1e-3)
    fjr_here("run", str(drawn), "--lockstep", "--duration", "2.2", "--no-report")
    report = json.loads((tmp_path / "runs/drawn/report.json").read_text())
    assert report["diagnostics"]["fjr_controller"]["state"] == "tracking"  # at the last second
    assert report["tracking"]["max_error_after_2s_rad"] < 0.2 * 0.4  # rad; the reference moves by 0.4 rad


def identified(folder: Path) -> Path:
    """Identify the robot from record A; return its robot.yaml, with a disturbance observer on the motors."""
    record, mapping, robot = (str(EXAMPLE / name) for name in ("record_a.csv.gz", "record.yaml", "kr300.yaml"))
    arguments = ("--map", mapping, "--robot", robot, "--position-torque", "a2", "--output", str(folder))
    assert "weakly" in fjr_here("identify", record, *arguments)
    file = folder / "robot.yaml"
    file.write_text(file.read_text() + ROBUST)  # fjr_controller is its last section
    return file
