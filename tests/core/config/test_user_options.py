# SPDX-License-Identifier: Apache-2.0
"""The options of a class of the user are parameters: law.options.* of the controller, plant.options.* of the plant."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fjr_core as fjr
import own_code
from fjr_core.config.scenario import load_scenario, parse_scenario

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
    law, plant = scenario.law.own, scenario.plant.own  # type: ignore[attr-defined]
    assert (law.K_p, law.K_d, law.gravity, law.note, plant.damping) == (30.0, 2.0, True, "", 0.5)
    np.testing.assert_array_equal(law.weights, [2.0])
    assert scenario.controller_values["law.options.weights"] == (2.0,)
    assert scenario.warnings == (
        "law.type own_code:Pd is evaluated in Python: sweeps and comparisons are not compiled, so they take longer",
        "plant.type own_code:Ideal is evaluated in Python: "
        "sweeps and comparisons are not compiled, so they take longer",
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
    "no law": (
        LAW,
        'type: "own_code:NoMethod"',
        "parameter 'law.type' is 'own_code:NoMethod': NoMethod has no method",
    ),
    "no plant": (
        PLANT,
        'type: "own_code:NoMethod"',
        "parameter 'plant.type' is 'own_code:NoMethod': NoMethod has no",
    ),
    "a misspelt choice": ("own_code:Pd", "pid", "expected one of v_dpbc, pd_gravity, "),
}


@pytest.mark.parametrize(("old", "new", "sentence"), REFUSED.values(), ids=REFUSED)
def test_an_invalid_value_is_refused_in_one_sentence(old: str, new: str, sentence: str) -> None:
    with pytest.raises(fjr.ParameterError) as found:
        parse_scenario("mine", FILE.replace(old, new))
    assert sentence in str(found.value)
    assert "\n" not in str(found.value)


def test_a_report_reads_a_scenario_without_importing_the_code_that_it_names(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(FILE.replace("own_code:", "not_there:"))
    scenario = load_scenario(file, user_code=False)
    assert scenario.controller_values["law.type"] == "not_there:Pd"
    assert scenario.certified_law is None
    assert not scenario.plant_is_the_model
    with pytest.raises(fjr.ParameterError, match="module not_there of 'not_there:"):
        load_scenario(file)


def test_no_rate_is_proven_with_another_plant() -> None:
    ideal, own = (
        parse_scenario("ideal", "/**: {ros__parameters: {joints: [joint1]}}"),
        parse_scenario("own", FILE.replace("own_code:Pd", "v_dpbc")),
    )
    assert ideal.plant_is_the_model
    assert not own.plant_is_the_model
    assert own.certified_law is own.law


def test_an_unknown_option_is_refused_where_the_class_may_be_imported(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(FILE.replace("K_p", "Kp"))
    with pytest.raises(
        fjr.ParameterError, match=r"unknown parameter 'law.options.Kp'; did you mean 'law.options.K_p'\?"
    ):
        load_scenario(file)
    assert load_scenario(file, user_code=False).name == "mine"


def test_arrays_and_lists_of_numbers_are_lists_of_floats() -> None:
    class Lists(own_code.Pd):
        def __init__(self, robot: Any, a: Any = INTEGERS, b: Any = (1, 2.5), c: Any = ("x", "y")) -> None:
            super().__init__(robot)

    own_code.Lists = Lists  # type: ignore[attr-defined]
    try:
        values = parse_scenario("m", FILE.replace(LAW, 'type: "own_code:Lists"')).controller_values
        assert [values[f"law.options.{name}"] for name in "abc"] == [(1.0, 2.0), (1.0, 2.5), ("x", "y")]
    finally:
        del own_code.Lists  # type: ignore[attr-defined]
