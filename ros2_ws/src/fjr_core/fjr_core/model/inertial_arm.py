# SPDX-License-Identifier: Apache-2.0
"""A serial chain whose masses and inertias are expressions, so that they can be identified."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from ..numerics.checks import Array
from .newton_euler import (
    Frame,
    Mass,
    composite_masses,
    frame_of,
    gravity_torque,
    inertial_torque,
    joint_inertia,
    kinetic_gradient,
    potential_energy,
)
from .rigid_body import Body


@dataclass(frozen=True)
class InertialArm:
    """A rigid arm of bodies whose joint axes are z, with the pseudo-inertia (4, 4) of each as an expression.

    gravity (3,) [m/s^2] in the base frame. The pseudo-inertia is the integral of (r, 1)(r, 1)' dm about the origin of
    the body's frame; the masses, centres of mass and inertias of the bodies themselves do not count.
    """

    bodies: Sequence[Body]
    pseudo_inertias: Sequence[ca.SX]
    gravity: Array

    def M_l(self, q_l: ca.SX) -> ca.SX:
        """Inertia M_l (n, n) [kg m^2]."""
        frames = self._frames(q_l)
        return joint_inertia(self.bodies, frames, composite_masses(self._masses, frames))

    def P_l(self, q_l: ca.SX) -> ca.SX:
        """Potential energy P_l [J]."""
        frames = self._frames(q_l)
        return potential_energy(frames, composite_masses(self._masses, frames), ca.DM(self.gravity))

    def grad_P_l(self, q_l: ca.SX) -> ca.SX:
        """Gravity torque grad P_l (n,) [N m]."""
        frames = self._frames(q_l)
        return gravity_torque(self.bodies, frames, composite_masses(self._masses, frames), ca.DM(self.gravity))

    def grad_T(self, q_l: ca.SX, v: ca.SX) -> ca.SX:
        """d/dq_l (v' M_l v / 2) (n,) [N m], v constant."""
        return kinetic_gradient(self.bodies, self._masses, self._frames(q_l), v)

    def inertial_torque(self, q_l: ca.SX, v: ca.SX, w: ca.SX, a: ca.SX) -> ca.SX:
        """M_l a + C(q_l, v) w (n,) [N m]."""
        return inertial_torque(self.bodies, self._masses, self._frames(q_l), v, w, a)

    @property
    def _masses(self) -> list[Mass]:
        return [Mass(P[3, 3], P[:3, 3], P[:3, :3]) for P in self.pseudo_inertias]

    def _frames(self, q: ca.SX) -> list[Frame]:
        return [frame_of(body, q[i]) for i, body in enumerate(self.bodies)]


def pseudo_inertia(body: Body) -> Array:
    """Return the pseudo-inertia (4, 4) of a body: second moments, first moment and mass about its frame's origin."""
    com, inertia = np.asarray(body.com), np.asarray(body.inertia)
    P = np.empty((4, 4))
    P[:3, :3] = np.trace(inertia) / 2 * np.eye(3) - inertia + body.mass * np.outer(com, com)
    P[:3, 3] = P[3, :3] = body.mass * com
    P[3, 3] = body.mass
    return P
