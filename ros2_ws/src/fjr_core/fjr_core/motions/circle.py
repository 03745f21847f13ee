# SPDX-License-Identifier: Apache-2.0
"""Joint-space circle: a reference on a circle in the plane of the first two joints."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ..errors import TrajectoryError
from ..numerics.checks import Array, freeze, joint_vector, number, positive
from ..numerics.one_line import one_line
from .bounds import MotionBounds, motion_bounds_on
from .piecewise_polynomial import SAMPLES, PiecewisePolynomial
from .point_to_point import standing
from .reference import JETS, Reference
from .sine import phases


@dataclass(frozen=True, eq=False)
class Circle(Reference):
    """Circle in the plane of the first two joints; the other joints stay at centre (n,) [rad], n >= 2.

    q_ld1 = centre1 + radius cos(angle), q_ld2 = centre2 + radius sin(angle). The angle starts at phase [rad] with
    zero velocity and reaches frequency [rad/s] (negative: opposite direction) after ramp [s] along one polynomial.
    Raises TrajectoryError for fewer than two joints, non-finite numbers or a ramp that is not positive.
    """

    centre: ArrayLike
    radius: float
    frequency: float
    phase: float = 0.0
    ramp: float = 1.0

    __repr__ = one_line

    def __post_init__(self) -> None:
        freeze(self, "centre", joint_vector("centre", self.centre))
        if self.n < 2:
            raise TrajectoryError(
                "centre has 1 entry; expected 2 or more, the circle is in the plane of the first two joints"
            )
        for name in ("radius", "frequency", "phase"):
            object.__setattr__(self, name, number(name, getattr(self, name)))
        positive("ramp", self.ramp)

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(np.size(self.centre))

    @cached_property
    def angle(self) -> PiecewisePolynomial:
        """Angle on the circle [rad], n = 1."""
        speed = self.frequency
        swept = standing([self.phase + speed * self.ramp / 2], [speed])
        return PiecewisePolynomial(
            np.array([0.0, self.ramp]), np.stack([standing([self.phase]), swept]), continues=True
        )

    def jets(self, t: ArrayLike) -> Array:
        """Return q_ld .. d4q_ld at time t [s]: (5, n) for a scalar t, (k, 5, n) for t (k,)."""
        angle, w, dw, ddw, d3w = self.angle.jets(t)[..., 0].T
        z = self.radius * np.exp(1j * angle)
        dz = 1j * w * z
        ddz = 1j * (dw * z + w * dz)
        d3z = 1j * (ddw * z + 2 * dw * dz + w * ddz)
        d4z = 1j * (d3w * z + 3 * ddw * dz + 3 * dw * ddz + w * d3z)
        planar = np.array([z, dz, ddz, d3z, d4z]).T
        jets = np.zeros((*np.shape(t), JETS, self.n))
        jets[..., 0], jets[..., 1] = planar.real, planar.imag
        jets[..., 0, :] += np.asarray(self.centre)
        return jets

    def configurations(self, k: int) -> Array:
        """Return k configurations (k, n) [rad], equally spaced on the circle."""
        angle = self.phase + phases(k, np.array([self.frequency]))[:, 0]
        q = np.tile(np.asarray(self.centre), (k, 1))
        q[:, :2] += self.radius * np.column_stack([np.cos(angle), np.sin(angle)])
        return q

    def motion_bounds(self, t0: float, t1: float) -> MotionBounds:
        """Return bounds of position, velocity and acceleration from t0 to t1 [s]."""
        turn = 2 * np.pi / abs(self.frequency) if self.frequency else 0.0
        stop = min(t1, max(t0, self.ramp) + turn)  # periodic after that
        turns = abs(self.frequency) * (stop - t0) / (2 * np.pi)
        return motion_bounds_on(self.jets, np.asarray(np.linspace(t0, stop, 4 * SAMPLES * (1 + int(np.ceil(turns))))))
