# SPDX-License-Identifier: Apache-2.0
"""What of a scenario the closed loop of a campaign does not run: its own plant and sensors are drawn, not set."""

from __future__ import annotations

from ...config.scenario import Scenario, left_out
from ...errors import ParameterError

INTEGRATOR = "rk4"


def refuse_what_is_left_out(scenario: Scenario, instead: str) -> None:
    """Raise ParameterError where the scenario's plant or measurement do what a campaign would leave out in silence.

    instead: the sentence's end, where to say such things.
    """
    integrator = scenario.plant_values["integrator"]
    if integrator != INTEGRATOR:
        raise ParameterError(
            f"parameter 'integrator' is '{integrator}'; expected '{INTEGRATOR}', which is what runs here"
        )
    names = left_out(scenario)
    if names:
        raise ParameterError(f"the scenario sets {', '.join(names)}; expected the default here: {instead}")
