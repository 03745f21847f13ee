# SPDX-License-Identifier: Apache-2.0
"""Springs of the joints: the torque phi(zeta) of a deflection zeta = q_m - q_l, straight or on one of two curves.

    straight  phi = K zeta with a matrix K
    cubic     phi = K zeta + k zeta^3 of each joint, an odd polynomial that hardens for k > 0 (CubicCurve)
    torsion   odd through the points of a table, with the slope K at zero; parabolas in pieces (TorsionCurve)

The law needs the torque, its integral, the tangent phi', the secant S with phi(a) - phi(b) = S (a - b), and the
inverse. Curves are monotone, so the inverse is their only real root. K is diagonal where a joint has a curve.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ..errors import RobotError
from ..numerics import checks
from ..numerics.checks import Array

MOST_POINTS = 8
"""Points of a torsion curve; FJR_PIECES of runtime/step.h has two parabolas for each."""


@dataclass(frozen=True, eq=False)
class CubicCurve:
    """Odd cubic polynomial of one joint with K > 0 [N m/rad] and k >= 0 [N m/rad^3], numbers or symbols."""

    K: Any
    k: Any

    def scaled(self, factor: Any) -> CubicCurve:
        """Return the curve with factor times the torque."""
        return CubicCurve(factor * self.K, factor * self.k)

    def phi(self, zeta: Any) -> Any:
        """Return the torque [N m] at a deflection."""
        return self.K * zeta + self.k * zeta * zeta * zeta

    def stored(self, zeta: Any) -> Any:
        """Return the energy [J] at a deflection."""
        return zeta * zeta * (self.K / 2 + self.k * zeta * zeta / 4)

    def tangent(self, zeta: Any) -> Any:
        """Return phi' [N m/rad] at a deflection."""
        return self.K + 3 * self.k * zeta * zeta

    def inverse(self, tau: Any) -> Any:
        """Return the deflection [rad] at a torque."""
        return root(self.K, self.k, tau)

    def secant(self, a: Any, b: Any) -> Any:
        """Return S(a, b) [N m/rad]."""
        return self.K + self.k * (a * a + a * b + b * b)


@dataclass(frozen=True, eq=False)
class TorsionCurve:
    """Odd and monotone C1 curve of one joint, of k parabolas; x >= 0 is the distance of |zeta| from the k-th edge:

        phi = torque + stiffness x + slope x^2 / 2,   phi' = stiffness + slope x,   int phi = energy + ..

    The tangent at a point of the table is the harmonic mean of the slopes of the chords on both sides (as in SciPy's
    PCHIP where points are evenly spaced), K at zero. Between two points it is linear in each half of the interval, with
    the mean of the chord (L. Schumaker, SIAM J. Numer. Anal. 20(4), 1983), and beyond the middle of the last interval
    constant. The harmonic mean is below twice either slope, so each tangent is positive, and phi and its inverse
    are in closed form. Fields are (k,) [rad, N m, N m/rad, N m/rad^2, J]; all but edge may be symbols.
    """

    edge: Array
    torque: Any
    stiffness: Any
    slope: Any
    energy: Any

    def scaled(self, factor: Any) -> TorsionCurve:
        """Return the curve with factor times the torque."""
        rows = self.torque, self.stiffness, self.slope, self.energy
        return TorsionCurve(self.edge, *([factor * each for each in row] for row in rows))

    def phi(self, zeta: ca.SX) -> ca.SX:
        """Return the torque [N m] at a deflection."""
        side, size, edge, torque, stiffness, slope, _ = self._piece(zeta, self.edge)
        x = size - edge
        return side * (torque + x * (stiffness + slope * x / 2))

    def stored(self, zeta: ca.SX) -> ca.SX:
        """Return the energy [J] at a deflection."""
        _, size, edge, torque, stiffness, slope, energy = self._piece(zeta, self.edge)
        x = size - edge
        return energy + x * (torque + x * (stiffness / 2 + slope * x / 6))

    def tangent(self, zeta: ca.SX) -> ca.SX:
        """Return phi' [N m/rad] at a deflection."""
        _, size, edge, _, stiffness, slope, _ = self._piece(zeta, self.edge)
        return stiffness + slope * (size - edge)

    def inverse(self, tau: ca.SX) -> ca.SX:
        """Return the deflection [rad] at a torque: x = 2 r / (d + (d^2 + 2 c r)^(1/2)) with r = |tau| - torque."""
        side, size, edge, torque, d, c, _ = self._piece(tau, self.torque)
        r = size - torque
        return side * (edge + 2 * r / (d + ca.sqrt(d * d + 2 * c * r)))

    def secant(self, a: ca.SX, b: ca.SX) -> ca.SX:
        """Return S(a, b) [N m/rad]: on one parabola the tangent in the middle, without a division by a - b."""
        (side, size, edge, _, d, c, _), (other, length, start, *_) = (self._piece(each, self.edge) for each in (a, b))
        same = ca.logic_and(side == other, edge == start)
        apart = ca.if_else(same, 1, a - b)
        return ca.if_else(same, d + c * ((size - edge) + (length - start)) / 2, (self.phi(a) - self.phi(b)) / apart)

    def _piece(self, value: ca.SX, ends: Any) -> tuple[Any, ...]:
        """Return side and size of a value, and the fields of its piece, which begins at one of the ends (k,).

        The fields are constant where the value is differentiated; a value at an end belongs to the piece beyond.
        """
        side = ca.if_else(value < 0, -1, 1)
        rows = self.edge, self.torque, self.stiffness, self.slope, self.energy
        found = [row[0] for row in rows]
        for k in range(1, len(self.edge)):
            beyond = side * value >= ends[k]
            found = [ca.if_else(beyond, row[k], before) for row, before in zip(rows, found, strict=True)]
        return side, side * value, *found


