# SPDX-License-Identifier: Apache-2.0
"""Online gravity compensation from motor positions: C. Ott, A. Albu-Schaeffer, A. Kugi, S. Stramigioli, G. Hirzinger,
"A passivity based Cartesian impedance controller for flexible joint robots, part I", ICRA 2004.

q_bar(theta) is the link equilibrium with the motors held at theta: K (theta - q_bar) = grad P_l(q_bar). It is the fixed
point of q -> theta - K^-1 grad P_l(q), which is a contraction if the joint stiffness outweighs gravity.
"""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

from fjr_core.errors import GainsError
from fjr_core.model.robot import Robot

from .set_point_storage import gravity_hessians

MOST_ITERATIONS = 400
ROUNDING = 2.0**-53


@lru_cache(maxsize=8)
def link_equilibrium(robot: Robot) -> ca.Function:
    """Return the CasADi function theta (n,) -> q_bar (n,) [rad]; raise GainsError without a contraction."""
    theta, K_inverse = ca.SX.sym("theta", robot.n), ca.sparsify(ca.DM(np.linalg.inv(robot.K)))
    q = theta
    for _ in range(_iterations(robot)):
        q = theta - K_inverse @ robot.links.grad_P_l(q)
    return ca.Function("link_equilibrium", [theta], [ca.densify(q)], {"cse": True})


def contraction_factor(robot: Robot) -> float:
    """Return the contraction factor of the iteration in the metric K, the maximum over sampled configurations."""
    half = np.linalg.inv(np.linalg.cholesky(robot.K))
    return float(np.abs(np.linalg.eigvalsh(half @ gravity_hessians(robot) @ half.T)).max())


def _iterations(robot: Robot) -> int:
    """Return the number of steps after which the error is at rounding level."""
    factor = contraction_factor(robot)
    steps = 2 + np.log(ROUNDING) / np.log(factor) if 0 < factor < 1 else 2.0 if factor == 0 else np.inf
    if not steps <= MOST_ITERATIONS:
        raise GainsError(
            f"the joints' stiffness does not outweigh gravity: a change of the link position changes the deflection by "
            f"a factor of {factor:.4g}; expected at most {ROUNDING ** (1 / (MOST_ITERATIONS - 2)):.2g}, else gravity "
            "cannot be computed from the motor positions"
        )
    return int(np.ceil(steps))
