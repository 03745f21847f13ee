# SPDX-License-Identifier: Apache-2.0
"""Prepare a law of a comparison: tuned to equal bandwidth (docs/compare.md), with robust options."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from fjr_core.config.scenario import Scenario
from fjr_core.files.python_class import is_named
from fjr_core.law.python_law import own_law
from fjr_core.law.robust import Robust, sampled_law
from fjr_core.law.sampled_law import SampledLaw
from fjr_core.law.static_law import StaticLaw
from fjr_core.numerics.checks import Array
from fjr_core.stability.sampled_loop import spectral_radius

from ...tuning.equal_bandwidth import BaselineTarget, tune
from ..baseline_target import baseline_target

FEW = 4  # configurations of the reference at which a loop is checked


@dataclass(frozen=True, eq=False)
class TunedLaw:
    """Law with its gains as plain values and a summary of its tuning.

    effort_limit (n,) [N m]: saturation of every command, the same for all laws.
    """

    law: SampledLaw
    effort_limit: Array
    gains: Mapping[str, Any]
    tuning: str


def tuned_law(
    name: str,
    robust: Mapping[str, float],
    scenario: Scenario,
    retune: bool = False,
    options: Mapping[str, Any] | None = None,
) -> TunedLaw:
    """Return the law of this name for robot, start and reference of the scenario.

    v-dPBC keeps the gains of the scenario unless retune. robust: fields of Robust except hold, which is the sample
    period. A law of the user, module:Class, is not tuned: it has its options, arguments of its constructor. Raises
    FjrError if there is no such law or no stable gains.
    """
    target = baseline_target(scenario)
    hold = Robust(**robust, hold=scenario.sample_period)
    if is_named(name):
        own, options = own_law(name, scenario.robot, options or {}, compile=False), options or {}
        law = sampled_law(own, hold)
        return TunedLaw(law, target.effort_limit, dict(options), _own(own, target) + _unstable(law, scenario))
    found = tune(name, target, retune=retune)
    law = sampled_law(found.law, hold)
    gains = {**_plain(found.law.gains), **_plain(found, "omega", "damping")}
    return TunedLaw(law, found.effort_limit, gains, found.sentence + _unstable(law, scenario))


def _own(law: StaticLaw, target: BaselineTarget) -> str:
    """Return bandwidth and peak effort of a law that is not tuned."""
    bandwidth, peak = target.bandwidth_of(law) / target.bandwidth, target.peak_of(law) / target.peak
    return f"not tuned: bandwidth {bandwidth:.2g} times the target, peak effort {peak:.2g} times the target"


def _unstable(law: SampledLaw, scenario: Scenario) -> str:
    """Return a note if the sampled loop is unstable along the reference, else an empty string."""
    where, period = scenario.configurations(FEW), scenario.sample_period
    radius = spectral_radius(law, period, scenario.loop_delay, where, scenario.plant).max()
    return "" if radius < 1 else f"; unstable as sampled: spectral radius {radius:.4g}"


def _plain(value: Any, *names: str) -> dict[str, Any]:
    """Return the finite arrays and numbers of a dataclass as plain values."""
    arrays = {name: np.asarray(getattr(value, name)) for name in names or [field.name for field in fields(value)]}
    return {name: array.tolist() for name, array in arrays.items() if np.isfinite(array).all()}
