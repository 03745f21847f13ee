# SPDX-License-Identifier: Apache-2.0
"""Comparison of laws on one plant: metrics under perturbations and robustness margins."""

from .motion_demand import MotionDemand, motion_demand
from .perturbations import PERTURBATIONS, Direction, Perturbation, directions
from .robustness_margins import RobustnessMargin, search
from .trial import RunMetrics, Trial

__all__ = [
    "PERTURBATIONS",
    "RunMetrics",
    "Direction",
    "MotionDemand",
    "Perturbation",
    "RobustnessMargin",
    "Trial",
    "directions",
    "motion_demand",
    "search",
]
