# SPDX-License-Identifier: Apache-2.0
"""`fjr contraction`: along simulated and recorded runs."""

from __future__ import annotations

import json
from pathlib import Path

import matplotlib.image
import pytest

from system.executables import fjr_here
from system.shared_runs import shared_run

pytestmark = pytest.mark.system


def figures(folder: Path, name: str) -> dict[str, float]:
    return json.loads((folder / "contraction" / f"{name}.json").read_text())


@pytest.mark.parametrize("name", ["paper_k31", "two_link"])
def test_distances_of_a_scenario_stay_below_the_bound(tmp_path: Path, name: str) -> None:
    said = fjr_here("contraction", name, "--duration", "0.5", "--output", str(tmp_path))
    found = figures(tmp_path, name)
    assert "stay below exp(-beta t)" in said
    assert found["beta_is_proven"]
    assert found["largest_ratio_to_bound"] <= 1 + 1e-9
    assert found["least_rate_of_contraction_per_s"] >= found["beta_per_s"] * (1 - 1e-9)
    assert found["largest_distance_at_end"] < 0.05 * found["largest_distance_at_start"]
    picture = matplotlib.image.imread(tmp_path / "contraction" / f"{name}.png")
    assert picture.shape[0] > 800
    assert picture[..., :3].std() > 0.05


def test_recorded_run_gives_the_results_of_its_simulation(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """In lock-step the bag contains exactly the numbers of the simulation."""
    arguments = ("contraction", "paper_k31", "--duration", "0.25", "--starts", "3", "--output")
    fjr_here(*arguments, str(tmp_path / "simulated"))
    fjr_here(*arguments, str(tmp_path / "recorded"), "--run", str(shared_run(tmp_path_factory, "paper_k31")))
    recorded, simulated = (figures(tmp_path / how, "paper_k31") for how in ("recorded", "simulated"))
    for key in ("largest_distance_at_start", "largest_distance_at_end", "distance_to_measured_at_end"):
        assert recorded[key] == pytest.approx(simulated[key], rel=0.02)
    assert recorded["largest_ratio_to_bound"] <= 1 + 1e-6


@pytest.mark.parametrize(
    ("arguments", "words", "code"),
    [
        (["paper_k99"], "unknown scenario", 2),
        (["paper_k31", "--starts", "1"], "expected 2 to 64", 2),
        (["paper_k31", "--spread", "-1"], "more than 0", 2),
        (["paper_k31", "--run", "nowhere"], "does not exist; expected the folder of a bag", 2),
    ],
)
def test_invalid_arguments_are_refused_in_one_sentence(
    tmp_path: Path, arguments: list[str], words: str, code: int
) -> None:
    assert words in fjr_here("contraction", *arguments, "--output", str(tmp_path), code=code)
