# SPDX-License-Identifier: Apache-2.0
"""Laws beside each other on one plant: metrics under imperfections, and how much of each imperfection a law bears."""

from .axes import AXES, Axis, Direction, directions
from .margins import Edge, search
from .needs import Needs, needs
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
