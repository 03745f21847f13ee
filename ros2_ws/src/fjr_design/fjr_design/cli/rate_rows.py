# SPDX-License-Identifier: Apache-2.0
"""The rows of `fjr check` about convergence rates: proven over the joint range, near the reference, or sampled."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fjr_core.config.scenario import Scenario
from fjr_core.files import importing as other_package
from fjr_core.law.rate import Rate
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.numerics.one_line import at_least
from fjr_design.cli.preflight import as_list, position_unit

RATE_PROOF = "fjr_proofs.kept_rate"
INERTIA_BOUNDS = "fjr_proofs.verification.inertia_bounds"
OTHER_PLANT = "not proven here, the plant is not the law's model"


def rate_rows(scenario: Scenario, law: TrackingLaw) -> dict[str, str]:
    """Return beta and the beta of eq. (50) with their basis, and the configuration that attains a proven rate."""
    rate, proven = law.rate(), _kept(scenario)
    if proven is None:
        return _rows(rate.beta, rate.beta_paper, _basis(rate, scenario))
    basis = f"in continuous time, proven over the joint range{'' if proven.complete else ' so far'}"
    rows = _rows(
        proven.beta, proven.beta_paper, basis if scenario.plant_is_the_model else f"in continuous time; {OTHER_PLANT}"
    )
    sampled = "" if proven.complete else f"; minimum over sampled configurations: {rate.beta:.4g} 1/s"
    at = f"{as_list(np.array(proven.at))} {position_unit(scenario)}"
    return {**rows, "    rate at q_l": f"{at}: {proven.attained:.4g} 1/s{sampled}"}


def row_near_the_reference(scenario: Scenario, law: TrackingLaw) -> dict[str, str]:
    """Return the rate that is proven within a radius of the reference; no row if nothing can be proven."""
    if not _is_provable(scenario):
        return {}
    bounds = other_package.module(INERTIA_BOUNDS)
    domain, radius = other_package.module(RATE_PROOF).near_reference(scenario)
    rate = law.proven_rate(domain, most_boxes=bounds.few_boxes(scenario.robot))
    basis = "proven" if scenario.plant_is_the_model else OTHER_PLANT
    near = f"within {_range(radius)} {position_unit(scenario)} of the reference in each joint"
    return {"near the reference": f"beta {at_least(rate.beta)} 1/s {near}, {basis}"}


def rate_values(scenario: Scenario) -> dict[str, Any]:
    """Return beta and its basis, and the rate that a configuration attains; null for laws without a rate."""
    if not isinstance(scenario.law, TrackingLaw):
        return {"beta_per_s": None, "beta_is_proven": False, "beta_attained_per_s": None}
    rate, proven = scenario.law.rate(), _kept(scenario)
    beta, attained = (proven.beta, proven.attained) if proven else (rate.beta, None)
    is_proven = (rate.proven or proven is not None) and scenario.plant_is_the_model
    return {"beta_per_s": beta, "beta_is_proven": is_proven, "beta_attained_per_s": attained}


def _is_provable(scenario: Scenario) -> bool:
    """Return whether something can be proven about the robot: the package of the proofs is there and covers it."""
    bounds = other_package.module_if_there(INERTIA_BOUNDS)
    return bounds is not None and bool(bounds.is_provable(scenario.robot))


def _kept(scenario: Scenario) -> Any:
    """Return the ProvenRate that an earlier command has kept; None if there is none or a closed form proves one."""
    closed_form = scenario.robot.links.M_l_vertices is not None
    if closed_form or not _is_provable(scenario):
        return None
    return other_package.module(RATE_PROOF).cached_rate(scenario)


def _rows(beta: float, beta_paper: float, basis: str) -> dict[str, str]:
    return {
        "beta": f"{at_least(beta)} 1/s: V falls at least as exp(-2 beta t), {basis}",
        "beta of eq. (50)": f"{at_least(beta_paper)} 1/s, {basis}",
    }


def _basis(rate: Rate, scenario: Scenario) -> str:
    """Return the basis of a rate: a proof or samples."""
    if not rate.proven:
        return "in continuous time; minimum over sampled configurations, not proven"
    if not scenario.plant_is_the_model:
        return f"in continuous time; {OTHER_PLANT}"
    return "in continuous time for the exact model, proven for every configuration"


def _range(values: NDArray[np.float64]) -> str:
    """Return the one value, or the smallest and the largest one."""
    low, high = np.min(values), np.max(values)
    return f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"
