# SPDX-License-Identifier: Apache-2.0
"""Robust action that the paper lacks: residual feed-forward, integral action, prediction over the loop delay."""

from .law import RobustLaw, sampled_law
from .options import Robust

__all__ = ["Robust", "RobustLaw", "sampled_law"]
