# SPDX-License-Identifier: Apache-2.0
"""Units by joint: a revolute joint turns by rad with N m, a prismatic one slides by m with N."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple


class Units(NamedTuple):
    """Units of one joint's quantities."""

    position: str
    velocity: str
    acceleration: str
    effort: str


REVOLUTE = Units("rad", "rad/s", "rad/s^2", "N m")
PRISMATIC = Units("m", "m/s", "m/s^2", "N")


def joined(units: Iterable[str]) -> str:
    """The unit of several joints' values; all that occur where they differ, as in "rad, m"."""
    return ", ".join(dict.fromkeys(units))
