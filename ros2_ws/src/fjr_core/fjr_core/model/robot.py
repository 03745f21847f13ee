# SPDX-License-Identifier: Apache-2.0
"""A flexible-joint robot: rigid arm, motors, and springs between them; checked on construction, immutable."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ..errors import RobotError, StateError
from ..numerics import checks, symbolic
from ..numerics.casadi_function import NumericFunction, numeric
from ..numerics.checks import Array
from ..numerics.one_line import brief, joints
from .joint_limits import JointLimits
from .joint_units import PRISMATIC, REVOLUTE, Units
from .rigid_arm import ArmDynamics, RigidArm


@dataclass(frozen=True, eq=False)
class Robot:
    """A flexible-joint robot of n joints, eq. (36).

    links: rigid arm on the link side. M_m: motor inertia reflected to the link side [kg m^2].
    K: joint stiffness [N m/rad]. D_l, D_m: link and motor damping [N m s/rad]. B_m: input matrix.
    All five are constant matrices (n, n). limits: joint limits or None; they are not enforced here.
    prismatic: True for each prismatic joint (n,), none by default; its units are m and N.

    The state is x = (q_l, q_m, p_l, p_m), four blocks of n, with p_l = M_l(q_l) dq_l, p_m = M_m dq_m.

    Raises RobotError when M_l, M_m or K is not symmetric positive definite, D_l or D_m not symmetric
    positive semidefinite, B_m not invertible, or anything is not finite or of the wrong shape.
    """

    links: ArmDynamics
    M_m: Array
    K: Array
    D_l: Array
    D_m: Array
    B_m: Array
    limits: JointLimits | None = None
    prismatic: tuple[bool, ...] = ()

    def __repr__(self) -> str:
        return f"Robot({joints(self.n)}, K={brief(self.K)}, M_m={brief(self.M_m)})"

    def __post_init__(self) -> None:
        for name in ("M_m", "K", "D_l", "D_m", "B_m"):
            array = checks.matrix(name, getattr(self, name), self.n, RobotError)
            if name in ("M_m", "K"):
                array = checks.positive_definite(name, array, RobotError)
            if name in ("D_l", "D_m"):
                array = checks.positive_semidefinite(name, array, RobotError)
            checks.freeze(self, name, array)
        if not np.linalg.cond(self.B_m) < 1e12:
            raise RobotError(f"B_m is {self.B_m.tolist()}; expected an invertible matrix")
        if self.limits is not None and self.limits.n != self.n:
            raise RobotError(f"limits are of {self.limits.n} joints; expected {self.n}")
        if len(self.prismatic) not in (0, self.n):
            raise RobotError(f"prismatic is {self.prismatic}; expected one entry for each of {self.n} joints, or none")
        for M in self.links.M_l_vertices or (self.links.M_l(np.zeros(self.n)).full(),):
            checks.positive_definite("M_l", np.asarray(M), RobotError)

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.links.n

    @property
    def units(self) -> tuple[Units, ...]:
        """Units of each joint's position, velocity, acceleration and effort."""
        return tuple(PRISMATIC if slides else REVOLUTE for slides in self.prismatic or (False,) * self.n)

    def M_l(self, q_l: ArrayLike) -> Array:
        """Return the link inertia M_l(q_l) (n, n) [kg m^2] at q_l (n,) [rad]."""
        return self.links.M_l(self._vector("q_l", q_l)).full()

    def P_l(self, q_l: ArrayLike) -> float:
        """Return the potential energy of the links [J] at q_l (n,) [rad]."""
        return float(self.links.P_l(self._vector("q_l", q_l)))

    def grad_P_l(self, q_l: ArrayLike) -> Array:
        """Return the gravity torque dP_l/dq_l (n,) [N m] at q_l (n,) [rad]."""
        return self.links.grad_P_l(self._vector("q_l", q_l)).full().ravel()

    def coriolis(self, q_l: ArrayLike, dq_l: ArrayLike, w: ArrayLike) -> Array:
        """Return the Coriolis product C(q_l, dq_l) w (n,) [N m], with the Christoffel symbols of M_l."""
        vectors = (self._vector(name, v) for name, v in (("q_l", q_l), ("dq_l", dq_l), ("w", w)))
        return self.links.C(*vectors).full().ravel()

    def hamiltonian(self, x: ArrayLike) -> float:
        """Return the total energy H(x) [J], eq. (36), at x (4n,)."""
        return float(self._hamiltonian(checks.vector("x", x, 4 * self.n, StateError))[0][0])

    def state(self, q_l: ArrayLike, q_m: ArrayLike, dq_l: ArrayLike, dq_m: ArrayLike) -> Array:
        """Return the state x (4n,) for positions [rad] and velocities [rad/s] (n,) of links and motors."""
        q_l, q_m = self._vector("q_l", q_l), self._vector("q_m", q_m)
        dq_l, dq_m = self._vector("dq_l", dq_l), self._vector("dq_m", dq_m)
        return self._state(q_l, q_m, dq_l, dq_m)[0]

    def velocities(self, x: ArrayLike) -> tuple[Array, Array]:
        """Return the velocities (dq_l, dq_m), each (n,) [rad/s], at the state x (4n,)."""
        dq_l, dq_m = self._velocities(checks.vector("x", x, 4 * self.n, StateError))
        return dq_l, dq_m

    def hamiltonian_expression(self, x: ca.SX, links: RigidArm | None = None) -> ca.SX:
        """Return H(x) = p_l' M_l^-1 p_l / 2 + p_m' M_m^-1 p_m / 2 + P_l + zeta' K zeta / 2, eqs. (35), (36).

        links: replaces the rigid arm of the robot, e.g. with a payload.
        """
        q_l, q_m, p_l, p_m = symbolic.blocks(x, self.n)
        dq_l, dq_m = self.velocity_expressions(x, links)
        zeta = q_m - q_l
        kinetic = (ca.dot(p_l, dq_l) + ca.dot(p_m, dq_m)) / 2
        return kinetic + (links or self.links).P_l(q_l) + ca.dot(zeta, self.K @ zeta) / 2

    def velocity_expressions(self, x: ca.SX, links: RigidArm | None = None) -> tuple[ca.SX, ca.SX]:
        """Return (dq_l, dq_m) = (M_l^-1 p_l, M_m^-1 p_m) as expressions; links as in hamiltonian_expression."""
        q_l, _, p_l, p_m = symbolic.blocks(x, self.n)
        M_l = (links or self.links).M_l(q_l)
        return symbolic.solve(M_l, p_l), ca.DM(np.linalg.inv(self.M_m)) @ p_m

    def momentum_expressions(
        self, q_l: ca.SX, dq_l: ca.SX, dq_m: ca.SX, links: RigidArm | None = None
    ) -> tuple[ca.SX, ca.SX]:
        """Return (p_l, p_m) = (M_l dq_l, M_m dq_m) as expressions; links as in hamiltonian_expression."""
        return (links or self.links).M_l(q_l) @ dq_l, self.M_m @ dq_m

    def fingerprint(self) -> bytes:
        """Return a digest of the equations of motion; equal for robots with the same equations."""
        functions = ("M_l", "P_l", "grad_P_l", "C", "inertial_torque", "grad_T")
        parts = [getattr(self.links, name).serialize() for name in functions]
        digest = hashlib.sha256("\n".join(parts).encode())
        for name in ("M_m", "K", "D_l", "D_m", "B_m"):
            digest.update(np.ascontiguousarray(getattr(self, name)).tobytes())
        return digest.digest()

    def _vector(self, name: str, value: ArrayLike) -> Array:
        return checks.vector(name, value, self.n, StateError)

    @cached_property
    def _hamiltonian(self) -> NumericFunction:
        x = ca.SX.sym("x", 4 * self.n)
        return numeric("hamiltonian", {"x": x}, {"H": self.hamiltonian_expression(x)})

    @cached_property
    def _velocities(self) -> NumericFunction:
        x = ca.SX.sym("x", 4 * self.n)
        return numeric("velocities", {"x": x}, dict(zip(("dq_l", "dq_m"), self.velocity_expressions(x), strict=True)))

    @cached_property
    def _state(self) -> NumericFunction:
        inputs = symbolic.symbols(q_l=self.n, q_m=self.n, dq_l=self.n, dq_m=self.n)
        q_l, q_m, dq_l, dq_m = inputs.values()
        return numeric("state", inputs, {"x": ca.vertcat(q_l, q_m, *self.momentum_expressions(q_l, dq_l, dq_m))})
