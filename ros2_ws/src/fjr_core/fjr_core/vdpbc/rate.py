# SPDX-License-Identifier: Apache-2.0
"""The rate beta at which V decays: block by block, and as eq. (50) has it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import eigh
from scipy.stats import qmc

from .. import checks
from ..checks import Array
from ..errors import StateError
from ..gains import CheckedGains
from ..robot import Robot


@dataclass(frozen=True)
class Rate:
    """Rates [1/s]: V(t) <= V(0) exp(-2 beta t) in continuous time with omega = 0.

    beta = min(beta_l, beta_m, beta_sigma_l, beta_sigma_m); beta_paper is eq. (50), never larger.
    proven: M_l was covered for every q_l. Otherwise beta and beta_paper are the minimum over the
    sampled configurations, an upper estimate of the true ones.
    """

    beta: float
    beta_paper: float
    beta_l: float
    beta_m: float
    beta_sigma_l: float
    beta_sigma_m: float
    proven: bool


def rate(robot: Robot, gains: CheckedGains, configurations: ArrayLike | None = None) -> Rate:
    """Rates of the law, from the vertices of M_l where they are known, else from configurations (k, n) [rad]."""
    proven = configurations is None and robot.links.M_l_vertices is not None
    inertias = robot.links.M_l_vertices if proven else _sampled_inertias(robot, configurations)
    damping_l, damping_m = robot.D_l + gains.K_ld, robot.D_m + gains.K_md
    beta_sigma_l = min(_smallest(damping_l, M_l) for M_l in inertias or ())
    beta_sigma_m = _smallest(damping_m, robot.M_m)
    smallest_damping = min(_smallest(damping_l), _smallest(damping_m))
    largest_inertia = max(float(np.linalg.eigvalsh(M)[-1]) for M in (*(inertias or ()), robot.M_m))
    beta_q = min(gains.beta_l, gains.beta_m)
    return Rate(
        beta=min(beta_q, beta_sigma_l, beta_sigma_m),
        beta_paper=min(beta_q, smallest_damping / largest_inertia),
        beta_l=gains.beta_l,
        beta_m=gains.beta_m,
        beta_sigma_l=beta_sigma_l,
        beta_sigma_m=beta_sigma_m,
        proven=proven,
    )


def _smallest(A: Array, B: Array | None = None) -> float:
    """The smallest eigenvalue of symmetric A, relative to B where given."""
    return float(eigh(A, B, eigvals_only=True)[0])


def _sampled_inertias(robot: Robot, configurations: ArrayLike | None) -> tuple[Array, ...]:
    if configurations is None:
        configurations = np.pi * (2 * qmc.Halton(robot.n, scramble=False).random(512) - 1)
    samples = checks.finite("configurations", configurations, StateError)
    if samples.ndim != 2 or samples.shape[1] != robot.n or not len(samples):
        raise StateError(f"configurations has shape {samples.shape}; expected (k, {robot.n}) with k at least 1")
    return tuple(robot.M_l(q_l) for q_l in samples)
