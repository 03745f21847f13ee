# SPDX-License-Identifier: Apache-2.0
"""Parameters reference.*: each type builds its reference, each error is one sentence; files with large efforts."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.config import ros_yaml
from fjr_core.config.parameter import complete
from fjr_core.config.reference import reference as build_reference
from fjr_core.config.reference import reference_parameters
from fjr_core.config.scenario import Scenario, load_scenario, parse_scenario, self_contained
from fjr_core.motions.reference import Reference
from fuzzing import refused

T = np.array([0.3, 1.3, 2.2, 7.7])
OFFSET = {"offset": (0.4, -0.3)}
TYPES: dict[str, tuple[dict[str, Any], Reference]] = {
    "sine": (
        {"amplitude": (0.5, 0.2), "frequency": (2.0, 3.0), "phase": (0.1, 0.2), **OFFSET},
        fjr.Sine((0.5, 0.2), (2.0, 3.0), (0.4, -0.3), (0.1, 0.2)),
    ),
    "multi_sine": (
        {
            "multi_sine.amplitude": (0.5, 0.2, 0.1, 0.3),
            "multi_sine.frequency": (2.0, 3.0, 1.0, 0.5),
            "multi_sine.phase": (0.1, 0.2, 0.3, 0.4),
            **OFFSET,
        },
        fjr.MultiSine([[0.5, 0.2], [0.1, 0.3]], [[2.0, 3.0], [1.0, 0.5]], [[0.1, 0.2], [0.3, 0.4]], (0.4, -0.3)),
    ),
    "point_to_point": (
        {
            "point_to_point.start": (0.1, 0.2),
            "point_to_point.goal": (1.5, -0.4),
            "point_to_point.duration": 1.6,
            "point_to_point.dwell": 0.2,
            "point_to_point.returns": False,
        },
        fjr.PointToPoint((0.1, 0.2), (1.5, -0.4), 1.6, 0.2),
    ),
    "circle": (
        {"circle.radius": 0.3, "circle.frequency": -2.0, "circle.phase": 0.4, "circle.ramp": 1.7, **OFFSET},
        fjr.Circle((0.4, -0.3), 0.3, -2.0, 0.4, 1.7),
    ),
    "hold": (OFFSET, fjr.Hold((0.4, -0.3))),
}
OTHERS = {"amplitude": (1.0,), "multi_sine.phase": (1.0,), "point_to_point.goal": (1.0,)}
"""Wrong lengths, which only their own type reads."""


def made(n: int = 2, **given: Any) -> Reference:
    values = complete(reference_parameters(n), {f"reference.{name}": value for name, value in given.items()})
    return build_reference(values, n)


@pytest.mark.parametrize("kind", TYPES)
def test_each_type_is_built_from_its_own_parameters(kind: str) -> None:
    """No value is the default: a parameter that is not read would be seen. Parameters of other types are not read."""
    given, expected = TYPES[kind]
    found = made(type=kind, **OTHERS | given)
    assert type(found) is type(expected)
    np.testing.assert_array_equal(found.jets(T), expected.jets(T))


def test_defaults_are_a_sine_and_a_motion_to_and_fro_for_any_number_of_joints() -> None:
    np.testing.assert_array_equal(made(1).jets(T), fjr.Sine(1.0, 1.0).jets(T))
    there_and_back = fjr.PointToPoint((0.0,) * 7, (1.0,) * 7, 2.0, 0.7, returns=True)
    found = made(7, type="point_to_point", **{"point_to_point.dwell": 0.7})
    np.testing.assert_array_equal(found.jets(T), there_and_back.jets(T))
    assert [made(7, type=kind).n for kind in TYPES] == [7] * len(TYPES)


def test_all_parameters_but_those_of_files_are_dynamic_and_all_have_units() -> None:
    for parameter in reference_parameters(2):
        assert parameter.dynamic != parameter.name.startswith("reference.file.")
        without = ("reference.type", "reference.point_to_point.returns", "reference.file.path")
        assert parameter.unit or parameter.name in without


BAD: dict[str, tuple[int, dict[str, Any], tuple[str, ...]]] = {
    "type": (2, {"type": "square"}, ("reference.type", "square", "multi_sine", "hold")),
    "amplitude": (2, {"amplitude": (1.0,)}, ("reference.amplitude", "length 1", "2")),
    "rows": (2, {"type": "multi_sine", "multi_sine.phase": (1.0,) * 3}, ("multi_sine.phase", "3", "multiple of 2")),
    "counts": (2, {"type": "multi_sine", "multi_sine.phase": (1.0,) * 4}, ("multi_sine.phase", "(2, 2)", "(1, 2)")),
    "goal": (2, {"type": "point_to_point", "point_to_point.goal": (1.0,)}, ("point_to_point.goal", "length 1")),
    "duration": (2, {"point_to_point.duration": 0.0}, ("point_to_point.duration", "0.0 s", "at least")),
    "dwell": (2, {"point_to_point.dwell": -1.0}, ("point_to_point.dwell", "-1.0 s", "at least 0.0")),
    "circle": (1, {"type": "circle"}, ("reference.offset", "centre has 1 entry", "2 or more", "circle")),
}


@pytest.mark.parametrize(("n", "given", "words"), BAD.values(), ids=BAD)
def test_invalid_values_are_rejected_in_one_sentence(n: int, given: dict[str, Any], words: tuple[str, ...]) -> None:
    refused(fjr.ParameterError, lambda: made(n, **given), *words)


AT = np.arange(3001) / 1000  # s: 3 s at 1 kHz
Load = Callable[..., Scenario]


@pytest.fixture
def load(tmp_path: Path) -> Load:
    """Return a function that loads a scenario whose reference is the file motion.csv next to it."""

    def loaded(q: np.ndarray, times: np.ndarray = AT, velocity: np.ndarray | None = None, **extra: object) -> Scenario:
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


def test_the_path_is_relative_to_the_scenario_whose_tolerance_applies(load: Load) -> None:
    scenario = load(1 - np.cos(AT) ** 9)
    reference = scenario.reference
    assert isinstance(reference, fjr.SampledMotion)
    assert np.abs(reference.jets(AT)[:, 0, 0] - (1 - np.cos(AT) ** 9)).max() < 2e-6
    assert reference.tolerance == 1e-3
    exact = load(np.sin(AT), **{"reference.file.tolerance": [0.0]}).reference  # the changed file is read again
    assert exact.deviation == 0.0
    np.testing.assert_allclose(exact.jets(AT)[:, 0, 0], np.sin(AT), atol=1e-6)


def test_a_self_contained_scenario_holds_the_motion(load: Load, tmp_path: Path) -> None:
    expected = load(1 - np.cos(AT)).reference.jets(AT)
    document = ros_yaml.read(tmp_path / "own.yaml", "scenario")
    given = {node: ros_yaml.values_for(node, document) for node in ("fjr_plant", "fjr_controller")}
    text = ros_yaml.dump(self_contained(given, tmp_path))
    (tmp_path / "motion.csv").unlink()
    np.testing.assert_array_equal(parse_scenario("own", text).reference.jets(AT), expected)


def test_rounding_and_a_start_at_speed_are_reported_with_their_efforts(load: Load) -> None:
    sentence, *others = load(np.sin(AT)).motion_warnings
    assert "through every sample the motion of the file would ask for" in sentence
    raw, _, deviation, smooth = numbers(sentence)[:4]
    assert raw > 100.0
    assert deviation < 1e-6
    assert smooth == pytest.approx(0.69, rel=0.05)
    (start,) = (each for each in others if "starts at" in each)
    assert numbers(start) == [pytest.approx(1.0, rel=0.01), pytest.approx(517_000, rel=0.05)]


def test_a_jump_is_reported_with_its_place_and_effort(load: Load) -> None:
    (sentence,) = load(np.sin(AT) ** 5 + 0.5 * (AT > 2.0)).motion_warnings
    assert "no smooth motion is within reference.file.tolerance, 0.001 rad, of the samples" in sentence
    assert "at 2 s to" in sentence
    assert numbers(sentence.split("asks for")[1])[0] > 1e6


def test_noise_is_reported_with_the_deviation_that_removes_it(load: Load) -> None:
    noise = 0.01 * np.random.default_rng(1).normal(size=len(AT))
    (sentence,) = load(np.sin(AT) + noise).motion_warnings
    deviation = numbers(sentence.split("deviates by")[1])[0]
    assert 0.02 < deviation < 0.1
    scenario = load(np.sin(AT) + noise, **{"reference.file.tolerance": [1.01 * deviation]})
    assert np.abs(scenario.reference.jets(AT)[:, 0, 0] - np.sin(AT)).max() < 0.01


def test_an_effort_beyond_the_limit_is_reported(load: Load) -> None:
    q = 1 - np.cos(AT)
    assert not [each for each in load(q, **{"limits.effort": [5.0]}).motion_warnings if "effort limit" in each]
    (sentence,) = (each for each in load(q, **{"limits.effort": [0.2]}).motion_warnings if "effort limit" in each)
    assert "of joint1 at" in sentence
    assert sentence.endswith("its effort limit is 0.2 N m")


def test_velocities_that_contradict_the_positions_are_reported(load: Load) -> None:
    right, wrong = (load(1 - np.cos(AT), velocity=sign * np.sin(AT)).motion_warnings for sign in (1.0, -1.0))
    assert not [each for each in right if "joint1_velocity" in each]
    (sentence,) = (each for each in wrong if "joint1_velocity" in each)
    assert numbers(sentence)[0] == pytest.approx(2.0, rel=0.01)


def test_waypoints_cause_no_warning(load: Load) -> None:
    assert load(np.array([0.0, 0.5, 0.2]), np.array([0.0, 2.0, 4.0])).motion_warnings == ()


BAD_FILES = {
    "no path": ("", "parameter 'reference.file.path' is empty; expected a CSV file"),
    "no file": ("none.csv", "No such file"),
    "bad header": ("own.yaml", "without time; expected the columns time, joint1"),
}


@pytest.mark.parametrize(("path", "words"), BAD_FILES.values(), ids=BAD_FILES)
def test_a_file_that_is_no_motion_is_refused_in_one_sentence(load: Load, tmp_path: Path, path: str, words: str) -> None:
    load(np.sin(AT))
    text = (tmp_path / "own.yaml").read_text().replace("motion.csv", path or "''")
    (tmp_path / "own.yaml").write_text(text)
    refused(fjr.ParameterError, lambda: load_scenario(tmp_path / "own.yaml"), "parameter 'reference.file.path'", words)
