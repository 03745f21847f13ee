# SPDX-License-Identifier: Apache-2.0
"""The closed loop of a scenario for studies: the controller as its node runs it, with the ideal plant."""

from __future__ import annotations

from typing import Any

from fjr_core.config.controller import measurement, observer, safety
from fjr_core.config.parameter import number
from fjr_core.config.scenario import Scenario, left_out
from fjr_core.errors import ParameterError
from fjr_core.law.interfaces import SampledLaw
from fjr_core.simulation.batch import ClosedLoop

INTEGRATOR = "rk4"


def scenario_loop(scenario: Scenario, law: SampledLaw, duration: float, **options: Any) -> ClosedLoop:
    """Return the closed loop of a scenario under a law, with its limits, start, stop policy, observer and measurement.

    options: of ClosedLoop.
    """
    values, robot = scenario.controller_values, scenario.robot
    return ClosedLoop(
        scenario.plant.robot,
        law,
        scenario.reference,
        scenario.x0,
        duration,
        scenario.sample_period,
        inner_steps=int(number(scenario.plant_values, "inner_steps")),
        plant=scenario.plant,
        settings=safety(values, robot),
        observer=observer(values, robot),
        measurement=measurement(values, robot),
        **options,
    )


def refuse_what_is_left_out(scenario: Scenario, instead: str) -> None:
    """Raise ParameterError if the plant of the scenario has features that a study does not simulate.

    instead: end of the sentence, which names the alternative.
    """
    integrator = scenario.plant_values["integrator"]
    if integrator != INTEGRATOR:
        raise ParameterError(
            f"parameter 'integrator' is '{integrator}'; expected '{INTEGRATOR}', the integrator of a study"
        )
    names = [name for name in left_out(scenario) if name.startswith("imperfections.")]
    if names:
        raise ParameterError(f"the scenario sets {', '.join(names)}; expected the default here: {instead}")
