# SPDX-License-Identifier: Apache-2.0
"""The effort of a stop: zero, or gravity compensation with damped motors (parameter on_stop)."""

from __future__ import annotations

import casadi as ca
import numpy as np

from fjr_core.control.safety_settings import GRAVITY_HOLD, Settings
from fjr_core.control.static_law import StaticLaw
from fjr_core.numerics.casadi_function import numeric
from fjr_core.numerics.checks import Array


class StopPolicy:
    """Efforts (n,) [N m] while the law does not act.

    zero: u = 0. gravity_hold: u = B_m^-1 (grad P_l(q_l) - K_md dq_m) with a sample, B_m^-1 grad P_l(q_l) without.
    released: u = 0 under either policy. It is set after a wiring fault, where gravity compensation would drive the arm.
    """

    def __init__(self, law: StaticLaw, settings: Settings) -> None:
        q_l = ca.SX.sym("q_l", law.robot.n)
        self._grad_P_l = numeric("grad_P_l", {"q_l": q_l}, {"grad_P_l": law.robot.links.grad_P_l(q_l)})
        self._q_l = np.zeros(law.robot.n)
        self._known = self.released = False
        self.apply(law, settings)

    def apply(self, law: StaticLaw, settings: Settings) -> None:
        """Replace the law, which gives B_m and K_md, and the settings."""
        self._holds = settings.on_stop == GRAVITY_HOLD
        self._B_inv, self._K_md = np.linalg.inv(law.robot.B_m), law.hold_damping

    def remember(self, q_l: Array) -> None:
        """Keep the link positions (n,) [rad] of the last valid sample."""
        np.copyto(self._q_l, q_l)
        self._known = True

    def moving(self, q_l: Array, dq_m: Array) -> Array:
        """Return the effort (n,) for the sample q_l [rad], dq_m [rad/s], always finite."""
        if self.released or not self._holds:
            return np.zeros(len(q_l))
        u = self._B_inv @ (self._grad_P_l(q_l)[0] - self._K_md @ dq_m)
        return u if u.dot(u) < np.inf else self.standing()

    def standing(self) -> Array:
        """Return the effort (n,) at the last valid link positions, always finite; zeros before the first sample."""
        return self.at(self._q_l) if self._known else np.zeros(len(self._q_l))

    def at(self, q_l: Array) -> Array:
        """Return the effort (n,) for a robot that stands still at q_l (n,) [rad]."""
        holds = self._holds and not self.released
        return self._B_inv @ self._grad_P_l(q_l)[0] if holds else np.zeros(len(q_l))