def checked_cubic(value: ArrayLike, K: Array) -> Array | None:
    """Return the cubic stiffness (n,) of a robot, None if it is zero; raises RobotError."""
    cubic = checks.vector("cubic", value, len(K), RobotError)
    if np.any(cubic < 0):
        raise RobotError(f"cubic is {cubic.tolist()} N m/rad^3; expected 0 or more: a softening spring has no inverse")
    if not cubic.any():
        return None
    _refuse_coupled("cubic", K)
    cubic.setflags(write=False)
    return cubic


def checked_torsion(value: ArrayLike, K: Array) -> Array | None:
    """Return the points (2, m, n) of the torsion curves of a robot, None if all are zero; raises RobotError."""
    points = checks.finite("torsion", value, RobotError)
    if points.ndim != 3 or points.shape[::2] != (2, len(K)) or not 1 <= points.shape[1] <= MOST_POINTS:
        raise RobotError(f"torsion has shape {points.shape}; expected (2, m, {len(K)}) with m of 1 to {MOST_POINTS}")
    if not points.any():
        return None
    _refuse_coupled("torsion", K)
    for j, (stiffness, of_joint) in enumerate(zip(np.diag(K), np.moveaxis(points, 2, 0), strict=True), 1):
        if of_joint.any() and not np.all(np.diff(of_joint, prepend=0.0) > 0):
            raise RobotError(f"torsion of joint {j} is {of_joint.tolist()}; expected increasing positive numbers")
        curve = torsion_curve(stiffness, *of_joint)
        if min(curve.stiffness) <= 0:
            raise RobotError(
                f"torsion of joint {j} begins so much flatter than its K of {stiffness:g} N m/rad that it would fall; "
                "expected a smaller K, or more torque at the first point"
            )
    points.setflags(write=False)
    return points


def _refuse_coupled(name: str, K: Array) -> None:
    if not checks.is_diagonal(K):
        raise RobotError(f"{name} is not 0 with a matrix K that couples the joints; expected a diagonal K")


