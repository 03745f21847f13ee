# SPDX-License-Identifier: Apache-2.0
"""Coordinates of the deviation in which the joints act on each other less than in their own.

A bound of each coordinate by itself ignores the signs of the others. In the modes of a mean inertia matrix M_l, which
the controller decouples, less is lost than in the joints:

    y = S z,  S = diag(R, R^-T K, R, R),   torques R^-T w,   accelerations R dz_3,   R' R = M_l
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Coordinates of deviations, torques, accelerations and efforts; R (n, n) as in the equation of the module."""

    robot: Robot
    R: Array

    @classmethod
    def modal(cls, robot: Robot, M_l: Array) -> Coordinates:
        """Return the coordinates of the eigenvectors of an inertia matrix M_l (n, n)."""
        eigenvalues, vectors = np.linalg.eigh(M_l)
        return cls(robot, np.sqrt(eigenvalues)[:, None] * vectors.T)

    @cached_property
    def S(self) -> Array:
        """Matrix (4n, 4n) of y = S z."""
        return np.asarray(block_diag(self.R, self.torque @ self.robot.K, self.R, self.R))

    @cached_property
    def S_inverse(self) -> Array:
        """Matrix (4n, 4n) of z = S^-1 y."""
        return np.asarray(np.linalg.inv(self.S))

    @cached_property
    def torque(self) -> Array:
        """Matrix R^-T (n, n) from torques [N m] to their coordinates."""
        return np.asarray(np.linalg.inv(self.R).T)

    @cached_property
    def acceleration(self) -> Array:
        """Matrix R^-1 (n, n) from coordinates to link accelerations."""
        return np.asarray(np.linalg.inv(self.R))

    @cached_property
    def effort(self) -> Array:
        """Matrix (n, n) from efforts to their coordinates."""
        return np.asarray(self.torque @ self.robot.B_m)

    @cached_property
    def effort_inverse(self) -> Array:
        """Matrix (n, n) from coordinates to efforts."""
        return np.asarray(np.linalg.inv(self.effort))

    @cached_property
    def torques(self) -> Array:
        """Matrix (2n, 2n) from torques on links and motors [N m] to their coordinates."""
        return np.asarray(block_diag(self.torque, self.torque))

    @cached_property
    def errors(self) -> Array:
        """Matrix (4n, 4n) from bounds of torques, accelerations and efforts to those of their coordinates."""
        return np.asarray(np.abs(block_diag(self.torques, self.R, self.effort)))
