# SPDX-License-Identifier: Apache-2.0
"""References that start at rest: hold, point to point, and a circle."""

from __future__ import annotations

from dataclasses import MISSING, dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import ArrayLike

from ..errors import TrajectoryError
from ..numerics import checks
from ..numerics.checks import Array, freeze, joint_vector, number, positive
from ..numerics.one_line import one_line
from ..numerics.parameter_field import VECTOR
from .piecewise_polynomial import SAMPLES, PiecewisePolynomial, PolynomialReference
from .reference import JETS, MotionBounds, Reference, motion_bounds_on, motion_field, offset_field

_way, _circle = (partial(motion_field, name=f"{group}.") for group in ("point_to_point", "circle"))


def standing(q: ArrayLike, dq: ArrayLike = 0.0) -> Array:
    """Return jets (5, n) at q (n,) [rad] with velocity dq [rad/s] and zero higher derivatives."""
    q = joint_vector("q", q)
    jets = np.zeros((JETS, len(q)))
    jets[0], jets[1] = q, checks.vector("dq", dq, len(q), TrajectoryError)
    return jets


@dataclass(frozen=True, eq=False)
class Hold(PolynomialReference):
    """Constant reference q_ld(t) = q (n,) [rad]. Raises TrajectoryError unless q is a vector of finite numbers."""

    q: ArrayLike = offset_field()

    __repr__ = one_line

    def __post_init__(self) -> None:
        freeze(self, "q", joint_vector("q", self.q))
        self.set_knots(np.array([-1.0, 0.0]), np.stack([standing(self.q)] * 2))


@dataclass(frozen=True, eq=False)
class PointToPoint(PolynomialReference):
    """Motion from q0 to q1 (n,) [rad] in `duration` [s] with four zero derivatives at both ends; constant outside.

    returns: periodic motion forth and back, with a dwell [s] at each end. The peak velocity is
    2.46 |q1 - q0| / duration at half the duration.
    Raises TrajectoryError for a wrong shape, non-finite numbers, a duration that is not positive or a dwell < 0.
    """

    q0: ArrayLike = _way(MISSING, "Start position", "rad", name="point_to_point.start", shape=VECTOR)
    q1: ArrayLike = _way(MISSING, "Goal position", "rad", name="point_to_point.goal", shape=VECTOR)
    duration: float = _way(MISSING, "Duration of the motion", "s", minimum=1e-3)
    dwell: float = _way(0.0, "Dwell time at the goal, and at the start if it returns", "s", minimum=0.0)
    returns: bool = _way(False, "true: repeat back and forth; false: move once")

    __repr__ = one_line

    def __post_init__(self) -> None:
        freeze(self, "q0", joint_vector("q0", self.q0))
        freeze(self, "q1", checks.vector("q1", self.q1, np.size(self.q0), TrajectoryError))
        object.__setattr__(self, "duration", positive("duration", self.duration))
        object.__setattr__(self, "dwell", positive("dwell", self.dwell, zero=True))
        times, jets = [0.0, self.duration], [standing(self.q0), standing(self.q1)]
        if self.returns:
            back = self.duration + self.dwell
            times, jets = [*times, back, back + self.duration], [*jets, jets[1], jets[0]]
            object.__setattr__(self, "period", 2 * back)
        kept = np.diff(times, prepend=-1.0) > 0
        self.set_knots(np.array(times)[kept], np.array(jets)[kept])

    def configurations(self, k: int) -> Array:
        """Return k configurations (k, n) [rad], equally spaced between q0 and q1."""
        return np.linspace(np.asarray(self.q0), np.asarray(self.q1), k)


@dataclass(frozen=True, eq=False)
class Circle(Reference):
    """Circle in the plane of the first two joints; the other joints stay at centre (n,) [rad], n >= 2.

    q_ld1 = centre1 + radius cos(angle), q_ld2 = centre2 + radius sin(angle). The angle starts at phase [rad] with
    zero velocity and reaches frequency [rad/s] (negative: opposite direction) after ramp [s] along one polynomial.
    Raises TrajectoryError for fewer than two joints, non-finite numbers or a ramp that is not positive.
    """

    centre: ArrayLike = offset_field()
    radius: float = _circle(MISSING, "Radius of the circle in the plane of the first two joints", "rad", minimum=0.0)
    frequency: float = _circle(MISSING, "Angular frequency on the circle; negative: opposite direction", "rad/s")
    phase: float = _circle(0.0, "Initial angle on the circle", "rad")
    ramp: float = _circle(1.0, "Acceleration time from rest to the angular frequency", "s", minimum=1e-3)

    __repr__ = one_line

    def __post_init__(self) -> None:
        freeze(self, "centre", joint_vector("centre", self.centre))
        if self.n < 2:
            raise TrajectoryError(
                "centre has 1 entry; expected 2 or more, the circle is in the plane of the first two joints"
            )
        for name in ("radius", "frequency", "phase"):
            object.__setattr__(self, name, number(name, getattr(self, name)))
        object.__setattr__(self, "ramp", positive("ramp", self.ramp))

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
        angle = self.phase + np.linspace(0.0, 2 * np.pi * (self.frequency != 0), k, endpoint=False)
        q = np.tile(np.asarray(self.centre), (k, 1))
        q[:, :2] += self.radius * np.column_stack([np.cos(angle), np.sin(angle)])
        return q

    def motion_bounds(self, t0: float, t1: float) -> MotionBounds:
        """Return bounds of position, velocity and acceleration from t0 to t1 [s]."""
        turn = 2 * np.pi / abs(self.frequency) if self.frequency else 0.0
        stop = min(t1, max(t0, self.ramp) + turn)  # periodic after that
        turns = abs(self.frequency) * (stop - t0) / (2 * np.pi)
        return motion_bounds_on(self.jets, np.asarray(np.linspace(t0, stop, 4 * SAMPLES * (1 + int(np.ceil(turns))))))
