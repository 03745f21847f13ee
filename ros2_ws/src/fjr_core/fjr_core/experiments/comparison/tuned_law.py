# SPDX-License-Identifier: Apache-2.0
"""A law of a comparison, ready to run: tuned by the one rule of docs/baselines.md, with robust options on it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from ...config.scenario import Scenario
from ...control.robust import Robust, sampled_law
from ...control.sampled_law import SampledLaw
from ...numerics.checks import Array
from ...stability.sampled_loop import spectral_radius
from ...tuning.equal_bandwidth import Yardstick, tune

FEW = 4  # points of the reference at which a loop is checked


@dataclass(frozen=True, eq=False)
class Column:
    """A law on a robot. gains, tuning: its gains in plain values, and what came of the rule in words.

    effort_limit (n,) [N m]: where every command is cut, the same for all laws.
    """

    law: SampledLaw
    effort_limit: Array
    gains: Mapping[str, Any]
    tuning: str


def column(name: str, robust: Mapping[str, float], scenario: Scenario, retune: bool = False) -> Column:
    """The law of this name for the scenario's robot, start, reference and (of v-dPBC, unless retune) gains.

    robust: fields of Robust but hold, which is the sample period. Raises FjrError where there is no such law.
    """
    robot, n = scenario.robot, scenario.robot.n
    start = scenario.x0[: 2 * n], np.hstack(robot.velocities(scenario.x0))
    yardstick = Yardstick(robot, scenario.reference, scenario.gains, start, scenario.sample_period)
    found = tune(name, yardstick, retune=retune)
    law = sampled_law(found.law, Robust(**robust, hold=scenario.sample_period))
    gains = {**_plain(found.law.gains), **_plain(found, "omega", "damping")}  # type: ignore[attr-defined]
    return Column(law, found.effort_limit, gains, found.sentence + _unstable(law, scenario))


def _unstable(law: SampledLaw, scenario: Scenario) -> str:
    """Return what the check says of the loop along the reference where it is unstable as sampled, else nothing."""
    where, period = scenario.configurations(FEW), scenario.sample_period
    radius = spectral_radius(law, period, scenario.loop_delay, where, scenario.plant).max()
    return "" if radius < 1 else f"; unstable as sampled: spectral radius {radius:.4g}"


def _plain(value: Any, *names: str) -> dict[str, Any]:
    """The numbers of a dataclass, those that are not finite left out."""
    arrays = {name: np.asarray(getattr(value, name)) for name in names or [field.name for field in fields(value)]}
    return {name: array.tolist() for name, array in arrays.items() if np.isfinite(array).all()}
