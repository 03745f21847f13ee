# SPDX-License-Identifier: Apache-2.0
"""The arm whose parameters are identified: accelerations of links and motors, with their derivatives.

    M_l(q_l) dv_l + C(q_l, v_l) v_l + grad P_l(q_l) = tau - D_l v_l - F_l(v_l) - T(q_l),   tau = K (q_m - q_l - offset)
    B dv_m = u - tau - D_m v_m - F_m(v_m)

u is the torque of the motors. Springs that harden have tau = K zeta + k zeta^3 (cubic_stiffness). F_l and F_m are
Coulomb friction, with static friction and a share of |tau| if these are free. T is an optional torque of the position
of one joint.

The inertia of the links may be corrected. The pseudo-inertia P of a link stays positive definite, hence physically
consistent, with log-Cholesky parameters theta = (alpha, d1, d2, d3, s12, s23, s13, t1, t2, t3) about that of the robot
file, P_0, at theta = 0:

    P = L U U' L',  P_0 = L L',  U = e^alpha [[e^d1, s12, s13, t1], [0, e^d2, s23, t2], [0, 0, e^d3, t3], [0, 0, 0, 1]]

Gaussian theta are a prior that is free of units (C. Rucker, P. Wensing, IEEE RA-L 7(2), 2022).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np

from fjr_core.model.newton_euler import ChainAt, Mass, pseudo_inertia
from fjr_core.model.rigid_arm import ArmDynamics, Body
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array
from fjr_core.numerics.symbolic import PackedVector, dense_function, solve, sparse, symbols
from fjr_design.uncertainty.posterior import Identification

from .parameters import DYNAMIC, HARDENING, LOAD, OF_LINKS, PAYLOAD, POSITION_TORQUE, PSEUDO_INERTIA, STATIC, size

LEAST = 1e-9  # of the trace; eigenvalue that is added to a link without extension, so that it has a factor
ENTRIES = ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))  # of s12, s23, s13, t1, t2, t3 in U


@dataclass(frozen=True, eq=False)
class ElasticArm:
    """Equations of motion in (q_l, q_m, v_l, v_m) with symbolic parameters.

    free: (name, index) of the parameters with respect to which derivatives are taken. added_inertia [kg m^2]: of each
    link, for links so light that their resonance is too fast for the record; () for none.
    """

    robot: Robot
    free: tuple[tuple[str, int], ...]
    added_inertia: tuple[float, ...] = ()

    @cached_property
    def layout(self) -> PackedVector:
        """Return the parts of the parameters."""
        n = self.robot.n
        return PackedVector({name: size(name, n) for name in DYNAMIC})

    @cached_property
    def accelerations(self) -> ca.Function:
        """Return the function (x, u, parameters) -> dv (2n,), and the nonzeros of its Jacobian by (x, free, u).

        x = (q_l, q_m, v_l, v_m) (4n,). The Jacobian is sparse: `pattern` lists its entries.
        """
        s, dv, jacobian = self._expressions
        return ca.Function("accelerations", list(s.values()), [dv, ca.vertcat(*jacobian.nonzeros())], {"cse": True})

    @cached_property
    def pattern(self) -> tuple[list[int], list[int]]:
        """Return rows and columns of the nonzeros of the Jacobian."""
        rows, columns = self._expressions[2].sparsity().get_triplet()
        return rows, columns

    @cached_property
    def link_torque(self) -> ca.Function:
        """Return the function (q, v, a, parameters) -> M_l a + C v + grad P_l (n,) [N m], and its derivatives (n m,).

        These are by its m free parameters.
        """
        n = self.robot.n
        s = symbols(q=n, v=n, a=n, parameters=self.layout.size)
        *motion, parameters = s.values()
        torque = self._links(self.layout.named(parameters), *motion)[1]
        slopes = ca.jacobian(torque, parameters)[:, self._entries(OF_LINKS)]
        return dense_function("link_torque", s, {"torque": torque, "slopes": ca.vec(ca.densify(slopes))}, cse=True)

    @cached_property
    def link_inertia(self) -> ca.Function:
        """Return the function (q, parameters) -> M_l (n, n) [kg m^2]."""
        s = symbols(q=self.robot.n, parameters=self.layout.size)
        still = ca.SX.zeros(self.robot.n)
        M_l = self._links(self.layout.named(s["parameters"]), s["q"], still, still)[0]
        return dense_function("link_inertia", s, {"M_l": M_l + self._added})

    @cached_property
    def _expressions(self) -> tuple[dict[str, ca.SX], ca.SX, ca.SX]:
        """Return symbols, accelerations and their Jacobian; M dv/dz = d(torque - M a)/dz at constant a = dv."""
        n = self.robot.n
        s = symbols(x=4 * n, u=n, parameters=self.layout.size)
        x, u, parameters = s.values()
        p, a_l = self.layout.named(parameters), ca.SX.sym("a_l", n)
        q_l, q_m, v_l, v_m = ca.vertsplit(x, n)
        zeta = q_m - q_l - p.offset
        tau = p.joint_stiffness * zeta
        if self.robot.cubic is not None or self._entries((HARDENING,)):
            tau += p.cubic_stiffness * zeta * zeta * zeta
        F_l, F_m = (self._friction(p, side, v, tau) for side, v in (("link", v_l), ("motor", v_m)))
        T = sum(getattr(p, name) * term for name, term in zip(POSITION_TORQUE, position_terms(q_l), strict=True))
        on_links = tau - p.link_damping * v_l - F_l - T
        on_motors = u - tau - p.motor_damping * v_m - F_m
        M_l, bias = self._links(p, q_l, v_l, ca.SX.zeros(n))
        M_l += self._added
        dv_l = solve(M_l, on_links - bias)
        dv_m = on_motors / p.motor_inertia
        z = ca.vertcat(x, *[parameters[i] for i in self._entries(DYNAMIC)], u)
        balance = on_links - self._links(p, q_l, v_l, a_l)[1] - self._added @ a_l
        D_l = ca.substitute(ca.jacobian(balance, z), a_l, dv_l)
        D_l = ca.sparsify(solve(M_l, ca.SX.eye(n)) @ D_l)
        return s, ca.vertcat(dv_l, dv_m), ca.vertcat(D_l, ca.jacobian(dv_m, z))

    def _friction(self, p: SimpleNamespace, side: str, v: ca.SX, tau: ca.SX) -> ca.SX:
        """Return the friction torque (n,) of a side, without the viscous one.

        As simulation.nonideal_plant, but static friction below the Coulomb level counts, too, so that the slope by it
        is nowhere 0.
        """
        coulomb, static, load = (getattr(p, f"{side}_{name}_friction") for name in ("coulomb", "static", "load"))
        level = coulomb
        if self._entries(STATIC):
            level += (static - coulomb) * ca.exp(-((v / p.stribeck_velocity) ** 2))
        if self._entries(LOAD):
            level += load * ca.fabs(tau)
        return level * ca.tanh(v / p.friction_smoothing_velocity)

    @property
    def _added(self) -> ca.SX:
        return sparse(ca.diag(ca.DM(self.added_inertia or (0.0,) * self.robot.n)))

    def _links(self, p: SimpleNamespace, q: ca.SX, v: ca.SX, a: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return M_l (n, n) and M_l a + C v + grad P_l (n,) of the links, with what is free: inertias, a payload.

        A point mass m at p(q) with J = dp/dq adds m J'J and m J'(J a + dJ v - g).
        """
        links = self.robot.links
        if self._entries(PSEUDO_INERTIA):
            theta = ca.horzcat(*(getattr(p, name) for name in PSEUDO_INERTIA))
            chain = corrected_chain(links, [theta[i, :] for i in range(self.robot.n)], q)
            M_l, torque = chain.inertia(), chain.inertial_torque(v, v, a) + chain.gravity_torque()
        else:
            M_l, torque = links.M_l(q), links.inertial_torque(q, v, v, a) + links.grad_P_l(q)
        if links.end_effector is None or not self._entries(PAYLOAD):
            return M_l, torque
        position = ca.vertcat(p.payload_position_x, p.payload_position_y, p.payload_position_z)
        J = ca.jacobian(links.end_effector.position(q, position), q)
        force = p.payload_mass * (J @ a + ca.jtimes(J @ v, q, v) - links.end_effector.gravity)
        return M_l + p.payload_mass * (J.T @ J), torque + J.T @ force

    def _entries(self, names: Sequence[str]) -> list[int]:
        """Return the entries of the packed parameters of the free ones with these names."""
        widths = list(self.layout.sizes.values())
        starts = {name: sum(widths[:k]) for k, name in enumerate(self.layout.sizes)}
        return [starts[name] + index for name, index in self.free if name in names]


