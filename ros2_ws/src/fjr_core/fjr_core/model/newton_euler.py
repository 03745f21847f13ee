# SPDX-License-Identifier: Apache-2.0
"""Symbolic Newton-Euler recursion for serial chains: inertia, Coriolis product, gravity and energies of the links.

Body i rotates about, or slides along, the z axis of its own frame; its vectors are expressed in this frame. Velocities
and accelerations propagate outwards, forces (Luh, Walker, Paul 1980) and composite bodies (Walker, Orin 1982) inwards.
"""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ..errors import RobotError
from ..numerics import checks
from ..numerics.checks import Array
from ..numerics.symbolic import sparse
from .rigid_arm import ArmDynamics, Body, EndEffector, rotation_to, z_aligned


def serial_chain(
    bodies: Sequence[Body], gravity: ArrayLike = (0.0, 0.0, -9.81), order: Sequence[int] | None = None
) -> ArmDynamics:
    """Return the links of a serial chain from base to tip, derived once for equal chains; raise RobotError.

    gravity (3,) [m/s^2] in the base frame. order (n,): joint k of the result is joint order[k] of the chain.
    """
    g, chain = checks.vector("gravity", gravity, 3, RobotError), z_aligned(bodies)
    if not chain:
        raise RobotError("a chain without bodies; expected at least one")
    order = list(range(len(chain)) if order is None else order)
    if sorted(order) != list(range(len(chain))):
        raise RobotError(f"order is {order}; expected each of 0 to {len(chain) - 1} once")
    return _derived(pickle.dumps((chain, order, rotation_to(np.asarray(bodies[-1].axis)), g)))


@lru_cache(maxsize=8)  # plant and controller have the same links, and so have variants of a scenario
def _derived(content: bytes) -> ArmDynamics:
    """Return the links; content: pickled bodies, order, rotation of the last body to its aligned frame, gravity."""
    bodies, order, turn, gravity = pickle.loads(content)
    n = len(bodies)
    named = [ca.SX.sym(name, n) for name in ("q_l", "v", "w", "a")]
    q, v, w, a = (vector[[order.index(i) for i in range(n)]] for vector in named)  # along the chain
    chain = ChainAt(bodies, [mass_of(body) for body in bodies], gravity, q)
    r = ca.SX.sym("r", 3)  # in the frame of the last body, before its axis was aligned
    point = sparse(turn.T) @ r
    for frame in reversed(chain.frames):
        point = frame.r + frame.R @ point
    return ArmDynamics(
        n=n,
        M_l=ca.Function("M_l", named[:1], [chain.inertia()[order, order]]),
        P_l=ca.Function("P_l", named[:1], [chain.potential_energy()]),
        grad_P_l=ca.Function("grad_P_l", named[:1], [chain.gravity_torque()[order]]),
        inertial_torque=ca.Function("inertial_torque", named, [chain.inertial_torque(v, w, a)[order]]),
        grad_T=ca.Function("grad_T", named[:2], [chain.kinetic_gradient(v)[order]]),
        end_effector=EndEffector(ca.Function("position", [named[0], r], [point]), gravity),
        bodies=tuple(bodies),
        order=tuple(order),
    )


@dataclass(frozen=True)
class Frame:
    """Pose of a body frame in its parent frame: rotation R, which turns vectors into the parent frame, and origin r."""

    R: ca.SX
    r: ca.SX


@dataclass(frozen=True)
class Mass:
    """Mass m, first moment h = sum m r and second moment J = sum m r r' (pseudo-inertia) about the frame origin."""

    m: float | ca.SX
    h: ca.SX
    J: ca.SX

    @property
    def I(self) -> ca.SX:  # noqa: E743 - the usual symbol
        """Return the inertia about the frame origin."""
        return ca.trace(self.J) * ca.SX.eye(3) - self.J

    def in_parent(self, frame: Frame) -> Mass:
        """Return the moments about the parent origin, in the parent frame."""
        h, r = frame.R @ self.h, frame.r
        J = frame.R @ self.J @ frame.R.T + r @ h.T + h @ r.T + self.m * r @ r.T
        return Mass(self.m, h + self.m * r, J)

    def __add__(self, other: Mass) -> Mass:
        return Mass(self.m + other.m, self.h + other.h, self.J + other.J)


