# SPDX-License-Identifier: Apache-2.0
"""A plant in Python moves as eq. (36) made of expressions, also with friction, external torques and in studies."""

from __future__ import annotations

import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.law.robust import sampled_law
from fjr_core.model.python_plant import own_plant
from fjr_core.simulation.batch import ClosedLoop, Draws
from fjr_core.simulation.imperfections import Imperfections
from fjr_core.simulation.nonideal_plant import NonidealPlant

ARM = fjr.planar_two_link()
LAW = fjr.TrackingLaw(ARM, fjr.PAPER_GAINS)
MOTION = fjr.Sine([0.3, 0.2], [1.0, 2.0])
START = ARM.state([0.1, 0.0], [0.1, 0.0], [0.0, 0.0], [0.0, 0.0])
OWN = own_plant("own_code:Ideal", ARM, {})
REACH = 0.05  # s


@pytest.mark.parametrize("period", [None, 1e-3])
def test_a_run_is_that_of_the_same_equations(period: float | None) -> None:
    runs = [fjr.simulate(plant, LAW, MOTION, START, REACH, period) for plant in (fjr.Plant(ARM), OWN)]
    np.testing.assert_allclose(runs[1].x, runs[0].x, rtol=1e-10, atol=1e-12)


def test_options_change_the_motion() -> None:
    damped = own_plant("own_code:Ideal", ARM, {"damping": 5.0})
    x, u = ARM.state([0.1, 0.2], [0.1, 0.2], [1.0, -1.0], [0.0, 0.0]), np.zeros(2)
    change = damped.derivative(x, u) - OWN.derivative(x, u)
    np.testing.assert_allclose(change, [0, 0, 0, 0, -5.0, 5.0, 0, 0], atol=1e-12)


def test_friction_ripple_and_external_torques_act_as_on_the_same_equations() -> None:
    errors = Imperfections(2, coulomb_l=[0.1, 0.2], coulomb_m=0.05, ripple=0.01, ripple_periods=4.0, lag=1e-3)
    state = np.append(START + 0.1, [1.0, 2.0])
    plants = [NonidealPlant(plant) for plant in (fjr.Plant(ARM), OWN)]
    steps = [plant.step(state, [3.0, 4.0], [0.5, 0.0], errors.vector, 2.5e-4) for plant in plants]
    np.testing.assert_allclose(steps[1], steps[0], rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("name", ["payload_mass", "cubic"])
def test_what_is_part_of_the_plant_itself_is_refused(name: str) -> None:
    with pytest.raises(fjr.ParameterError, match=f"{name} is not 0 for a plant in Python"):
        NonidealPlant(OWN).check(Imperfections(2, **{name: 1.0}))


def test_runs_of_a_study_are_those_of_the_same_equations() -> None:
    draws = Draws(2, external=[0.0, 1.0], delay=[0.0, 1.2e-3], coulomb_l=[0.0, 0.05])
    loops = [
        ClosedLoop(ARM, sampled_law(LAW), MOTION, START, REACH, 1e-3, settle_after=0.01, plant=plant)
        for plant in (None, OWN)
    ]
    compiled, own = (loop.run(draws) for loop in loops)
    for name in ("rms", "peak", "effort_peak", "power"):
        np.testing.assert_allclose(getattr(own, name), getattr(compiled, name), rtol=1e-8)
    with pytest.raises(fjr.ParameterError, match="stiffness of a run is not nominal; expected the nominal value"):
        loops[1].run(Draws(1, stiffness=1.1))


def test_the_stability_check_is_that_of_the_model() -> None:
    damped = own_plant("own_code:Ideal", ARM, {"damping": 5.0})
    at = [[0.3, 0.2]]
    assert fjr.spectral_radius(LAW, 1e-3, 0.0, at, damped) == fjr.spectral_radius(LAW, 1e-3, 0.0, at)


def test_a_failure_in_a_run_is_one_sentence_with_file_and_line() -> None:
    plant = own_plant("own_code:PlantFails", ARM, {})
    with pytest.raises(fjr.UserCodeError, match=r"^PlantFails raises ValueError: too far \(own_code.py, line \d+\)"):
        fjr.simulate(plant, LAW, MOTION, START + 0.8, REACH, 1e-3)


def test_an_implicit_integrator_is_refused() -> None:
    with pytest.raises(
        fjr.ParameterError, match="integrator is 'implicit_midpoint'; expected 'rk4' for the plant Idea"
    ):
        own_plant("own_code:Ideal", ARM, {}, "implicit_midpoint")
