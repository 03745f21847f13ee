# SPDX-License-Identifier: Apache-2.0
"""Parameters: declared at a field, expanded for n joints, read in the declared shape; options of own classes."""

from __future__ import annotations

import inspect
from collections import Counter
from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fjr_core as fjr
import own_code
from fjr_core.config.controller import controller_parameters
from fjr_core.config.nodes import OwnParameters, all_parameters
from fjr_core.config.parameter import MATRIX, POINT, ROWS, VECTOR, complete, read, table
from fjr_core.config.plant import INTEGRATORS, plant_parameters
from fjr_core.config.robot import MODELS as ARGUMENTS
from fjr_core.config.scenario import Scenario, load_scenario, parse_scenario
from fjr_core.numerics import integrators
from fjr_core.numerics.parameter_field import declared, parameter_field
from fuzzing import refused

MODELS: dict[str, dict[str, Any]] = {
    "single_link": {},
    "planar_two_link": {"robot.model": "planar_two_link"},
    "urdf": {"robot.model": "urdf", "joints": ["a", "b", "c"]},
}


@dataclass(frozen=True)
class Example:
    gain: Any = parameter_field(MISSING, "Gain", "1/s", name="own_name", shape=MATRIX)
    computed: int = 3
    rate: float = parameter_field(2.0, "Rate", "Hz", minimum=1.0)
    limit: Any = parameter_field(np.inf, "Limit", "N m", name="limits.", infinite=True, shape=VECTOR)
    sines: Any = parameter_field(1.0, "Sines", shape=ROWS)
    place: Any = parameter_field(0.0, "Place", "m", shape=POINT)


DEFAULTS = Example(gain=4.0)


def test_fields_declare_names_units_and_defaults() -> None:
    found = declared(Example, "group.", vars(DEFAULTS))
    assert list(found) == ["gain", "rate", "limit", "sines", "place"]
    names = ["own_name", "rate", "limits.limit", "sines", "place"]
    assert [parameter.name for parameter in found.values()] == [f"group.{name}" for name in names]
    defaults = [parameter.default for parameter in table(found, 2)]
    assert defaults == [(4.0,) * 2, 2.0, (np.inf,) * 2, (1.0,) * 2, (0.0,) * 3]
    assert (found["rate"].unit, found["rate"].minimum, Example(gain=1.0).rate) == ("Hz", 1.0, 2.0)


def test_values_are_read_in_the_declared_shape() -> None:
    declarations = declared(Example, "", vars(DEFAULTS))
    given = {"own_name": [1.0, 2.0, 3.0, 4.0], "sines": [1.0] * 6, "place": [1.0, 2.0, 3.0]}
    found = read(declarations, complete(table(declarations, 2), given), 2)
    assert found["rate"] == 2.0
    assert np.array_equal(found["limit"], [np.inf, np.inf])
    assert np.array_equal(found["gain"], [[1.0, 2.0], [3.0, 4.0]])
    assert found["sines"].shape == (3, 2)
    assert np.array_equal(found["place"], given["place"])


@pytest.mark.parametrize("name", ["limits.limit", "own_name", "sines", "place"])
def test_a_wrong_length_is_rejected_by_name(name: str) -> None:
    declarations = declared(Example, "", vars(DEFAULTS))
    values = complete(table(declarations, 2), {name: [1.0] * 5})
    with pytest.raises(fjr.ParameterError, match=f"'{name}' has length 5"):
        read(declarations, values, 2)


@pytest.mark.parametrize("build", [fjr.single_link, fjr.planar_two_link])
def test_the_defaults_of_a_robot_are_those_of_the_function_that_builds_it(build: Any) -> None:
    assert ARGUMENTS[build.__name__] == {name: p.default for name, p in inspect.signature(build).parameters.items()}


def test_the_integrators_of_the_plant_are_those_that_there_are() -> None:
    assert INTEGRATORS == integrators.INTEGRATORS


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("own", [plant_parameters, controller_parameters])
def test_every_parameter_of_a_node_is_declared_once(own: OwnParameters, model: str) -> None:
    found = all_parameters(own, MODELS[model])
    assert [name for name, count in Counter(p.name for p in found).items() if count > 1] == []
    assert all(p.description and (not isinstance(p.default, tuple) or len(p.default)) for p in found)