def pseudo_inertia(body: Body) -> Array:
    """Return the pseudo-inertia (4, 4) of a body: second moments, first moment and mass about its frame's origin."""
    com, inertia = np.asarray(body.com), np.asarray(body.inertia)
    P = np.empty((4, 4))
    P[:3, :3] = np.trace(inertia) / 2 * np.eye(3) - inertia + body.mass * np.outer(com, com)
    P[:3, 3] = P[3, :3] = body.mass * com
    P[3, 3] = body.mass
    return P


def mass_of(body: Body) -> Mass:
    """Return the moments of a body about the origin of its frame."""
    P = pseudo_inertia(body)
    return Mass(body.mass, ca.SX(P[:3, 3]), ca.SX((P[:3, :3] + P[:3, :3].T) / 2))


def frame_of(body: Body, q: ca.SX) -> Frame:
    """Return the pose of the frame of a body, whose joint axis is z, at the position q of the joint."""
    rotation, translation = np.asarray(body.rotation), ca.SX(np.asarray(body.translation))
    if body.prismatic:
        return Frame(sparse(rotation), translation + sparse(rotation[:, 2]) * q)
    s, c = ca.sin(q), ca.cos(q)
    turn = ca.vertcat(ca.horzcat(c, -s, 0), ca.horzcat(s, c, 0), ca.horzcat(0, 0, 1))
    return Frame(sparse(rotation) @ turn, translation)


