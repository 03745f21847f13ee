# SPDX-License-Identifier: Apache-2.0
"""A real record, `fjr identify`, `fjr check`, and the loop in lock-step with a plant drawn from the posterior."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from docs.pages import ROOT
from fjr_bringup.cli.exit_codes import Exit
from fjr_core.config.scenario import load_scenario
from fjr_core.identification.drawn_plants import drawn_plants
from fjr_core.identification.result import Identification
from system.executables import fjr_here

pytestmark = pytest.mark.system
EXAMPLE = ROOT / "examples/kr300"
FIELDS = ("joint_stiffness", "motor_inertia", "link_damping", "motor_damping")


def with_drawn_plant(folder: Path) -> Path:
    """Write robot.yaml with a plant from the posterior, whose controller keeps the identified model; return it."""
    found = Identification.from_dict(json.loads((folder / "identification.json").read_text()))
    plant = drawn_plants(found, load_scenario(folder / "robot.yaml").robot, 1, seed=3)
    values = (plant.stiffness, plant.motor_inertia, plant.link_damping, plant.motor_damping)
    drawn = dict(zip(FIELDS, (each[0].tolist() for each in values), strict=True))
    text = (folder / "robot.yaml").read_text()
    section = "    publish_rate: 1000.0"
    assert text.count(section) == 1
    (folder / "drawn.yaml").write_text(text.replace(section, f"    robot: {json.dumps(drawn)}\n{section}"))
    return folder / "drawn.yaml"


@pytest.mark.full  # 25 s
def test_a_real_record_becomes_a_loop_that_tracks_on_a_plant_of_its_posterior(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    record, mapping, robot = (str(EXAMPLE / name) for name in ("record_a.csv.gz", "record.yaml", "kr300.yaml"))
    arguments = ("--map", mapping, "--robot", robot, "--output", str(tmp_path / "out"))
    assert "weakly" in fjr_here("identify", record, *arguments)
    assert "as sampled          stable" in fjr_here("check", str(tmp_path / "out/robot.yaml"))
    drawn = with_drawn_plant(tmp_path / "out")
    scenario = load_scenario(drawn)
    assert not np.allclose(scenario.plant_values["robot.joint_stiffness"], np.diag(scenario.robot.K), rtol=1e-3)
    run = ("run", str(drawn), "--lockstep", "--duration", "0.5", "--no-report")
    fjr_here(*run, codes=(Exit.DONE, Exit.VIOLATED))  # the certificate is that of the identified model
    report = json.loads((tmp_path / "runs/drawn/report.json").read_text())
    assert report["diagnostics"]["fjr_controller"]["state"] in ("joining", "tracking")  # at the last second
    assert report["verdict"]["figures"]["last V"] < 0.2 * report["storage"]["initial"]
    assert max(report["verdict"]["errors"]["model mismatch"]) < 0.1  # rad; the reference moves by 0.4 rad
