# SPDX-License-Identifier: Apache-2.0
"""State the bound of the tracking error of a scenario in one sentence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fjr_core.config.scenario import Scenario
from fjr_core.errors import ParameterError
from fjr_core.law.robust import RobustLaw
from fjr_core.numerics.checks import Array
from fjr_core.numerics.one_line import at_most
from fjr_msgs_py.console.output import progress_bar
from fjr_proofs.error_bound import ErrorBound, bound_errors
from fjr_proofs.error_bound.error_bound import SECONDS_TO_PROVE, TORQUES

PROGRESS = "{desc}: {percentage:3.0f}% |{bar}|"
COMMON = {
    "payload": "link masses and inertias",
    "link_inertia": "link inertias",
    "gravity": "link weights",
    "stiffness": "joint stiffnesses",
    "motor_inertia": "motor inertias",
    "link_damping": "link dampings",
    "motor_damping": "motor dampings",
}
"""What one relative error multiplies."""


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
    tried = prove or scenario.robot.n <= SECONDS_TO_PROVE
    hint = "no proof was found" if tried else "--prove-error tries a proof"
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
    conditions = ", ".join([*(_error(*error) for error in found.errors.items()), _delay(found)])
    if not found.found:
        return f"none found with {conditions}; expected smaller errors"
    joint = int(np.argmax(found.position))
    unit = scenario.robot.units[joint].position
    basis = f"from sampled constants, not proven: {hint}"
    if found.proven:
        basis = "proven"
    steady = found.proven and not np.all(np.isfinite(found.from_start))
    when = "in steady motion" if steady else "after the transient"
    storage = f", V at most {at_most(1e3 * found.storage)} mJ" if np.isfinite(found.storage) else ""
    largest = f"{at_most(1e3 * found.position[joint])} m{unit} ({scenario.joints[joint]})"
    return f"|q_l - q_ld| at most {largest}{storage} {when} along this reference, with {conditions}; {basis}"


def _error(name: str, size: float) -> str:
    if name in TORQUES:
        return f"{name.replace('_', ' ')}s of up to {size:g} N m"
    return f"all {COMMON[name]} off by one common factor of up to {100 * size:g} %"


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
