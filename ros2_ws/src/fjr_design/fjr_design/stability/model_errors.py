# SPDX-License-Identifier: Apache-2.0
"""Evaluate the sampled loop under parameter errors: stiffness or inertia wrong by 20 or 30 %, one at a time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from fjr_core.law.interfaces import SampledLaw, StaticLaw
from fjr_core.law.linearized import Equilibria, equilibria_at
from fjr_core.model.configuration_sampling import checked_configurations
from fjr_core.model.port_hamiltonian import Plant
from fjr_core.stability.linear_controller import Sensing, controller
from fjr_core.stability.linearization import as_sampled, on_plant

FACTORS = (0.7, 0.8, 1.2, 1.3)
"""Ratios of a plant parameter to its value in the model."""

QUANTITIES: Mapping[str, Callable[[Equilibria, float], Equilibria]] = {
    "stiffness": lambda equilibria, factor: replace(
        equilibria, robot=replace(equilibria.robot, K=factor * equilibria.robot.K)
    ),
    "link inertia": lambda equilibria, factor: replace(equilibria, M_l=factor * equilibria.M_l),
    "motor inertia": lambda equilibria, factor: replace(
        equilibria, robot=replace(equilibria.robot, M_m=factor * equilibria.robot.M_m)
    ),
}
"""Parameters that are changed, for all joints at once; the weight of the links stays."""


def radii_with_model_errors(
    law: StaticLaw | SampledLaw,
    sample_period: float,
    delay: float,
    configurations: ArrayLike,
    plant: Plant | None = None,
    sensing: Sensing | None = None,
) -> dict[tuple[str, float], float]:
    """Return the largest spectral radius at the configurations (k, n) [rad] for each (quantity, factor).

    The law keeps its model. Arguments as in sampled_loop.check. Raises StateError for wrong shapes.
    """
    sensing, q_l = sensing or Sensing(), checked_configurations(law.robot, configurations)
    own, real = equilibria_at(law.robot, q_l), equilibria_at((plant or Plant(law.robot)).robot, q_l)
    at = controller(as_sampled(law), own, sensing)
    return {
        (quantity, factor): float(np.max(on_plant(at, own, change(real, factor), sensing).radii(sample_period, delay)))
        for quantity, change in QUANTITIES.items()
        for factor in FACTORS
    }
