# SPDX-License-Identifier: Apache-2.0
"""State the bound of the tracking error of a scenario in one sentence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fjr_core.config.scenario import Scenario
from fjr_core.control.robust import RobustLaw
from fjr_core.errors import ParameterError
from fjr_core.stability.error_bound import ErrorBound, bound_errors
from fjr_core.stability.error_bound.error_bound import TORQUES


@dataclass(frozen=True)
class Bound:
    """Bound of the tracking error as a sentence and as plain values."""

    sentence: str
    values: Mapping[str, Any]


def errors_bounded(scenario: Scenario, errors: Mapping[str, float], delay: float | None) -> Bound:
    """Return the bound for model errors and a delay [samples], by default that of the scenario.

    Raises ParameterError for an unknown error, and for a scenario that the bound does not cover.
    """
    _refuse(scenario)
    period = scenario.sample_period
    late = scenario.loop_delay if delay is None else delay * period
    found = bound_errors(scenario.law, scenario.reference, period, late, errors)
    return Bound(_sentence(scenario, found), _values(scenario, found))


def _refuse(scenario: Scenario) -> None:
    reasons = {
        "robust.* is enabled": isinstance(scenario.sampled_law, RobustLaw),
        "the law is evaluated in Python": scenario.law.in_python,
        "velocities or motor positions are estimated": not scenario.sensing.plain,
        "the plant is not the law's model": not scenario.plant_is_the_model,
    }
    for reason, given in reasons.items():
        if given:
            raise ParameterError(
                f"{reason}; expected a static law with all states measured for a bound of the tracking error, and the "
                "difference from the model as an error"
            )


def _sentence(scenario: Scenario, found: ErrorBound) -> str:
    errors = ", ".join(_error(*error) for error in found.errors.items())
    conditions = f"{errors} and {_delay(found)}" if errors else _delay(found)
    if not found.found:
        return f"with {conditions}: none found; expected smaller errors"
    joint = int(np.argmax(found.position))
    unit = scenario.robot.units[joint].position
    basis = (
        "proven along this reference" if found.proven else "along this reference; from sampled constants, not proven"
    )
    return f"with {conditions}: at most {1e3 * found.position[joint]:.3g} m{unit} at {scenario.joints[joint]}, {basis}"


def _error(name: str, size: float) -> str:
    words = name.replace("_", " ")
    return f"{size:g} N m of {words}" if name in TORQUES else f"{100 * size:g} % {words} error"


def _delay(found: ErrorBound) -> str:
    samples = found.delay / found.sample_period
    if not samples:
        return "no delay"
    return "one sample of delay" if np.isclose(samples, 1) else f"{samples:.3g} samples of delay"


def _values(scenario: Scenario, found: ErrorBound) -> dict[str, Any]:
    """Return the bound of each joint; null without a bound."""
    positions = zip(scenario.joints, found.position, strict=True)
    return {
        "errors": dict(found.errors),
        "delay_samples": found.delay / found.sample_period,
        "position": {joint: float(size) if found.found else None for joint, size in positions},
        "proven": found.proven,
        "parts": found.parts,
    }
