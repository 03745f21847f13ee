# SPDX-License-Identifier: Apache-2.0
"""The arm whose parameters are identified: accelerations of links and motors, with their derivatives.

    M_l(q_l) dv_l + C(q_l, v_l) v_l + grad P_l(q_l) = tau - D_l v_l - F_l(v_l) - T(q_l),   tau = K (q_m - q_l - offset)
    B dv_m = B_m u - tau - D_m v_m - F_m(v_m)

F_l and F_m are the friction of simulation.nonideal_plant, T is an optional torque of the position of one joint.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import casadi as ca

from fjr_core.model.newton_euler import InertialArm
from fjr_core.model.rigid_arm import ArmDynamics, PayloadArm, RigidArm
from fjr_core.model.robot import Robot
from fjr_core.numerics.symbolic import PackedVector, dense_function, directional, solve, sparse, symbols
from fjr_core.simulation.nonideal_plant import friction

from .parameters import KINDS, OF_LINKS, PAYLOAD, POSITION_TORQUE, PSEUDO_INERTIA, TIMING, size
from .pseudo_inertia import corrected_arm

DYNAMIC = tuple(name for name in KINDS if name not in TIMING)
"""Parameters of the equations of motion."""


@dataclass(frozen=True, eq=False)
class ElasticArm:
    """Equations of motion in (q_l, q_m, v_l, v_m) with symbolic parameters.

    free: entries of the packed parameters with respect to which derivatives are taken. added_inertia [kg m^2]: of each
    link, for links so light that their resonance is too fast for the record; () for none.
    """

    robot: Robot
    free: tuple[int, ...]
    added_inertia: tuple[float, ...] = ()

    @cached_property
    def layout(self) -> PackedVector:
        """Return the parts of the parameters: DYNAMIC, then the velocities of the friction model."""
        n = self.robot.n
        return PackedVector({**{name: size(name, n) for name in DYNAMIC}, "smoothing": n, "stribeck": n})

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
        """Return the function (q, v, a, parameters) -> M_l a + C v + grad P_l (n,) [N m]."""
        n = self.robot.n
        s = symbols(q=n, v=n, a=n, parameters=self.layout.size)
        q, v, a, parameters = s.values()
        links = self._links(self.layout.named(parameters))
        return dense_function("link_torque", s, {"torque": self._rigid(links, q, v, a)}, cse=True)

    @cached_property
    def link_torque_slopes(self) -> ca.Function:
        """Return the function (q, v, a, parameters) -> derivatives (n, m) of link_torque by its m free parameters."""
        n = self.robot.n
        s = symbols(q=n, v=n, a=n, parameters=self.layout.size)
        *motion, parameters = s.values()
        torque = self._rigid(self._links(self.layout.named(parameters)), *motion)
        of_links = set(free_entries(self.layout, [(name, i) for name in OF_LINKS for i in range(size(name, n))]))
        free = [i for i in self.free if i in of_links]
        slopes = ca.jacobian(torque, parameters)[:, free]
        return dense_function("link_torque_slopes", s, {"slopes": ca.vec(ca.densify(slopes))}, cse=True)

    @cached_property
    def link_inertia(self) -> ca.Function:
        """Return the function (q, parameters) -> M_l (n, n) [kg m^2]."""
        s = symbols(q=self.robot.n, parameters=self.layout.size)
        M_l = self._links(self.layout.named(s["parameters"])).M_l(s["q"]) + self._added
        return dense_function("link_inertia", s, {"M_l": M_l})

    @cached_property
    def _expressions(self) -> tuple[dict[str, ca.SX], ca.SX, ca.SX]:
        """Return symbols, accelerations and their Jacobian; M dv/dz = d(torque - M a)/dz at constant a = dv."""
        n = self.robot.n
        s = symbols(x=4 * n, u=n, parameters=self.layout.size)
        x, u, parameters = s.values()
        p, a_l = self.layout.named(parameters), ca.SX.sym("a_l", n)
        q_l, q_m, v_l, v_m = ca.vertsplit(x, n)
        links = self._links(p)
        tau = p.joint_stiffness * (q_m - q_l - p.offset)
        F_l = friction(v_l, p.link_coulomb_friction, p.link_static_friction, p.stribeck, p.smoothing)
        F_m = friction(v_m, p.motor_coulomb_friction, p.motor_static_friction, p.stribeck, p.smoothing)
        on_links = tau - p.link_damping * v_l - F_l - position_torque(p, q_l)
        on_motors = sparse(self.robot.B_m) @ u - tau - p.motor_damping * v_m - F_m
        M_l = links.M_l(q_l) + self._added
        dv_l = solve(M_l, on_links - self._rigid(links, q_l, v_l, ca.SX.zeros(n)))
        dv_m = on_motors / p.motor_inertia
        z = ca.vertcat(x, *[parameters[i] for i in self.free], u)
        balance = on_links - self._rigid(links, q_l, v_l, a_l) - self._added @ a_l
        D_l = ca.substitute(ca.jacobian(balance, z), a_l, dv_l)
        D_l = ca.sparsify(solve(M_l, ca.SX.eye(n)) @ D_l)
        return s, ca.vertcat(dv_l, dv_m), ca.vertcat(D_l, ca.jacobian(dv_m, z))

    def _rigid(self, links: RigidArm, q: ca.SX, v: ca.SX, a: ca.SX) -> ca.SX:
        """Return M_l a + C v + grad P_l, C v = dM_l v - grad T."""
        if isinstance(links, (ArmDynamics, InertialArm)):
            return links.inertial_torque(q, v, v, a) + links.grad_P_l(q)
        dM = directional(links.M_l(q) @ v, q, v)
        return links.M_l(q) @ a + dM - links.grad_T(q, v) + links.grad_P_l(q)

    @property
    def _added(self) -> ca.SX:
        return sparse(ca.diag(ca.DM(self.added_inertia or (0.0,) * self.robot.n)))

    def _links(self, p: SimpleNamespace) -> RigidArm:
        """Return the links of the robot, with a payload or with corrected inertias if one is free."""
        links: RigidArm = self.robot.links
        if self._is_free(PSEUDO_INERTIA):
            theta = ca.horzcat(*(getattr(p, name) for name in PSEUDO_INERTIA))
            links = corrected_arm(self.robot.links, [theta[i, :] for i in range(self.robot.n)])
        end_effector = self.robot.links.end_effector
        if end_effector is None or not self._is_free(PAYLOAD):
            return links
        position = ca.vertcat(p.payload_position_x, p.payload_position_y, p.payload_position_z)
        return PayloadArm(links, end_effector, p.payload_mass, position)

    def _is_free(self, names: Sequence[str]) -> bool:
        """Return whether an entry of a parameter with one of these names is free."""
        entries = [(name, i) for name in names for i in range(size(name, self.robot.n))]
        return not set(free_entries(self.layout, entries)).isdisjoint(self.free)


def position_torque(p: SimpleNamespace, q: ca.SX, f: Any = ca) -> ca.SX:
    """Return the torque sum_k a_k sin k q + b_k cos k q (n,) [N m], k = 1, 2; f: casadi or numpy."""
    return sum(getattr(p, name) * term for name, term in zip(POSITION_TORQUE, position_terms(q, f), strict=True))


def position_terms(q: Any, f: Any = ca) -> tuple[Any, ...]:
    """Return what POSITION_TORQUE are the factors of: sin q, cos q, sin 2 q, cos 2 q."""
    return f.sin(q), f.cos(q), f.sin(2 * q), f.cos(2 * q)


def free_entries(layout: PackedVector, free: Sequence[tuple[str, int]]) -> tuple[int, ...]:
    """Return the entries of the packed parameters for (name, index) of each free one."""
    starts, at = {}, 0
    for name, width in layout.sizes.items():
        starts[name], at = at, at + width
    return tuple(starts[name] + index for name, index in free if name in starts)
