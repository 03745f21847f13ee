# SPDX-License-Identifier: Apache-2.0
"""Comparison of laws on one plant: metrics under perturbations and robustness margins."""

from .motion_demand import MotionDemand as MotionDemand
from .motion_demand import motion_demand as motion_demand
from .perturbations import PERTURBATIONS as PERTURBATIONS
from .perturbations import Direction as Direction
from .perturbations import directions as directions
from .robustness_margins import search as search
from .trial import Trial as Trial
