# SPDX-License-Identifier: Apache-2.0
"""Full feedback linearisation: M. W. Spong, "Modeling and control of elastic joint robots", ASME J. Dynamic Systems,
Measurement and Control 109(4), 1987; A. De Luca, "Feedforward/feedback laws for the control of flexible robots", ICRA
2000.

    d4q = d4q_d - A_3 (d3q - d3q_d) - A_2 (ddq - ddq_d) - A_1 (dq - dq_d) - A_0 (q - q_d)

and u by the inverse dynamics (inverse.py) of that motion, with ddq and d3q of the links from the model. So the link
error obeys this linear equation exactly, and with z = (e, de, dde, d3e) and A' P + P A = -Q of its companion matrix A,
V = z' P z / 2 has dV/dt = -z' Q z / 2. Q = diag(1, w^-2, w^-4, w^-6), w^4n = det A_0.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_continuous_lyapunov

from .. import checks
from ..checks import Array
from ..errors import GainsError
from ..flow import Flow
from ..robot import Robot
from .baseline import Baseline, effort
from .inverse import motor_motion


@dataclass(frozen=True, eq=False)
class LinearErrorGains:
    """A_0 [1/s^4] .. A_3 [1/s] of the error's equation: scalars, (n,) or (n, n)."""

    A_0: ArrayLike
    A_1: ArrayLike
    A_2: ArrayLike
    A_3: ArrayLike

    def arrays(self, robot: Robot) -> dict[str, Array]:
        """A_0 .. A_3 (n, n) and P (4n, 4n); raises GainsError where the error would not decay."""
        arrays = {k: checks.matrix(k, getattr(self, k), robot.n, GainsError) for k in ("A_0", "A_1", "A_2", "A_3")}
        A = companion(*arrays.values())
        slowest = float(np.linalg.eigvals(A).real.max())
        if not slowest < 0:
            raise GainsError(f"A_0 .. A_3 give an error that grows as exp({slowest:.4g} t); expected one that decays")
        P = solve_continuous_lyapunov(A.T, -weight(arrays["A_0"]))
        return {**arrays, "P": (P + P.T) / 2}


class FeedbackLinearisation(Baseline):
    """The law of this module."""

    def expressions(self, f: Flow, g: SimpleNamespace) -> tuple[ca.SX, ca.SX]:
        """u and V."""
        m = f.measured
        (d3q,) = f.d(m.ddq_l)
        motion = [m.q_l, m.dq_l, m.ddq_l, d3q]
        errors = [q - f.jets[:, k] for k, q in enumerate(motion)]
        d4q = f.jets[:, 4] - sum(A @ e for A, e in zip((g.A_0, g.A_1, g.A_2, g.A_3), errors, strict=True))
        z = ca.vertcat(*errors)
        return effort(f.robot, motor_motion(f.robot, *motion, d4q).torque), ca.dot(z, g.P @ z) / 2

    @property
    def hold_damping(self) -> Array:
        """The motors' inertia times the mean of A_3."""
        return np.asarray(self.robot.M_m * np.trace(self.arrays["A_3"]) / self.robot.n)


def companion(A_0: Array, A_1: Array, A_2: Array, A_3: Array) -> Array:
    """A (4n, 4n) with dz = A z."""
    n = len(A_0)
    return np.vstack([np.eye(4 * n)[n:], -np.hstack([A_0, A_1, A_2, A_3])])


def weight(A_0: Array) -> Array:
    """Q (4n, 4n)."""
    w = abs(np.linalg.det(A_0)) ** (1 / (4 * len(A_0)))
    return np.kron(np.diag(w ** -np.array([0.0, 2.0, 4.0, 6.0])), np.eye(len(A_0)))


def standard(robot: Robot, q_0: Array, omega: float, zeta: float) -> LinearErrorGains:
    """(s^2 + 2 zeta omega s + omega^2)^2 for every joint."""
    _, A_3, A_2, A_1, A_0 = np.polymul(*([1.0, 2 * zeta * omega, omega**2],) * 2)
    return LinearErrorGains(A_0=A_0, A_1=A_1, A_2=A_2, A_3=A_3)
