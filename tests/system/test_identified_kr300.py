# SPDX-License-Identifier: Apache-2.0
"""The loop of the README of examples/kr300, in lock-step with a plant drawn from the posterior of the real record."""

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


@pytest.mark.full  # 40 s
def test_a_real_record_becomes_a_loop_that_tracks_on_a_plant_of_its_posterior(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    record, mapping, robot = (str(EXAMPLE / name) for name in ("record_a.csv.gz", "record.yaml", "kr300.yaml"))
    fjr_here("identify", record, "--map", mapping, "--robot", robot, "--position-torque", "a2", "--output", ".")
    file = tmp_path / "robot.yaml"
    file.write_text(file.read_text() + ROBUST)  # fjr_controller is its last section
    shown = fjr_here("gains", str(file), "--beta", "2.5", "--from", "identification.json", "--write")
    assert "0 of 4,603 robots drawn afresh from the identification are unstable" in shown
    assert "at most 0.1 % with 99 %" in shown
    assert "as sampled          stable" in fjr_here("check", str(file))
    found = Identification.from_dict(json.loads(Path("identification.json").read_text()))
    row, rate = found.draws(1, seed=3), "    publish_rate: 1000.0"  # of the plant alone
    assert file.read_text().count(rate) == 1
    drawn = {name: [float(v[0]) for v in found.drawn_values(row, name).values()] for name in (*ARM, *FRICTION)}
    plant = [f"    robot: {json.dumps({name: drawn[name] for name in ARM})}"]
    plant += [f"    imperfections: {json.dumps({name: drawn[name] for name in FRICTION})}"]
    Path("drawn.yaml").write_text(file.read_text().replace(rate, "\n".join([*plant, rate])))
    scenario = load_scenario(tmp_path / "drawn.yaml")
    assert not np.allclose(scenario.plant_values["robot.joint_stiffness"], np.diag(scenario.robot.K), rtol=1e-3)
    fjr_here("run", "drawn.yaml", "--lockstep", "--duration", "2.2", "--no-report")
    report = json.loads((tmp_path / "runs/drawn/report.json").read_text())
    assert report["diagnostics"]["fjr_controller"]["state"] == "tracking"  # at the last second
    assert report["tracking"]["max_error_after_2s_rad"] < 0.2 * 0.4  # rad; the reference moves by 0.4 rad
