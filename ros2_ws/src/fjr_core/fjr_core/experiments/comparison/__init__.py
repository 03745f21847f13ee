# SPDX-License-Identifier: Apache-2.0
"""Comparison of laws on one plant: metrics under perturbations and robustness margins."""

from .motion_demand import MotionDemand, motion_demand
from .perturbations import PERTURBATIONS, Direction, directions
from .robustness_margins import search
from .trial import Trial

__all__ = [
    "PERTURBATIONS",
    "Direction",
    "MotionDemand",
    "Trial",
    "directions",
    "motion_demand",
    "search",
]
