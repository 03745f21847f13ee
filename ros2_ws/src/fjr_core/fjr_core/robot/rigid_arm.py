# SPDX-License-Identifier: Apache-2.0
"""The rigid arm on the link side, symbolically: inertia, potential, and what follows from the two."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import casadi as ca

from ..numerics.checks import Array
from ..numerics.symbolic import directional


class RigidArm(Protocol):
    """What eq. (36) needs of the link side, on expressions: Links, or Links with a payload (payload.Loaded)."""

    def M_l(self, q_l: ca.SX) -> ca.SX:
        """Inertia (n, n) [kg m^2]."""

    def P_l(self, q_l: ca.SX) -> ca.SX:
        """Potential energy [J]."""

    def grad_P_l(self, q_l: ca.SX) -> ca.SX:
        """Its gradient (n,) [N m]."""

    def grad_T(self, q_l: ca.SX, v: ca.SX) -> ca.SX:
        """d/dq_l (v' M_l v / 2) (n,), v held."""


class Carrier(RigidArm, Protocol):
    """A rigid arm that may have a hand, which a payload can be put in."""

    @property
    def n(self) -> int:
        """Number of joints."""

    @property
    def hand(self) -> Hand | None:
        """Where a payload can be; None: nowhere."""


@dataclass(frozen=True)
class Hand:
    """Where a point of the last link is.

    position: (q_l, r) -> (3,) [m] in the base's frame of the point at r (3,) in the last link's frame.
    gravity (3,) [m/s^2]: in the base's frame.
    """

    position: ca.Function
    gravity: Array


@dataclass(frozen=True)
class Links:
    """A rigid arm of n joints; the fields are CasADi functions that take symbols or numbers.

    M_l: q_l -> inertia (n, n) [kg m^2];  P_l: q_l -> potential energy [J];  grad_P_l: q_l -> (n,) [N m].
    C: (q_l, v, w) -> C(q_l, v) w (n,), with the Christoffel symbols, so that dM_l - 2 C is skew.
    grad_T: (q_l, v) -> d/dq_l (v' M_l v / 2) (n,), v held.
    M_l_vertices: matrices whose convex hull holds M_l(q_l) for every q_l, where they are known: what
    is proven at the vertices is proven everywhere (rates are convex in M_l). None: not known.
    hand: where a payload can be; None: an arm that cannot carry one.
    """

    n: int
    M_l: ca.Function
    P_l: ca.Function
    grad_P_l: ca.Function
    C: ca.Function
    grad_T: ca.Function
    M_l_vertices: tuple[Array, ...] | None = None
    hand: Hand | None = None

    @cached_property
    def dM(self) -> ca.Function:
        """(q_l, dq_l, w) -> (d/dt M_l) w (n,) along dq_l, w held."""
        q_l, dq_l, w = (ca.SX.sym(name, self.n) for name in ("q_l", "dq_l", "w"))
        return ca.Function("dM", [q_l, dq_l, w], [directional(self.M_l(q_l) @ w, q_l, dq_l)])

    def E(self, q_l: ca.SX, dq_l: ca.SX, w: ca.SX) -> ca.SX:
        """Workless forces E_l w (n,), eq. (24): E_l = S_H - dM_l/2 = -C' = C - dM_l."""
        return self.C(q_l, dq_l, w) - self.dM(q_l, dq_l, w)


def closed_form(
    n: int,
    inertia: Callable[[ca.SX], ca.SX],
    potential: Callable[[ca.SX], ca.SX],
    vertices: tuple[Array, ...] | None = None,
    hand: Hand | None = None,
) -> Links:
    """Links of n joints from M_l(q_l) and P_l(q_l) as expressions; the rest by differentiation.

    C_ij = sum_k (dM_ij/dq_k + dM_ik/dq_j - dM_jk/dq_i) v_k / 2  (Christoffel symbols of the first kind).
    """
    q_l, v, w = (ca.SX.sym(name, n) for name in ("q_l", "v", "w"))
    M_l, P_l = inertia(q_l), potential(q_l)
    dM_w, dM_v = directional(M_l @ w, q_l, v), directional(M_l @ v, q_l, w)
    C_w = (dM_w + dM_v - ca.gradient(ca.dot(v, M_l @ w), q_l)) / 2
    return Links(
        n=n,
        M_l=ca.Function("M_l", [q_l], [ca.densify(M_l)]),
        P_l=ca.Function("P_l", [q_l], [P_l]),
        grad_P_l=ca.Function("grad_P_l", [q_l], [ca.gradient(P_l, q_l)]),
        C=ca.Function("C", [q_l, v, w], [C_w]),
        grad_T=ca.Function("grad_T", [q_l, v], [ca.gradient(ca.dot(v, M_l @ v) / 2, q_l)]),
        M_l_vertices=vertices,
        hand=hand,
    )
