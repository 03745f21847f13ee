# SPDX-License-Identifier: Apache-2.0
"""Units of joint quantities: rad and N m for a revolute joint, m and N for a prismatic joint."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple


class Units(NamedTuple):
    """Units of the quantities of one joint."""

    position: str
    velocity: str
    acceleration: str
    effort: str


REVOLUTE = Units("rad", "rad/s", "rad/s^2", "N m")
PRISMATIC = Units("m", "m/s", "m/s^2", "N")


def joined(units: Iterable[str]) -> str:
    """Return the distinct units of several joints, separated by commas, as in "rad, m"."""
    return ", ".join(dict.fromkeys(units))
