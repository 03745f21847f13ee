# SPDX-License-Identifier: Apache-2.0
"""reference.type `file`: built from its parameters, with a warning and numbers where it asks for large efforts."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.config import ros_yaml
from fjr_core.config.scenario import Scenario, load_scenario, parse_scenario, self_contained
from fjr_core.simulation.closed_loop import simulate

T = np.arange(5001) / 1000  # s: 5 s at 1 kHz
Load = Callable[..., Scenario]


@pytest.fixture
def load(tmp_path: Path) -> Load:
    """Return a function that loads a scenario whose reference is the file motion.csv next to it."""

    def loaded(q: np.ndarray, times: np.ndarray = T, velocity: np.ndarray | None = None, **extra: object) -> Scenario:
        columns = [times, q] + ([] if velocity is None else [velocity])
        header = "time,joint1" + ("" if velocity is None else ",joint1_velocity")
        np.savetxt(tmp_path / "motion.csv", np.stack(columns, axis=1), "%.6f", ",", header=header, comments="")
        limits = "".join(f"    {name}: {value}\n" for name, value in extra.items())
        (tmp_path / "own.yaml").write_text(
            "fjr_plant:\n  ros__parameters:\n    initial_link_position: [0.0]\n    initial_motor_position: [0.0]\n"
            "fjr_controller:\n  ros__parameters:\n"
            "    reference.type: file\n    reference.file.path: motion.csv\n" + limits
        )
        return load_scenario(tmp_path / "own.yaml")

    return loaded


def numbers(sentence: str) -> list[float]:
    return [float(text) for text in re.findall(r"(?<![\w.])-?\d+\.?\d*(?:e[+-]?\d+)?(?![\w])", sentence)]


def test_the_path_is_relative_to_the_scenario_and_the_tolerance_is_kept(load: Load) -> None:
    scenario = load(1 - np.cos(T) ** 9)
    reference = scenario.reference
    assert isinstance(reference, fjr.SampledMotion)
    assert np.abs(reference.jets(T)[:, 0, 0] - (1 - np.cos(T) ** 9)).max() < 2e-6
    assert reference.tolerance == 1e-3
    assert load(np.sin(T), **{"reference.file.tolerance": [0.0]}).reference.deviation == 0.0


def test_a_changed_file_is_read_again(load: Load) -> None:
    first, second = (load(factor * np.sin(T)).reference.jets(1.0) for factor in (1.0, 2.0))
    np.testing.assert_allclose(second, 2 * first, rtol=1e-3)


def test_a_self_contained_scenario_holds_the_motion(load: Load, tmp_path: Path) -> None:
    expected = load(1 - np.cos(T)).reference.jets(T)
    document = ros_yaml.read(tmp_path / "own.yaml", "scenario")
    given = {node: ros_yaml.values_for(node, document) for node in ("fjr_plant", "fjr_controller")}
    text = ros_yaml.dump(self_contained(given, tmp_path))
    (tmp_path / "motion.csv").unlink()
    np.testing.assert_array_equal(parse_scenario("own", text).reference.jets(T), expected)


def test_a_robot_tracks_the_file(load: Load) -> None:
    scenario = load(1 - np.cos(T))
    run = simulate(scenario.plant, scenario.law, scenario.reference, scenario.x0, 5.0, 0.001)
    assert np.abs(run.x[1000:, 0] - run.jets[1000:, 0, 0]).max() < 0.01


def test_rounding_is_reported_with_both_efforts(load: Load) -> None:
    (sentence, *_) = load(np.sin(T)).motion_warnings
    assert "through every sample the motion of the file would ask for" in sentence
    raw, _, deviation, smooth = numbers(sentence)[:4]
    assert raw > 100.0
    assert deviation < 1e-6
    assert smooth == pytest.approx(0.69, rel=0.05)


def test_a_start_at_speed_is_reported_with_the_effort_from_rest(load: Load) -> None:
    sentence = next(each for each in load(np.sin(T)).motion_warnings if "starts at" in each)
    velocity, effort = numbers(sentence)
    assert velocity == pytest.approx(1.0, rel=0.01)
    assert effort == pytest.approx(517_000, rel=0.05)


def test_a_jump_is_reported_with_its_place_and_effort(load: Load) -> None:
    (sentence,) = load(np.sin(T) ** 5 + 0.5 * (T > 2.0)).motion_warnings
    assert "no smooth motion is within reference.file.tolerance, 0.001 rad, of the samples" in sentence
    assert "at 2 s to" in sentence
    assert numbers(sentence.split("asks for")[1])[0] > 1e6


def test_noise_is_reported_with_the_deviation_that_removes_it(load: Load) -> None:
    noise = 0.01 * np.random.default_rng(1).normal(size=len(T))
    (sentence,) = load(np.sin(T) + noise).motion_warnings
    deviation = numbers(sentence.split("deviates by")[1])[0]
    assert 0.02 < deviation < 0.1
    scenario = load(np.sin(T) + noise, **{"reference.file.tolerance": [1.01 * deviation]})
    assert np.abs(scenario.reference.jets(T)[:, 0, 0] - np.sin(T)).max() < 0.01


def test_an_effort_beyond_the_limit_is_reported(load: Load) -> None:
    q = 1 - np.cos(T)
    assert not [each for each in load(q, **{"limits.effort": [5.0]}).motion_warnings if "effort limit" in each]
    (sentence,) = (each for each in load(q, **{"limits.effort": [0.2]}).motion_warnings if "effort limit" in each)
    assert "of joint1 at" in sentence
    assert sentence.endswith("its effort limit is 0.2 N m")


def test_velocities_that_contradict_the_positions_are_reported(load: Load) -> None:
    right, wrong = (load(1 - np.cos(T), velocity=sign * np.sin(T)).motion_warnings for sign in (1.0, -1.0))
    assert not [each for each in right if "joint1_velocity" in each]
    (sentence,) = (each for each in wrong if "joint1_velocity" in each)
    assert numbers(sentence)[0] == pytest.approx(2.0, rel=0.01)


def test_waypoints_cause_no_warning(load: Load) -> None:
    assert load(np.array([0.0, 0.5, 0.2]), np.array([0.0, 2.0, 4.0])).motion_warnings == ()


BAD = {
    "no path": ("", "parameter 'reference.file.path' is empty; expected a CSV file"),
    "no file": ("none.csv", "No such file"),
    "bad header": ("own.yaml", "without time; expected the columns time, joint1"),
}


@pytest.mark.parametrize(("path", "words"), BAD.values(), ids=BAD)
def test_a_file_that_is_no_motion_is_refused_in_one_sentence(load: Load, tmp_path: Path, path: str, words: str) -> None:
    load(np.sin(T))
    text = (tmp_path / "own.yaml").read_text().replace("motion.csv", path or "''")
    (tmp_path / "own.yaml").write_text(text)
    with pytest.raises(fjr.ParameterError, match="parameter 'reference.file.path'") as caught:
        load_scenario(tmp_path / "own.yaml")
    assert words in str(caught.value)
