# SPDX-License-Identifier: Apache-2.0
"""Campaigns: the closed loop run thousands of times with numbers drawn, inside compiled code."""

from .closed_loop import ClosedLoop, Recorded
from .draws import Draws
from .outcomes import Outcomes

__all__ = ["ClosedLoop", "Draws", "Outcomes", "Recorded"]