def packed(arm: ElasticArm, parameters: Mapping[str, Array]) -> Array:
    """Return the parameters of the arm as one vector."""
    return np.concatenate([np.atleast_1d(parameters[name]) for name in arm.layout.sizes])


def coulomb(v: Array, smoothing: Array | float) -> Array:
    """Return Coulomb friction at velocities v per unit of its level, as `friction` of the plant: it turns over v_0."""
    return np.tanh(v / smoothing)


def position_terms(q: Any, f: Any = ca) -> tuple[Any, ...]:
    """Return what POSITION_TORQUE are the factors of: sin q, cos q, sin 2 q, cos 2 q; f: casadi or numpy."""
    return f.sin(q), f.cos(q), f.sin(2 * q), f.cos(2 * q)


def correctable(links: ArmDynamics) -> bool:
    """Return whether the links consist of bodies in the order of the joints, as from a URDF, unlike a closed form."""
    return links.M_l_vertices is None and bool(links.bodies) and links.order == tuple(range(links.n))


def corrected_chain(links: ArmDynamics, theta: Sequence[Any], q: ca.SX) -> ChainAt:
    """Return the links at q (n,) with expressions theta, ten for each link, as in PSEUDO_INERTIA."""
    assert links.end_effector is not None  # every serial chain has one
    pairs = zip(links.bodies, theta, strict=True)
    inertias = [_corrected(body, of_body, ca.SX.eye(4), ca.exp) for body, of_body in pairs]
    masses = [Mass(P[3, 3], P[:3, 3], P[:3, :3]) for P in inertias]
    return ChainAt(links.bodies, masses, links.end_effector.gravity, q)


