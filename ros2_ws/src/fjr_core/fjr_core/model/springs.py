# SPDX-License-Identifier: Apache-2.0
"""Springs of the joints: the torque phi(zeta) = K zeta + k zeta^3 of a deflection zeta = q_m - q_l, and its inverse.

    energy    zeta' K zeta / 2 + sum k zeta^4 / 4
    tangent   phi'(zeta) = K + 3 k zeta^2
    secant    S(a, b) = K + k (a^2 + a b + b^2),   phi(a) - phi(b) = S(a, b) (a - b)
    inverse   zeta = 2 a sinh(asinh(3 tau / (2 K a)) / 3),   a^2 = K / (3 k)

A joint hardens for k > 0. Then phi is monotone and the inverse its only real root. K is diagonal where a joint has a
cubic stiffness k [N m/rad^3]. Straight springs (k = None) have the expressions of a matrix K.
"""

from __future__ import annotations

from typing import Any, Protocol

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ..errors import RobotError
from ..numerics import checks
from ..numerics.checks import Array


class Springs(Protocol):
    """What has springs: a robot, numeric or symbolic."""

    @property
    def K(self) -> Any:
        """Joint stiffness (n, n) [N m/rad], without deflection."""

    @property
    def cubic(self) -> Any:
        """Cubic stiffness k (n,) [N m/rad^3], or None for straight springs."""


def checked_cubic(value: ArrayLike, K: Array) -> Array | None:
    """Return the cubic stiffness (n,) of a robot, None if it is zero; raises RobotError."""
    cubic = checks.vector("cubic", value, len(K), RobotError)
    if np.any(cubic < 0):
        raise RobotError(f"cubic is {cubic.tolist()} N m/rad^3; expected 0 or more: a softening spring has no inverse")
    if not cubic.any():
        return None
    if np.any(K - np.diag(np.diag(K))):
        raise RobotError("cubic is not 0 with a matrix K that couples the joints; expected a diagonal K")
    cubic.setflags(write=False)
    return cubic


def torque(springs: Springs, zeta: ca.SX, added: ca.SX | None = None) -> ca.SX:
    """Return the joint torque phi(zeta) (n,) [N m]; added (n,) [N m/rad^3]: further cubic stiffness, of the plant."""
    found = springs.K @ zeta
    if springs.cubic is not None:
        found = found + _column(springs.cubic) * zeta * zeta * zeta
    return found if added is None else found + added * zeta**3


def energy(springs: Springs, zeta: ca.SX) -> ca.SX:
    """Return the energy of the springs [J] at a deflection (n,)."""
    found = ca.dot(zeta, springs.K @ zeta) / 2
    return found if springs.cubic is None else found + ca.dot(_column(springs.cubic), (zeta * zeta) ** 2) / 4


def deflection(springs: Springs, tau: ca.SX) -> ca.SX:
    """Return phi^-1(tau) (n, ..) [rad] for torques (n, ..) [N m] of springs with numeric parameters."""
    if springs.cubic is None:
        return np.linalg.inv(springs.K) @ tau
    return ca.vertcat(*map(root, np.diag(springs.K), springs.cubic, ca.vertsplit(tau)))


def root(K: float, cubic: float, tau: Any, f: Any = ca) -> Any:
    """Return the root zeta of K zeta + cubic zeta^3 = tau; f: casadi or numpy."""
    if not cubic:
        return tau / K
    a = float(np.sqrt(K / 3) / np.sqrt(cubic))  # K / cubic may overflow
    return 2 * a * f.sinh(f.arcsinh(1.5 / (K * a) * tau) / 3)


def secant(springs: Springs, a: ca.SX, b: ca.SX) -> Any:
    """Return S (n, n) [N m/rad] with phi(a) - phi(b) = S (a - b); it is K for straight springs."""
    if springs.cubic is None:
        return springs.K
    return ca.diag(ca.DM(np.diag(springs.K)) + ca.DM(springs.cubic) * (a * a + a * b + b * b))


def compliance(springs: Springs, zeta: ca.SX) -> Any:
    """Return phi'(zeta)^-1 (n, n) [rad/(N m)] of springs with numeric parameters."""
    if springs.cubic is None:
        return np.linalg.inv(springs.K)
    return ca.diag(1 / (ca.DM(np.diag(springs.K)) + ca.DM(3 * springs.cubic) * zeta * zeta))


def _column(cubic: Any) -> ca.SX | ca.DM:
    """Return the cubic stiffness as a column of CasADi."""
    return ca.DM(cubic) if isinstance(cubic, np.ndarray) else cubic
