# SPDX-License-Identifier: Apache-2.0
"""Batch engine: thousands of closed-loop runs with drawn parameters in compiled code."""

from .closed_loop import ClosedLoop, Recorded
from .draws import Draws
from .outcomes import Outcomes

__all__ = ["ClosedLoop", "Draws", "Outcomes", "Recorded"]