def torsion_curve(K: float, deflection: Array, torque: Array) -> TorsionCurve:
    """Return the curve with the slope K [N m/rad] at zero through points (m,) [rad, N m]; zeros: the line K zeta."""
    z, t = np.append(0.0, deflection), np.append(0.0, torque)
    if not deflection.any():
        z = np.arange(len(deflection) + 1.0)
        t = K * z
    half, chord = np.diff(z) / 2, np.diff(t) / np.diff(z)
    at = np.concatenate([[K], 2 * chord[1:] * chord[:-1] / (chord[1:] + chord[:-1]), [0.0]])
    at[-1] = (4 * chord[-1] - at[-2]) / 3
    middle = 2 * chord - (at[:-1] + at[1:]) / 2
    edge, stiffness = (np.column_stack(pair).ravel() for pair in ((z[:-1], z[:-1] + half), (at[:-1], middle)))
    x, slope = np.repeat(half, 2), np.append(np.diff(stiffness), 0.0) / np.repeat(half, 2)
    starts = np.column_stack([t[:-1], t[:-1] + half * (at[:-1] + middle) / 2]).ravel()
    energy = np.append(0.0, np.cumsum(x * (starts + x * (stiffness / 2 + slope * x / 6)))[:-1])
    return TorsionCurve(edge, starts, stiffness, slope, energy)


class Springs:
    """Parameters of the springs of a robot, K (n, n) [N m/rad].

    curves: CubicCurve or TorsionCurve of each joint; none: straight springs. added (n,) [N m/rad^3]: cubic stiffness
    beside the curves, None for none.
    """

    K: Any
    curves: Any
    added: Any = None


def torque(robot: Springs, zeta: ca.SX) -> ca.SX:
    """Return the joint torque phi(zeta) (n,) [N m]."""
    found = _of_joints(robot, "phi", zeta) if robot.curves else robot.K @ zeta
    return found if robot.added is None else found + robot.added * zeta**3


def energy(robot: Springs, zeta: ca.SX) -> ca.SX:
    """Return the energy of the springs [J] at a deflection (n,)."""
    stored = ca.sum1(_of_joints(robot, "stored", zeta)) if robot.curves else ca.dot(zeta, robot.K @ zeta) / 2
    return stored if robot.added is None else stored + ca.dot(robot.added, zeta**4) / 4


def deflection(robot: Springs, tau: ca.SX) -> ca.SX:
    """Return phi^-1(tau) (n, ..) [rad] for torques (n, ..) [N m] of springs with numeric parameters."""
    return _of_joints(robot, "inverse", tau) if robot.curves else np.linalg.inv(robot.K) @ tau


def secant(robot: Springs, a: ca.SX, b: ca.SX) -> Any:
    """Return S (n, n) [N m/rad] with phi(a) - phi(b) = S (a - b); it is K for straight springs."""
    return ca.diag(_of_joints(robot, "secant", a, b)) if robot.curves else robot.K


def compliance(robot: Springs, zeta: ca.SX) -> Any:
    """Return phi'(zeta)^-1 (n, n) [rad/(N m)] of springs with numeric parameters."""
    return ca.diag(1 / _of_joints(robot, "tangent", zeta)) if robot.curves else np.linalg.inv(robot.K)


def torques(robot: Springs, zeta: Array) -> Array:
    """Return phi (k, n) [N m] at deflections (k, n) of springs with numeric parameters."""
    return _along(robot, "phi", zeta) if robot.curves else np.asarray(zeta @ robot.K)


def hardening(robot: Springs, zeta: Array) -> Array:
    """Return the tangents phi' over K (k, n) at deflections (k, n) of springs with numeric parameters."""
    return _along(robot, "tangent", zeta) / np.diag(robot.K) if robot.curves else np.ones_like(zeta)


def root(K: float, cubic: float, tau: Any, f: Any = ca) -> Any:
    """Return the root zeta = 2 a sinh(asinh(3 tau / (2 K a)) / 3), a^2 = K / (3 k), of K zeta + cubic zeta^3 = tau.

    f: casadi or numpy.
    """
    if not cubic:
        return tau / K
    a = float(np.sqrt(K / 3) / np.sqrt(cubic))  # K / cubic may overflow
    return 2 * a * f.sinh(f.arcsinh(1.5 / (K * a) * tau) / 3)


def _of_joints(robot: Springs, name: str, *values: ca.SX) -> ca.SX:
    """Return a function of the curves (n, ..) at values (n, ..) of the joints."""
    each = zip(robot.curves, *map(ca.vertsplit, values), strict=True)
    return ca.vertcat(*(getattr(curve, name)(*at) for curve, *at in each))


def _along(robot: Springs, name: str, values: Array) -> Array:
    """Return a function of the curves (k, n) at numbers (k, n)."""
    return np.asarray(ca.evalf(_of_joints(robot, name, ca.DM(values.T))).full().T)