@dataclass(frozen=True)
class ChainAt:
    """A serial chain at joint positions q (n,): its bodies with the moments of each, gravity (3,) in the base frame."""

    bodies: Sequence[Body]
    masses: Sequence[Mass]
    gravity: Array
    q: ca.SX

    @cached_property
    def frames(self) -> list[Frame]:
        """Frame of each body in that of the body before."""
        return [frame_of(body, self.q[i]) for i, body in enumerate(self.bodies)]

    @cached_property
    def composites(self) -> list[Mass]:
        """Composite bodies: body i with all outer bodies, in the frame of body i."""
        composites = list(self.masses)
        for i in reversed(range(1, len(composites))):
            composites[i - 1] += composites[i].in_parent(self.frames[i])
        return composites

    def inertia(self) -> ca.SX:
        """Return M_l by columns: the wrench for unit acceleration of composite i, projected onto each joint."""
        chain, frames = self.bodies, self.frames
        M = ca.SX.zeros(len(chain), len(chain))
        for i, (body, composite) in enumerate(zip(chain, self.composites, strict=True)):
            h, J = composite.h, composite.J
            if body.prismatic:
                force, moment = ca.vertcat(0, 0, composite.m), ca.vertcat(h[1], -h[0], 0)
            else:
                force, moment = ca.vertcat(-h[1], h[0], 0), ca.vertcat(-J[0, 2], -J[1, 2], J[0, 0] + J[1, 1])
            for j in reversed(range(i + 1)):
                M[i, j] = M[j, i] = (force if chain[j].prismatic else moment)[2]
                force, moment = _in_parent(frames[j], force, moment)
        return M

    def potential_energy(self) -> ca.SX:
        """Return P_l = -g' h of the whole arm, zero at the base origin."""
        return -ca.dot(ca.DM(self.gravity), self.composites[0].in_parent(self.frames[0]).h)

    def gravity_torque(self) -> ca.SX:
        """Return grad P_l: minus the moment of the composite weight about joint i, or minus the weight along it."""
        torques, gravity = [], ca.SX(self.gravity)
        for body, frame, composite in zip(self.bodies, self.frames, self.composites, strict=True):
            gravity = frame.R.T @ gravity
            torques.append(-(composite.m * gravity if body.prismatic else ca.cross(composite.h, gravity))[2])
        return ca.vertcat(*torques)

    def inertial_torque(self, v: ca.SX, w: ca.SX, dw: ca.SX) -> ca.SX:
        """Return M_l dw + C(q, v) w with the Christoffel symbols, in one recursion.

        C(q, v) w is the polar form of c(q, v) = C(q, v) v: every product of two velocities is the mean of both orders.
        A point r of a body has the acceleration a + U r.
        """
        omega_v = omega_w = a = alpha = ca.SX.zeros(3)
        U = ca.SX.zeros(3, 3)
        wrenches = []
        for i, (body, mass, frame) in enumerate(zip(self.bodies, self.masses, self.frames, strict=True)):
            a = frame.R.T @ (a + U @ frame.r)
            omega_v, omega_w, alpha = (frame.R.T @ vector for vector in (omega_v, omega_w, alpha))
            cross = (_cross_z(omega_v) * w[i] + _cross_z(omega_w) * v[i]) / 2
            if body.prismatic:
                a += 2 * cross + _along_z(dw[i])
            else:
                alpha += cross + _along_z(dw[i])
                omega_v, omega_w = omega_v + _along_z(v[i]), omega_w + _along_z(w[i])
            products = (omega_v @ omega_w.T + omega_w @ omega_v.T) / 2
            U = ca.skew(alpha) + (products - ca.trace(products) * ca.SX.eye(3))
            UJ = U @ mass.J  # sum m r x U r is the axial vector of U J, as J = sum m r r'
            moment = ca.vertcat(UJ[2, 1] - UJ[1, 2], UJ[0, 2] - UJ[2, 0], UJ[1, 0] - UJ[0, 1])
            wrenches.append((mass.m * a + U @ mass.h, moment + ca.cross(mass.h, a)))
        torques = []
        force = moment = ca.SX.zeros(3)
        for i in reversed(range(len(wrenches))):
            force, moment = force + wrenches[i][0], moment + wrenches[i][1]
            torques.append((force if self.bodies[i].prismatic else moment)[2])
            force, moment = _in_parent(self.frames[i], force, moment)
        return ca.vertcat(*reversed(torques))

    def kinetic_gradient(self, v: ca.SX) -> ca.SX:
        """Return d/dq (v' M_l v / 2), v constant: composite momenta times the derivative of their velocities by q_i."""
        omega = velocity = ca.SX.zeros(3)
        motions, momenta = [], []
        for i, (body, mass, frame) in enumerate(zip(self.bodies, self.masses, self.frames, strict=True)):
            velocity = frame.R.T @ (velocity + ca.cross(omega, frame.r))
            omega = frame.R.T @ omega
            if body.prismatic:
                velocity += _along_z(v[i])
            else:
                omega += _along_z(v[i])
            motions.append((velocity, omega))
            momenta.append((mass.m * velocity + ca.cross(omega, mass.h), mass.I @ omega + ca.cross(mass.h, velocity)))
        gradient = []
        linear = angular = ca.SX.zeros(3)
        for i in reversed(range(len(momenta))):
            linear, angular = linear + momenta[i][0], angular + momenta[i][1]
            velocity, omega = motions[i]
            if self.bodies[i].prismatic:
                gradient.append(ca.dot(linear, _cross_z(omega)))
            else:
                gradient.append(ca.dot(angular, _cross_z(omega)) + ca.dot(linear, _cross_z(velocity)))
            linear, angular = _in_parent(self.frames[i], linear, angular)
        return ca.vertcat(*reversed(gradient))


def _in_parent(frame: Frame, force: ca.SX, moment: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return a force and its moment, or a momentum and its moment, about the parent origin in the parent frame."""
    force = frame.R @ force
    return force, frame.R @ moment + ca.cross(frame.r, force)


def _along_z(value: ca.SX) -> ca.SX:
    return ca.vertcat(0, 0, value)


def _cross_z(vector: ca.SX) -> ca.SX:
    """Return vector x z."""
    return ca.vertcat(vector[1], -vector[0], 0)
