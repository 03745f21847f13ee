# SPDX-License-Identifier: Apache-2.0
"""Batch engine: thousands of closed-loop runs with drawn parameters in compiled code."""

from .closed_loop import ClosedLoop, Outcomes, Recorded, scenario_loop
from .draws import Draws

__all__ = ["ClosedLoop", "Draws", "Outcomes", "Recorded", "scenario_loop"]
