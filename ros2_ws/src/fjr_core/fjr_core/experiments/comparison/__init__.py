# SPDX-License-Identifier: Apache-2.0
"""Laws beside each other on one plant: metrics under imperfections, and how much of each imperfection a law bears."""

from .motion_demand import Needs, needs
from .perturbations import AXES, Axis, Direction, directions
from .robustness_margins import Edge, search
from .trial import Cell, Trial

__all__ = [
    "AXES",
    "Axis",
    "Cell",
    "Direction",
    "Edge",
    "Needs",
    "Trial",
    "directions",
    "needs",
    "search",
]
