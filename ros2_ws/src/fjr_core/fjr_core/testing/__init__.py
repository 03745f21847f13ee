# SPDX-License-Identifier: Apache-2.0
"""Check a law or a plant of the user at random states (docs/own_law.md)."""

from .findings import CheckError
from .law_check import check_law
from .plant_check import check_plant

__all__ = ["CheckError", "check_law", "check_plant"]
