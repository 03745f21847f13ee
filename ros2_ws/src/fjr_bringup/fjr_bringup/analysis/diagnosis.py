# SPDX-License-Identifier: Apache-2.0
"""Diagnose a recorded run with fjr_core."""

from __future__ import annotations

import numpy as np

from fjr_bringup.analysis.run_data import RunData
from fjr_core.config import builders
from fjr_core.config.diagnosis import axes
from fjr_core.config.scenario import Scenario
from fjr_core.monitoring.diagnosis import Diagnosis, diagnose, unknown


def diagnosis(data: RunData, scenario: Scenario) -> Diagnosis:
    """Return whether V decayed as guaranteed, and the causes if it did not."""
    law = scenario.certified_law
    if law is None:
        return unknown(f"the law {scenario.controller_values['law.type']} has no certificate")
    if not np.isfinite(data.V).any():
        return unknown("V is not known: the bag lacks links or motors")
    if not np.isfinite(data.u).any():
        return unknown("no effort of the controller was recorded")
    if not builders.robust(scenario.controller_values, scenario.robot.n).off:
        return unknown("V does not include the disturbance estimate (robust.* is enabled)")
    scales = axes(scenario.controller_values, scenario.robot)
    return diagnose(data, law, data.beta, scales, data.velocities_measured, data.certificate)
