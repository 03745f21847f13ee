# SPDX-License-Identifier: Apache-2.0
"""`fjr tune`: result, scenario and picture; a search that goes on where it ended; invalid files."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest

from fjr_core.config.scenario import load_scenario
from fjr_design.studies.tune_run import pareto
from fjr_msgs_py.console.ending import Exit
from system.executables import documented_keys, fjr_here

pytestmark = pytest.mark.system
STUDY = """
scenario: paper_k31
duration: 0.6
seed: 4
vary:
  stiffness: {log_uniform: [0.5, 2.0]}
  delay: 0.001
  velocity_noise: 0.1
tune:
  success: 0.9
  delay_margin: 2.0
  limits: {effort_peak: 27.0}
  candidates: 16
  draws: 8
  fresh: 40
success: {rms: 0.05}
settle_after: 0.3
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("tuned")


@pytest.fixture(scope="module")
def study(folder: Path) -> Path:
    path = folder / "joint.yaml"
    path.write_text(STUDY)
    return path


@pytest.fixture(scope="module")
def said(folder: Path, study: Path) -> str:
    return fjr_here("tune", str(study), "--cores", "2", "--output", str(folder), "--json")


def result(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "joint_v_dpbc" / "result.json").read_text())
    return found


def test_tuned_gains_are_better_on_fresh_draws_and_keep_the_constraints(folder: Path, said: str) -> None:
    found, place = result(folder), folder / "joint_v_dpbc"
    assert found["figures"]["rms"]["tuned_50%"] < found["figures"]["rms"]["scenario_50%"]
    assert found["constraints_kept"]
    assert found["success"]["tuned"] >= 0.9
    assert found["figures"]["effort_peak"]["tuned_50%"] <= 27.0
    assert set(json.JSONDecoder().raw_decode(said[said.index("{") :])[0]) == documented_keys()["tune"]
    written = load_scenario(place / "joint_v_dpbc.yaml")
    for name, value in found["parameters"].items():
        assert list(written.controller_values[name]) == pytest.approx(value, rel=1e-12)
    assert set(found["factors"]) == set(found["parameters"])
    assert matplotlib.image.imread(place / "overview.png")[..., :3].std() > 0.05


def test_no_point_beats_one_on_the_front_and_all_others_are_beaten() -> None:
    x, y = np.random.default_rng(1).uniform(size=(2, 60))
    among = x > 0.1
    front = set(pareto(x, y, among).tolist())
    for i in np.flatnonzero(among):
        beaten = any(among[j] and x[j] <= x[i] and y[j] <= y[i] for j in range(60) if j != i)
        assert beaten != (int(i) in front)


def test_a_search_that_was_cut_off_ends_with_the_same_result_on_another_number_of_cores(
    folder: Path, study: Path, said: str
) -> None:
    whole, other = folder / "joint_v_dpbc", folder / "other" / "joint_v_dpbc"
    shutil.copytree(whole, other)
    (other / "table.parquet").unlink()
    parts = sorted((other / "parts").glob("*.parquet"))
    for part in parts[::2]:
        part.unlink()
    parts[1].write_bytes(parts[1].read_bytes()[:-40])  # as after a full disk
    kept = {part: part.stat().st_mtime_ns for part in parts[3::2]}
    shown = fjr_here("tune", str(study), "--cores", "1", "--output", str(folder / "other"))
    start = {"scenario": "the scenario", "rule": "the rule of equal bandwidth"}[result(folder)["start"]]
    assert f"factors on the gains of {start}:" in shown
    assert f"scenario with these gains: {other / 'joint_v_dpbc.yaml'}" in shown
    assert "constraints are violated" not in shown
    assert {part: part.stat().st_mtime_ns for part in kept} == kept
    for name in ("table.parquet", "result.json"):
        assert (other / name).read_bytes() == (whole / name).read_bytes()


def test_a_scenario_is_tuned_for_the_usual_uncertainties_also_with_another_law(folder: Path) -> None:
    size = ["--candidates", "6", "--draws", "4", "--fresh", "8", "--duration", "1.2"]
    fjr_here("tune", "paper_k31", "--law", "backstepping", *size, "--output", str(folder))
    written = load_scenario(folder / "paper_k31_backstepping" / "paper_k31_backstepping.yaml")
    assert written.name == "paper_k31_backstepping"  # a run of it, runs/NAME, is no folder of studies
    assert written.controller_values["law.type"] == "backstepping"
    assert written.controller_values["law.tuned"] is False
    assert len(written.controller_values["law.gain_factors"]) == 2


INVALID = {
    "{draw: 5}": "'tune': has 'draw'; did you mean 'draws'?",
    "{draws: 2.5}": "'tune': has 2.5 as 'draws'; expected a whole number",
    "{draws: 0}": "'tune': has 0 as 'draws'; expected 1 to 1e+07",
    "{minimise: rms}": "'tune': has 'rms' as 'minimise'; expected a mapping",
    "{quantile: high}": "'tune': has 'high' as 'quantile'; expected a number",
    "{law: 3}": "'tune': has 3 as 'law'; expected a text",
    "{law: pid}": "'pid'; expected one of v_dpbc",
    "[draws]": "as 'tune'; expected a mapping",
}


@pytest.mark.parametrize("section", INVALID)
def test_invalid_files_are_refused_in_one_sentence(tmp_path: Path, section: str) -> None:
    path = tmp_path / "joint.yaml"
    path.write_text(STUDY[: STUDY.index("tune:")] + f"tune: {section}\n")
    refused = fjr_here("tune", str(path), "--output", str(tmp_path), code=Exit.NOT_UNDERSTOOD)
    assert INVALID[section] in refused
    assert "Traceback" not in refused