def corrected_body(body: Body, theta: Array) -> Body:
    """Return a body with the correction theta (10,)."""
    P = np.asarray(_corrected(body, theta, np.eye(4), np.exp))
    mass, com = float(P[3, 3]), P[:3, 3] / P[3, 3]
    second = P[:3, :3] - mass * np.outer(com, com)
    return replace(body, mass=mass, com=com, inertia=np.trace(second) * np.eye(3) - second)


def corrected_bodies(links: ArmDynamics, joints: Sequence[str], identification: Identification) -> tuple[Body, ...]:
    """Return the bodies of the links with the identified corrections, () without any."""
    theta = np.zeros((links.n, len(PSEUDO_INERTIA)))
    for estimate in identification.estimates:
        if estimate.name in PSEUDO_INERTIA:
            theta[joints.index(estimate.joint), PSEUDO_INERTIA.index(estimate.name)] = estimate.value
    if not np.any(theta):
        return ()
    return tuple(corrected_body(body, of_body) for body, of_body in zip(links.bodies, theta, strict=True))


def _corrected(body: Body, theta: Any, U: Any, exp: Any) -> Any:
    """Return P (4, 4); U: a unit matrix, which is filled."""
    P = pseudo_inertia(body)
    L = np.linalg.cholesky(P + LEAST * np.trace(P) * np.eye(4))
    for k in range(3):
        U[k, k] = exp(theta[1 + k])
    for k, (row, column) in enumerate(ENTRIES):
        U[row, column] = theta[4 + k]
    factor = L @ (exp(theta[0]) * U)
    return factor @ factor.T
