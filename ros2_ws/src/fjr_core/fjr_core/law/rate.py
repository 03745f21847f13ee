# SPDX-License-Identifier: Apache-2.0
"""Compute the convergence rate beta of V: per error block, and by eq. (50)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ..model.configuration_sampling import RATE_CONFIGURATIONS, checked_configurations
from ..model.robot import Robot
from ..numerics.checks import Array
from ..numerics.intervals import Interval, least_eigenvalue, product
from ..numerics.one_line import one_line
from .gains import CheckedGains, relative_eigenvalues

ROUNDING = 1e-9
"""Relative margin of a proven rate for the rounding of the damping matrices and of rotations (orthogonal to 1e-14)."""


@dataclass(frozen=True)
class Rate:
    """Rates [1/s]: V(t) <= V(0) exp(-2 beta t) in continuous time with omega = 0.

    beta = min(beta_l, beta_m, beta_sigma_l, beta_sigma_m). beta_paper is eq. (50); it never exceeds beta.
    proven: the rates hold for every q_l of the domain, by default all positions. Otherwise beta and beta_paper are
    minima over the sampled configurations, and the true rates may be smaller.
    attained: for rates proven by branch and bound, the rate at one configuration, which no proof can exceed.
    """

    beta: float
    beta_paper: float
    beta_l: float
    beta_m: float
    beta_sigma_l: float
    beta_sigma_m: float
    proven: bool
    attained: float | None = None

    __repr__ = one_line


NO_RATE = Rate(*(float("nan"),) * 6, proven=False)
"""Rate of a law without a proven or sampled rate."""


def rate(robot: Robot, gains: CheckedGains, configurations: ArrayLike | None = None) -> Rate:
    """Return the rates of the law from the vertices of M_l if known, else from configurations (k, n) [rad]."""
    proven = configurations is None and robot.links.M_l_vertices is not None
    samples = () if proven else checked_configurations(robot, configurations, RATE_CONFIGURATIONS)
    inertias = [robot.M_l(q_l) for q_l in samples] or list(robot.links.M_l_vertices or ())
    damping_l = robot.D_l + gains.K_ld
    beta_sigma_l = min(_least(damping_l, M_l, proven) for M_l in inertias)
    return _of_blocks(robot, gains, beta_sigma_l, max(float(np.linalg.eigvalsh(M)[-1]) for M in inertias), proven)


def rate_from_inertia_bounds(robot: Robot, gains: CheckedGains, bound: float, attained: float, largest: float) -> Rate:
    """Return the rates that are proven by M_l <= bound (D_l + K_ld) and M_l <= largest I.

    attained: the value of the first bound at one configuration.
    """
    found = _of_blocks(robot, gains, (1 - ROUNDING) / bound, largest, True)
    others = min(found.beta_l, found.beta_m, found.beta_sigma_m)
    return replace(found, attained=min(others, 1 / attained))


def _of_blocks(robot: Robot, gains: CheckedGains, beta_sigma_l: float, largest_inertia: float, proven: bool) -> Rate:
    damping_l, damping_m = robot.D_l + gains.K_ld, robot.D_m + gains.K_md
    beta_sigma_m, beta_l, beta_m = _least(damping_m, robot.M_m, proven), gains.beta_l, gains.beta_m
    if proven:
        beta_l = _safe(beta_l, _position_block(gains.Pi_l, gains.Lambda_l), gains.Pi_l)
        beta_m = _safe(beta_m, _position_block(gains.Pi_m, gains.Lambda_m), gains.Pi_m)
    smallest_damping = min(float(np.linalg.eigvalsh(damping)[0]) for damping in (damping_l, damping_m))
    largest_inertia = max(largest_inertia, float(np.linalg.eigvalsh(robot.M_m)[-1]))
    beta = min(beta_l, beta_m, beta_sigma_l, beta_sigma_m)
    return Rate(
        beta=beta,
        beta_paper=min(beta, smallest_damping / largest_inertia),
        beta_l=beta_l,
        beta_m=beta_m,
        beta_sigma_l=beta_sigma_l,
        beta_sigma_m=beta_sigma_m,
        proven=proven,
    )


def _least(damping: Array, M: Array, proven: bool) -> float:
    """Return the largest rate with damping >= rate M; proven: a safe one."""
    rate = float(relative_eigenvalues(damping, M)[0])
    return _safe(rate, Interval.exact(damping), M) if proven else rate


def _position_block(Pi: Array, Lambda: Array) -> Interval:
    """Return sym(Pi Lambda), the matrix of conditions (32) and (41)."""
    twice = product(Interval.exact(Pi), Interval.exact(Lambda))
    return (twice + Interval(twice.mid.T, twice.rad.T)) * Interval.exact(0.5)


def _safe(rate: float, A: Interval, B: Array) -> float:
    """Return a rate in floating point if A >= rate B is proven up to ROUNDING, else the lower one that is proven."""
    proven = least_eigenvalue(A, Interval.exact(B))
    return rate if proven >= (1 - ROUNDING) * rate else max(proven, 0.0)
