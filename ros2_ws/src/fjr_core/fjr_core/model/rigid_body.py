# SPDX-License-Identifier: Apache-2.0
"""Rigid bodies of a serial chain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ..errors import RobotError
from ..numerics import checks
from ..numerics.checks import Array
from ..numerics.one_line import one_line

EXACT = 1e-12  # tolerance: entries of rotations this close to 0, 1 or -1 are rounded


@dataclass(frozen=True)
class Body:
    """A joint and the rigid body it moves; lengths [m], masses [kg], inertias [kg m^2].

    rotation (3, 3), translation (3,): pose of the joint frame in the parent body frame at q = 0. axis (3,): joint axis
    in the joint frame. prismatic: the joint slides along the axis. mass, com (3,) and inertia (3, 3) about the centre
    of mass: of the body, in the joint frame.
    Raises RobotError for physically impossible numbers.
    """

    rotation: ArrayLike
    translation: ArrayLike
    axis: ArrayLike
    mass: float
    com: ArrayLike
    inertia: ArrayLike
    prismatic: bool = False

    __repr__ = one_line

    def __post_init__(self) -> None:
        for name in ("translation", "axis", "com"):
            object.__setattr__(self, name, checks.vector(name, getattr(self, name), 3, RobotError))
        for name in ("rotation", "inertia"):
            object.__setattr__(self, name, checks.matrix(name, getattr(self, name), 3, RobotError))
        checks.positive_semidefinite("inertia", np.asarray(self.inertia), RobotError)
        if not checks.vector("mass", self.mass, 1, RobotError)[0] >= 0:
            raise RobotError(f"mass is {self.mass} kg; expected 0 or more")
        if not np.linalg.norm(np.asarray(self.axis)) > 0:
            raise RobotError("axis is zero; expected a direction")
        R = np.asarray(self.rotation)
        if not (np.allclose(R @ R.T, np.eye(3), atol=1e-9) and np.linalg.det(R) > 0):
            raise RobotError(f"rotation is {R.tolist()}; expected a rotation matrix")


def z_aligned(bodies: Sequence[Body]) -> list[Body]:
    """Return the chain with body frames rotated so that every joint axis is z; round nearly exact rotations."""
    aligned, previous = [], np.eye(3)
    for body in bodies:
        turn = rotation_to(np.asarray(body.axis))
        rotation = previous.T @ np.asarray(body.rotation) @ turn
        nearest = np.round(rotation)
        aligned.append(
            replace(
                body,
                rotation=np.where(np.abs(rotation - nearest) < EXACT, nearest, rotation),
                translation=previous.T @ np.asarray(body.translation),
                axis=(0.0, 0.0, 1.0),
                com=turn.T @ np.asarray(body.com),
                inertia=turn.T @ np.asarray(body.inertia) @ turn,
            )
        )
        previous = turn
    return aligned


def rotation_to(axis: Array) -> Array:
    """Return a rotation whose third column is the axis; a permutation matrix for a coordinate axis."""
    z = axis / np.linalg.norm(axis)
    x = np.roll(np.eye(3)[np.argmax(np.abs(z))], 1)
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])
