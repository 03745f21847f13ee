# SPDX-License-Identifier: Apache-2.0
"""State the bound of the tracking error of a scenario in one sentence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fjr_bringup.progress import progress_bar
from fjr_core.config.scenario import Scenario
from fjr_core.control.robust import RobustLaw
from fjr_core.errors import ParameterError
from fjr_core.numerics.checks import Array
from fjr_core.stability.error_bound import ErrorBound, bound_errors
from fjr_core.stability.error_bound.error_bound import SECONDS_TO_PROVE, TORQUES

PROGRESS = "{desc}: {percentage:3.0f}% |{bar}|"


@dataclass(frozen=True)
class Bound:
    """Bound of the tracking error as a sentence and as plain values."""

    sentence: str
    values: Mapping[str, Any]


def errors_bounded(
    scenario: Scenario, errors: Mapping[str, float], delay: float | None, prove: bool | None = None
) -> Bound:
    """Return the bound for model errors and a delay [samples], by default that of the scenario.

    prove: see `bound_errors`. Raises ParameterError for an unknown error, and for a scenario that the bound does not
    cover.
    """
    _refuse(scenario)
    period = scenario.sample_period
    late = scenario.loop_delay if delay is None else delay * period
    given = scenario.law, scenario.reference, period, late, errors
    with progress_bar("bounding the tracking error", PROGRESS, total=1.0, desc="error bound") as bar:
        found = bound_errors(*given, lambda share: bar.update(share - bar.n), prove)
    hint = "" if prove or scenario.robot.n <= SECONDS_TO_PROVE else "; --prove-error tries a proof"
    return Bound(_sentence(scenario, found, hint), _values(scenario, found))


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


def _sentence(scenario: Scenario, found: ErrorBound, hint: str) -> str:
    """Return the bound in words; hint: after those of a bound without a proof."""
    errors = ", ".join(_error(*error) for error in found.errors.items())
    conditions = f"{errors} and {_delay(found)}" if errors else _delay(found)
    if not found.found:
        return f"with {conditions}: none found; expected smaller errors"
    joint = int(np.argmax(found.position))
    unit = scenario.robot.units[joint].position
    basis = f"along this reference; from sampled constants, not proven{hint}"
    if found.proven:
        steady = "" if np.all(np.isfinite(found.from_start)) else "in steady motion, "
        basis = f"{steady}proven along this reference"
    storage = "" if not np.isfinite(found.storage) else f", V at most {1e3 * found.storage:.3g} mJ"
    largest = f"{1e3 * found.position[joint]:.3g} m{unit} at {scenario.joints[joint]}"
    return f"with {conditions}: at most {largest}{storage}, {basis}"


def _error(name: str, size: float) -> str:
    words = name.replace("_", " ")
    return f"{size:g} N m of {words}" if name in TORQUES else f"{100 * size:g} % {words} error"


def _delay(found: ErrorBound) -> str:
    samples = found.delay / found.sample_period
    if not samples:
        return "no delay"
    return "one sample of delay" if np.isclose(samples, 1) else f"{samples:.3g} samples of delay"


def _values(scenario: Scenario, found: ErrorBound) -> dict[str, Any]:
    """Return the bounds of each joint; null without a bound."""
    return {
        "errors": dict(found.errors),
        "delay_samples": found.delay / found.sample_period,
        "position": _by_joint(scenario, found.position),
        "from_start": _by_joint(scenario, found.from_start),
        "V_J": found.storage if np.isfinite(found.storage) else None,
        "proven": found.proven,
        "parts": found.parts,
    }


def _by_joint(scenario: Scenario, sizes: Array) -> dict[str, float | None]:
    finite = np.isfinite(sizes)
    return {joint: float(size) if finite.all() else None for joint, size in zip(scenario.joints, sizes, strict=True)}
