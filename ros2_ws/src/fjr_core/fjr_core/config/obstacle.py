# SPDX-License-Identifier: Apache-2.0
"""Parameters obstacle.* of the plant node: what the arm may touch, at rest in the frame of its base."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ..errors import ParameterError
from ..numerics.checks import Array
from ..numerics.parameter_field import POINT, declared, parameter_field
from ..urdf.tree import is_xml
from .parameter import Parameter, Values, read, table
from .robot import description, locked_positions

NONE, BOX, WALL, TABLE, MJCF = "none", "box", "wall", "table", "mjcf"
UP = (0.0, 0.0, 1.0)
ABLE = "mujoco"
"""The engine that has contact."""


@dataclass(frozen=True)
class Obstacle:
    """A body that the arm may touch; the fields declare units and descriptions.

    A box is aligned with the base. Wall and table are plates: `position` is the centre of the face out of which
    `normal` points, which is up for a table; the last entry of `size` is the thickness behind it. mjcf: path, or text.
    urdf: text with the shapes of the arm; locked: positions [rad, m] of its joints that do not move.
    """

    kind: str = parameter_field(
        NONE, "What the arm may touch; expects engine: mujoco", name="type", choices=(NONE, BOX, WALL, TABLE, MJCF)
    )
    position: Array = parameter_field(
        0.0, "Centre of the box, or of the face of wall or table, in the base frame", "m", shape=POINT
    )
    size: Array = parameter_field(
        (1.0, 1.0, 0.1), "Lengths of the edges, of wall and table the thickness last", "m", minimum=1e-3, shape=POINT
    )
    normal: Array = parameter_field(UP, "Direction out of the face of a wall", shape=POINT, constraint="not zero")
    mjcf: str = parameter_field("", "MJCF of bodies that do not move: a path, package:// or the XML text itself")
    present: bool = parameter_field(True, "Whether the obstacle is there", dynamic=True)
    urdf: str = ""
    locked: Mapping[str, float] = field(default_factory=dict)


_DECLARED = declared(Obstacle, "obstacle.")
KIND, PRESENT = (_DECLARED[each].name for each in ("kind", "present"))


def obstacle_parameters() -> list[Parameter]:
    """Return the parameters obstacle.*."""
    return table(_DECLARED, 0)


def obstacle(values: Values) -> Obstacle | None:
    """Return the obstacle of the plant's values, None for none; raise ParameterError."""
    found = Obstacle(**read(_DECLARED, values, 0), locked=locked_positions(values))
    if found.kind == NONE:
        return None
    if values["engine"] != ABLE:
        raise ParameterError(
            f"parameter '{KIND}' is '{found.kind}' with engine '{values['engine']}'; "
            f"expected engine: {ABLE}, the one that has contact"
        )
    if not np.linalg.norm(found.normal) > 0:
        raise ParameterError(f"parameter '{_DECLARED['normal'].name}' is {found.normal.tolist()}; expected a direction")
    if found.kind == MJCF and not (is_xml(found.mjcf) or Path(found.mjcf).is_file()):
        raise ParameterError(f"parameter '{_DECLARED['mjcf'].name}' is '{found.mjcf}'; expected a file, or XML text")
    return replace(found, urdf=description(values))
