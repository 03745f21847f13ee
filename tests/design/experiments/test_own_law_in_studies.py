# SPDX-License-Identifier: Apache-2.0
"""A law of the user in a comparison and in a Monte-Carlo study has the results of the same law made of expressions."""

from __future__ import annotations

import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.config.scenario import parse_scenario
from fjr_design.experiments.comparison.tuned_law import tuned_law
from fjr_design.experiments.monte_carlo.distributions import read
from fjr_design.experiments.monte_carlo.sweep import Sweep

FILE = """
/**:
  ros__parameters:
    joints: [joint1]
    law: {type: LAW}
    plant: {type: PLANT}
    limits: {effort: [20.0]}
"""


def text(law: str = "v_dpbc", plant: str = "flexible_joint") -> str:
    return FILE.replace("LAW", f'"{law}"').replace("PLANT", f'"{plant}"')


def test_a_comparison_has_the_law_with_its_options_beside_the_tuned_laws() -> None:
    scenario = parse_scenario("s", text())
    known, own = (tuned_law(name, {}, scenario) for name in ("v_dpbc", "own_code:Wrapped"))
    assert own.tuning == "not tuned: bandwidth 1 times the target, peak effort 1 times the target"
    np.testing.assert_array_equal(own.effort_limit, known.effort_limit)
    chosen = tuned_law("own_code:Pd", {}, scenario, options={"K_p": 5.0})
    assert chosen.gains == {"K_p": 5.0}
    assert "bandwidth 0." in chosen.tuning
    with pytest.raises(fjr.FjrError, match=r"Pd takes .*unexpected keyword argument 'K'"):
        tuned_law("own_code:Pd", {}, scenario, options={"K": 5.0})


@pytest.mark.parametrize(("law", "plant"), [("own_code:Wrapped", "flexible_joint"), ("v_dpbc", "own_code:Ideal")])
def test_a_study_has_the_results_of_the_compiled_loop(law: str, plant: str) -> None:
    vary = {"delay": read("delay", {"uniform": [0.0, 1e-3]}), "external": read("external", {"uniform": [-1.0, 1.0]})}
    parts = [
        Sweep("s", scenario, 2, vary, duration=0.2, settle_after=0.1).part(0, 2)
        for scenario in (text(), text(law, plant))
    ]
    assert parts[0].keys() == parts[1].keys()
    assert list(parts[0].pop("cause")) == list(parts[1].pop("cause")) == ["", ""]
    for name, compiled in parts[0].items():
        np.testing.assert_allclose(parts[1][name], compiled, rtol=1e-7, err_msg=name)


def test_a_study_cannot_vary_what_only_the_built_in_plant_has() -> None:
    sweep = Sweep(
        "s", text(plant="own_code:Ideal"), 1, {"stiffness": read("stiffness", 1.1)}, duration=0.2, settle_after=0.1
    )
    with pytest.raises(fjr.ParameterError, match="stiffness of a run is not nominal; expected the nominal value for a"):
        sweep.part(0, 1)
