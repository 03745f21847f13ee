# SPDX-License-Identifier: Apache-2.0
"""Define the gains of v-dPBC and check conditions (32) and (41)."""

from __future__ import annotations

from dataclasses import MISSING, dataclass, fields
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ..errors import GainsError
from ..numerics import checks
from ..numerics.checks import Array
from ..numerics.one_line import one_line
from ..numerics.parameter_field import MATRIX, parameter_field

if TYPE_CHECKING:
    from ..model.robot import Robot

_gain = partial(parameter_field, shape=MATRIX, constraint="symmetric positive definite", dynamic=True)
FASTEST_RATE = 0.5  # 1/sample, largest eigenvalue of M_m^-1 (K_md + D_m)


@dataclass(frozen=True, eq=False)
class Gains:
    """Gains of v-dPBC for links (_l) and motors (_m): phi = Lambda qt + Gamma qt^3 (componentwise), Pi and K_d.

    Lambda [1/s], metric Pi [N m/rad], injected damping K_ld and K_md [N m s/rad], Gamma [1/(s rad^2)]; each a
    scalar, a vector (n,) (diagonal) or a matrix (n, n).
    """

    Lambda_l: ArrayLike = _gain(
        MISSING,
        "Linear part of phi_l, eq. (31)",
        "1/s",
        constraint="condition (32): Pi_l Lambda_l + Lambda_l' Pi_l positive definite",
    )
    Pi_l: ArrayLike = _gain(MISSING, "Position metric of the links, eq. (32)", "N m/rad")
    K_ld: ArrayLike = _gain(MISSING, "Damping injected at the links, eq. (33)", "N m s/rad")
    Lambda_m: ArrayLike = _gain(
        MISSING,
        "Linear part of phi_m, eq. (40)",
        "1/s",
        constraint="condition (41): Pi_m Lambda_m + Lambda_m' Pi_m positive definite",
    )
    Pi_m: ArrayLike = _gain(MISSING, "Position metric of the motors, eq. (41)", "N m/rad")
    K_md: ArrayLike = _gain(MISSING, "Damping injected at the motors, eq. (42)", "N m s/rad")
    Gamma_l: ArrayLike = _gain(
        0.0, "Cubic part of phi_l", "1/(s rad^2)", constraint="condition (32): Pi_l Gamma_l diagonal and nonnegative"
    )
    Gamma_m: ArrayLike = _gain(
        0.0, "Cubic part of phi_m", "1/(s rad^2)", constraint="condition (41): Pi_m Gamma_m diagonal and nonnegative"
    )

    __repr__ = one_line

    def checked(self, n: int) -> CheckedGains:
        """Return the gains as matrices (n, n) for n joints.

        Raises GainsError for a wrong shape, a non-finite entry, Pi or K_d that is not symmetric positive definite,
        or a violation of condition (32) or (41).
        """
        arrays = {f.name: checks.matrix(f.name, getattr(self, f.name), n, GainsError) for f in fields(Gains)}
        for name in ("Pi_l", "K_ld", "Pi_m", "K_md"):
            arrays[name] = checks.positive_definite(name, arrays[name], GainsError)
        for array in arrays.values():
            array.setflags(write=False)
        return CheckedGains(
            **arrays,
            beta_l=_position_rate("l", arrays["Lambda_l"], arrays["Gamma_l"], arrays["Pi_l"]),
            beta_m=_position_rate("m", arrays["Lambda_m"], arrays["Gamma_m"], arrays["Pi_m"]),
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class CheckedGains(Gains):
    """Gains as (n, n) matrices that satisfy (32) and (41), with the resulting rates beta_l and beta_m [1/s]."""

    Lambda_l: Array
    Pi_l: Array
    K_ld: Array
    Lambda_m: Array
    Pi_m: Array
    K_md: Array
    Gamma_l: Array
    Gamma_m: Array
    beta_l: float
    beta_m: float

    __repr__ = one_line

    def arrays(self, _robot: Robot | None = None) -> dict[str, Array]:
        """Return the arrays of the law's equations by name: the matrices and the inverse of Pi_m."""
        matrices = {each.name: getattr(self, each.name) for each in fields(Gains)}
        return {**matrices, "Pi_m_inverse": np.linalg.inv(self.Pi_m)}


PAPER_GAINS = Gains(Lambda_l=10.0, Pi_l=20.0, K_ld=0.6, Lambda_m=15.0, Pi_m=60.0, K_md=0.3)
"""Gains of Table 1 (Pi_l = 2 Lambda_l, Pi_m = 4 Lambda_m)."""


def _position_rate(side: str, Lambda: Array, Gamma: Array, Pi: Array) -> float:
    """Return the largest beta with Pi dphi + dphi' Pi >= 2 beta Pi for every error: condition (32), (41).

    dphi = Lambda + 3 Gamma diag(qt^2). The cubic part must be nonnegative for every qt: sym(Pi Gamma e_i e_i') >= 0
    for every i holds if and only if Pi Gamma is diagonal and nonnegative. It vanishes at qt = 0, so beta is
    that of the linear part.
    """
    equation = {"l": "(32)", "m": "(41)"}[side]
    product = Pi @ Gamma
    off_diagonal = product - np.diag(np.diag(product))
    if np.max(np.abs(off_diagonal)) > 1e-12 * np.max(np.abs(product)) or np.min(np.diag(product)) < 0:
        raise GainsError(
            f"Pi_{side} Gamma_{side} is {product.tolist()}; condition {equation} needs it diagonal and nonnegative"
        )
    linear = Pi @ Lambda
    beta = float(relative_eigenvalues((linear + linear.T) / 2, Pi)[0])
    if not beta > 0:
        raise GainsError(
            f"Lambda_{side} with this Pi_{side} gives beta_{side} = {beta:.3g} 1/s; condition {equation} needs "
            f"Pi_{side} Lambda_{side} + Lambda_{side}' Pi_{side} positive definite"
        )
    return beta


def critical_damping(M: Array, K: Array) -> Array:
    """Return the damping D (n, n) [N m s/rad] that makes every mode of M ddq + D dq + K q = 0 critically damped.

    D = 2 M^1/2 (M^-1/2 K M^-1/2)^1/2 M^1/2 for symmetric positive definite M [kg m^2] and K [N m/rad].
    """
    from scipy.linalg import sqrtm  # loaded on use: SciPy takes a third of a node's start-up

    root = np.real(sqrtm(M))
    inverse = np.linalg.inv(root)
    mean = root @ np.real(sqrtm(inverse @ K @ inverse)) @ root
    return np.asarray(mean + mean.T, dtype=float)


def relative_eigenvalues(A: Array, B: Array) -> Array:
    """Return the eigenvalues (n,) of A v = lambda B v in ascending order; A symmetric, B positive definite."""
    L_inverse = np.linalg.inv(np.linalg.cholesky(B))
    return np.asarray(np.linalg.eigvalsh(L_inverse @ A @ L_inverse.T), dtype=float)


def two_scale_gains(robot: Robot, q_0: Array, omega: float, zeta: float, sample_period: float = 1e-3) -> Gains:
    """Return gains for omega [rad/s] of the links at q_0 (n,) [rad] and zeta of the motors, as the baselines have.

        links   Lambda_l = omega    Pi_l = omega^2 M_l(q_0)    K_ld = omega M_l(q_0)
        motors  Lambda_m = omega    Pi_m = K                   K_md + D_m = zeta times the critical damping of (M_m, K)

    The motor errors oscillate at the elastic modes of (M_m, Pi_m), which are much faster than omega on a stiff arm.
    K_md = omega M_m would leave these modes almost undamped, and measurement noise would excite them. Their damping is
    therefore set by zeta, and bounded by the sample rate; sample_period [s]. Raises GainsError if D_m alone exceeds it.
    """
    M_l, damping = robot.M_l(q_0), zeta * critical_damping(robot.M_m, robot.K)
    fastest = float(relative_eigenvalues(damping, robot.M_m)[-1]) * sample_period
    K_md = damping * min(1.0, FASTEST_RATE / fastest) - robot.D_m
    if np.linalg.eigvalsh((K_md + K_md.T) / 2)[0] <= 0:
        raise GainsError(f"D_m damps the motors more than the damping ratio {zeta:g}; expected a larger ratio")
    return Gains(Lambda_l=omega, Pi_l=omega**2 * M_l, K_ld=omega * M_l, Lambda_m=omega, Pi_m=robot.K, K_md=K_md)
