# SPDX-License-Identifier: Apache-2.0
"""Compute gains of v-dPBC from a natural frequency and a damping ratio, for comparison with the baselines.

    links   Lambda_l = omega    Pi_l = omega^2 M_l(q_0)    K_ld = omega M_l(q_0)
    motors  Lambda_m = omega    Pi_m = K                   K_md + D_m = zeta times the critical damping of (M_m, K)

The motor errors oscillate at the elastic modes of (M_m, Pi_m), which are much faster than omega on a stiff arm.
K_md = omega M_m would leave these modes almost undamped, and measurement noise would excite them. Their damping is
therefore set by zeta.
"""

from __future__ import annotations

from ...model.robot import Robot
from ...numerics.checks import Array
from .gains import Gains, critical_damping, relative_eigenvalues

FASTEST_RATE = 0.5  # 1/sample, largest eigenvalue of M_m^-1 (K_md + D_m)


def standard(robot: Robot, q_0: Array, omega: float, zeta: float, sample_period: float = 1e-3) -> Gains:
    """Return gains for omega [rad/s] of the links at q_0 (n,) [rad] and zeta of the motors.

    The motor damping is bounded by the sample rate; sample_period [s].
    """
    M_l, damping = robot.M_l(q_0), zeta * critical_damping(robot.M_m, robot.K)
    fastest = float(relative_eigenvalues(damping, robot.M_m)[-1]) * sample_period
    return Gains(
        Lambda_l=omega,
        Pi_l=omega**2 * M_l,
        K_ld=omega * M_l,
        Lambda_m=omega,
        Pi_m=robot.K,
        K_md=damping * min(1.0, FASTEST_RATE / fastest) - robot.D_m,
    )
