# SPDX-License-Identifier: Apache-2.0
"""Motor PD with a friction observer: M. J. Kim, F. Beck, C. Ott, A. Albu-Schaeffer, "Model-free friction observers for
flexible joint robots with torque measurements", IEEE Trans. Robotics 35(6), 2019, arXiv 1907.00553.

A nominal motor without friction obeys the controller and the measured spring torque. The controller acts on its motion
theta_n, not on the measured one, so that it remains passive; the observer pulls the motor after the nominal one:

    M_m ddtheta_n + D_m dtheta_n = B_m u_c(theta_n, dtheta_n, t) - K (theta - q)                          (1)
    B_m u = B_m u_c + c,    c = M_m L ((dtheta_n - dtheta) + L_p (theta_n - theta))                       (2)

With d the torque that the motors lack, c = (L s + L L_p) / (s^2 + (M_m^-1 D_m + L) s + L L_p) d for every motion. A
constant d is compensated and leaves theta_n - theta = (M_m L L_p)^-1 d.

u_c is motor PD with feedforward (pd_gravity.py), for the PD with gravity of the paper. The equations are those of
(1, 2) in the form "PD" of an implementation by others for the Kinova Gen3 (gen3_compliant_controllers); D_m and
the feedforward are our addition. (1) is integrated under the effort that was sent, so that a limit does not drive
theta_n away.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array

from .baseline import ObservedBaseline, effort, rate
from .pd_gravity import PdFeedforward, PdGains

FASTER = 2.0  # ratio of the poles of the observer to those of the controller
FASTEST_OBSERVER = 0.3  # rad per sample


@dataclass(frozen=True, eq=False)
class FrictionObserverGains(PdGains):
    """Gains of PdGains, and L, L_p [1/s] of the observer, scalars."""

    L: ArrayLike
    L_p: ArrayLike

    def arrays(self, robot: Robot) -> dict[str, Array]:
        """Return K_p and K_d (n, n), L and L_p (1,); raise GainsError."""
        return {**super().arrays(robot), "L": rate("L", self.L), "L_p": rate("L_p", self.L_p)}

    @classmethod
    def standard(
        cls, robot: Robot, q_0: Array, omega: float, zeta: float, sample_period: float = 1e-3
    ) -> FrictionObserverGains:
        """Return PD gains with omega [rad/s] and zeta, assuming rigid joints, and both poles of c at FASTER omega."""
        pd, pole = PdGains.standard(robot, q_0, omega, zeta), min(FASTER * omega, FASTEST_OBSERVER / sample_period)
        return cls(pd.K_p, pd.K_d, L=2 * pole, L_p=pole / 2)


class FrictionObserver(PdFeedforward, ObservedBaseline):
    """Motor PD with feedforward and friction observer (Kim, Beck, Ott, Albu-Schaeffer 2019)."""

    observes = "the friction of the motors"

    @property
    def memory_sizes(self) -> dict[str, int]:  # type: ignore[override]
        """Nominal motor motion; spring torque and compensation at the last sample."""
        return dict.fromkeys(("theta_n", "dtheta_n", "spring", "compensation"), self.robot.n)

    def observe(
        self, kept: SimpleNamespace, s: SimpleNamespace, g: SimpleNamespace
    ) -> tuple[ca.SX, ca.SX, dict[str, ca.SX]]:
        """Return u (n,) [N m], V [J] at the nominal motion, and the next memory."""
        robot, n, started = self.robot, self.robot.n, s.dt > 0
        (q, theta), (dq, dtheta) = ca.vertsplit(s.position, n), ca.vertsplit(s.velocity, n)
        spring = robot.K @ (theta - q)
        controller = robot.B_m @ s.sent - kept.compensation
        torque = controller - (kept.spring + spring) / 2 - robot.D_m @ kept.dtheta_n
        ddtheta_n = np.linalg.inv(robot.M_m) @ torque  # (1)
        theta_n = ca.if_else(started, kept.theta_n + s.dt * kept.dtheta_n + s.dt**2 / 2 * ddtheta_n, theta)
        dtheta_n = ca.if_else(started, kept.dtheta_n + s.dt * ddtheta_n, dtheta)
        u_c, V = self.measured_expression(ca.vertcat(q, theta_n), ca.vertcat(dq, dtheta_n), s.jets, s.gains)
        compensation = robot.M_m @ (g.L * ((dtheta_n - dtheta) + g.L_p * (theta_n - theta)))  # (2)
        memory = {"theta_n": theta_n, "dtheta_n": dtheta_n, "spring": spring, "compensation": compensation}
        return u_c + effort(robot, compensation), V, memory