INTEGERS = np.array([1, 2])
LAW = 'type: "own_code:Pd", options: {K_p: 30.0, weights: [2.0]}'
PLANT = 'type: "own_code:Ideal", options: {damping: 0.5}'
FILE = f"""
/**:
  ros__parameters:
    joints: [joint1]
    law: {{{LAW}}}
    plant: {{{PLANT}}}
"""


def test_options_of_a_file_for_both_nodes_reach_law_and_plant() -> None:
    scenario = parse_scenario("mine", FILE)
    law, plant = scenario.law.own, scenario.plant.own
    assert (law.K_p, law.K_d, law.gravity, law.note, plant.damping) == (30.0, 2.0, True, "", 0.5)
    np.testing.assert_array_equal(law.weights, [2.0])
    assert scenario.controller_values["law.options.weights"] == (2.0,)
    assert scenario.warnings == (
        "law.type own_code:Pd is evaluated in Python: sweeps and comparisons are not compiled and take longer",
        "plant.type own_code:Ideal is evaluated in Python: sweeps and comparisons are not compiled and take longer",
    )


REFUSED: dict[str, tuple[str, str, str]] = {
    "an integer": ("K_p: 30.0", "K_p: 30", "'law.options.K_p' holds 30 (an integer); expected a floating-point number"),
    "a scalar for a list": ("weights: [2.0]", "weights: 2.0", "'law.options.weights' is 2.0; expected a list"),
    "no default": (
        "own_code:Pd",
        "own_code:NoDefault",
        "parameter 'law.type': argument 'K' of NoDefault has no default; expected one: it is an option",
    ),
    "no type": ("own_code:Pd", "own_code:NoneDefault", "NoneDefault has the default None; expected a number, a string"),
    "no law": (LAW, 'type: "own_code:NoMethod"', "parameter 'law.type' is 'own_code:NoMethod': NoMethod has no method"),
    "no plant": (PLANT, 'type: "own_code:NoMethod"', "parameter 'plant.type' is 'own_code:NoMethod': NoMethod has no"),
    "no such option": ("K_p", "Kp", "'law.options.Kp'; did you mean 'law.options.K_p'?"),
    "a misspelt choice": ("own_code:Pd", "pid", "expected one of v_dpbc, pd_gravity, "),
}


@pytest.mark.parametrize(("old", "new", "sentence"), REFUSED.values(), ids=REFUSED)
def test_an_invalid_value_is_refused_in_one_sentence(old: str, new: str, sentence: str) -> None:
    refused(fjr.ParameterError, lambda: parse_scenario("mine", FILE.replace(old, new)), sentence)


def test_a_report_reads_a_scenario_without_importing_the_code_that_it_names(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(FILE.replace("own_code:", "not_there:").replace("K_p", "Kp"))
    scenario = load_scenario(file, user_code=False)
    assert scenario.controller_values["law.type"] == "not_there:Pd"
    assert scenario.certified_law is None
    assert not scenario.plant_is_the_model
    with pytest.raises(fjr.ParameterError, match="module not_there of 'not_there:"):
        load_scenario(file)


def test_no_rate_is_proven_with_another_plant() -> None:
    ideal, own = parse_scenario("ideal", "{}"), parse_scenario("own", FILE.replace("own_code:Pd", "v_dpbc"))
    heavier = Scenario("heavier", {**ideal.plant_values, "robot.motor_inertia": (0.06,)}, ideal.controller_values)
    assert [each.plant_is_the_model for each in (ideal, heavier, own)] == [True, False, False]
    for name, value in (("robot.deviations.link_mass", 0.2), ("robot.guesses.joint_stiffness", 30.0)):  # move nothing
        said = Scenario("said", ideal.plant_values, {**ideal.controller_values, name: (value,)})
        assert said.plant_is_the_model, name
    assert own.certified_law is own.law


def test_arrays_and_lists_of_numbers_are_lists_of_floats(monkeypatch: pytest.MonkeyPatch) -> None:
    class Lists(own_code.Pd):
        def __init__(self, robot: Any, a: Any = INTEGERS, b: Any = (1, 2.5), c: Any = ("x", "y")) -> None:
            super().__init__(robot)

    monkeypatch.setattr(own_code, "Lists", Lists, raising=False)
    values = parse_scenario("m", FILE.replace(LAW, 'type: "own_code:Lists"')).controller_values
    assert [values[f"law.options.{name}"] for name in "abc"] == [(1.0, 2.0), (1.0, 2.5), ("x", "y")]
