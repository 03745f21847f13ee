# SPDX-License-Identifier: Apache-2.0
"""A flexible-joint robot: rigid arm, motors, and springs between them, with its limits, units and coordinates."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ..errors import RobotError, StateError
from ..numerics import checks, symbolic
from ..numerics.checks import Array
from ..numerics.one_line import brief, joints
from ..numerics.symbolic import dense_function, evaluate, symbols
from . import springs
from .joints import PRISMATIC, REVOLUTE, JointLimits, Units
from .rigid_arm import ArmDynamics, RigidArm


class Elastic(springs.Springs):
    """Parameters of eq. (36), as numbers (Robot) or as expressions (SymbolicRobot), and its terms as expressions.

    Fields as in Robot and springs.Springs.
    """

    links: RigidArm
    M_m: Any
    M_m_inverse: Any
    D_l: Any
    D_m: Any
    B_m: Any

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.M_m.shape[0])

    def hamiltonian_expression(self, x: ca.SX) -> ca.SX:
        """Return H(x) = p_l' M_l^-1 p_l / 2 + p_m' M_m^-1 p_m / 2 + P_l + zeta' K zeta / 2, eq. (35).

        Springs with a curve store its integral (model.springs).
        """
        q_l, q_m, p_l, p_m = ca.vertsplit(x, self.n)
        dq_l, dq_m = self.velocity_expressions(x)
        return (ca.dot(p_l, dq_l) + ca.dot(p_m, dq_m)) / 2 + self.links.P_l(q_l) + springs.energy(self, q_m - q_l)

    def velocity_expressions(self, x: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return (dq_l, dq_m) = (M_l^-1 p_l, M_m^-1 p_m) as expressions."""
        q_l, _, p_l, p_m = ca.vertsplit(x, self.n)
        return symbolic.solve(self.links.M_l(q_l), p_l), self.M_m_inverse @ p_m

    def state_expression(self, position: ca.SX, velocity: ca.SX) -> ca.SX:
        """Return x = (q_l, q_m, M_l dq_l, M_m dq_m) (4n,) at positions and velocities (2n,) as an expression."""
        dq_l, dq_m = ca.vertsplit(velocity, self.n)
        return ca.vertcat(position, self.links.M_l(position[: self.n]) @ dq_l, self.M_m @ dq_m)


class SymbolicRobot(Elastic):
    """A robot with some parameters replaced, by numbers or expressions."""

    def __init__(self, robot: Elastic, **changed: Any) -> None:
        names = springs.Springs.__annotations__ | Elastic.__annotations__
        vars(self).update({name: changed.get(name, getattr(robot, name)) for name in names})


@dataclass(frozen=True, eq=False)
class Robot(Elastic):
    """A flexible-joint robot of n joints, eq. (36).

    links: rigid arm on the link side. M_m: motor inertia reflected to the link side [kg m^2].
    K: joint stiffness [N m/rad]. D_l, D_m: link and motor damping [N m s/rad]. B_m: input matrix.
    All five are constant, (n, n), (n,) or a number. limits: joint limits or None; they are not enforced here.
    prismatic: True for each prismatic joint (n,), none by default; its units are m and N.
    cubic: cubic stiffness k (n,) [N m/rad^3], 0 or more, of hardening springs K zeta + k zeta^3 (model.springs).
    torsion (2, m, n) [rad, N m]: deflections and torques of a curve with the slope K at zero, zeros for a straight
    joint. Both are None for straight springs, also where zeros are given.

    The state is x = (q_l, q_m, p_l, p_m), four blocks of n, with p_l = M_l(q_l) dq_l, p_m = M_m dq_m.

    Raises RobotError when M_l (at its vertices if known, else at q_l = 0), M_m or K is not symmetric positive definite,
    D_l or D_m not symmetric positive semidefinite, B_m not invertible, or anything is not finite or of the wrong shape,
    or where a curve is not monotone, comes with another one or with a matrix K that is not diagonal.
    """

    links: ArmDynamics
    M_m: Array
    K: Array
    D_l: Array
    D_m: Array
    B_m: Array
    limits: JointLimits | None = None
    prismatic: tuple[bool, ...] = ()
    cubic: Array | None = None
    torsion: Array | None = None

    def __repr__(self) -> str:
        cubic = "" if self.cubic is None else f", cubic={brief(self.cubic)}"
        cubic += f", {self.torsion.shape[1]} points of torsion" if self.torsion is not None else ""
        return f"Robot({joints(self.n)}, K={brief(self.K)}, M_m={brief(self.M_m)}{cubic})"

    def __post_init__(self) -> None:
        for name in ("M_m", "K", "D_l", "D_m", "B_m"):
            array = checks.matrix(name, getattr(self, name), self.links.n, RobotError)
            if name in ("M_m", "K"):
                array = checks.positive_definite(name, array, RobotError)
            if name in ("D_l", "D_m"):
                array = checks.positive_semidefinite(name, array, RobotError)
            checks.freeze(self, name, array)
        if self.cubic is not None:
            object.__setattr__(self, "cubic", springs.checked_cubic(self.cubic, self.K))
        if self.torsion is not None:
            object.__setattr__(self, "torsion", springs.checked_torsion(self.torsion, self.K))
            if self.cubic is not None and self.torsion is not None:
                raise RobotError("torsion is given with a cubic stiffness; expected one curve")
        if not np.linalg.cond(self.B_m) < 1e12:
            raise RobotError(f"B_m is {self.B_m.tolist()}; expected an invertible matrix")
        if self.limits is not None and self.limits.n != self.n:
            raise RobotError(f"limits are of {self.limits.n} joints; expected {self.n}")
        if len(self.prismatic) not in (0, self.n):
            raise RobotError(f"prismatic is {self.prismatic}; expected one entry for each of {self.n} joints, or none")
        for M in self.links.M_l_vertices or (self.links.M_l(np.zeros(self.n)).full(),):
            checks.positive_definite("M_l", np.asarray(M), RobotError)

    @cached_property
    def M_m_inverse(self) -> ca.DM:
        """Inverse of M_m."""
        return ca.DM(np.linalg.inv(self.M_m))

    @property
    def units(self) -> tuple[Units, ...]:
        """Units of each joint's position, velocity, acceleration and effort."""
        return tuple(PRISMATIC if slides else REVOLUTE for slides in self.prismatic or (False,) * self.n)

    @property
    def curve(self) -> str:
        """Name of the robot parameter that bends the springs, "" for straight ones."""
        if self.torsion is not None:
            return "torsion_torque"
        return "" if self.cubic is None else "cubic_stiffness"

    @cached_property
    def curves(self) -> tuple[Any, ...]:
        """CubicCurve or TorsionCurve of each joint (model.springs); none: straight springs."""
        K = np.diag(self.K)
        if self.torsion is not None:
            return tuple(springs.torsion_curve(k, *of.T) for k, of in zip(K, self.torsion.T, strict=True))
        return () if self.cubic is None else tuple(map(springs.CubicCurve, K.tolist(), self.cubic.tolist()))

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
        """Return the total energy H(x) [J], eq. (35), at x (4n,)."""
        return float(evaluate(self._hamiltonian, checks.vector("x", x, 4 * self.n, StateError))[0][0])

    def state(self, q_l: ArrayLike, q_m: ArrayLike, dq_l: ArrayLike, dq_m: ArrayLike) -> Array:
        """Return the state x (4n,) for positions [rad] and velocities [rad/s] (n,) of links and motors."""
        parts = (("q_l", q_l), ("q_m", q_m), ("dq_l", dq_l), ("dq_m", dq_m))
        values = [self._vector(name, value) for name, value in parts]
        return evaluate(self.to_state, np.hstack(values[:2]), np.hstack(values[2:]))[0]

    def velocities(self, x: ArrayLike) -> tuple[Array, Array]:
        """Return the velocities (dq_l, dq_m), each (n,) [rad/s], at the state x (4n,)."""
        (velocity,) = evaluate(self.to_velocity, checks.vector("x", x, 4 * self.n, StateError))
        return velocity[: self.n], velocity[self.n :]

    def deflection(self, tau: ArrayLike) -> Array:
        """Return the deflection q_m - q_l (n,) [rad] of the springs under torques tau (n,) [N m]."""
        return ca.DM(springs.deflection(self, ca.DM(self._vector("tau", tau)))).full().ravel()

    @cached_property
    def to_state(self) -> ca.Function:
        """The CasADi function (position (q_l, q_m), velocity (dq_l, dq_m)), (2n,) each, -> state x (4n,)."""
        s = symbols(position=2 * self.n, velocity=2 * self.n)
        return dense_function("to_state", s, {"x": self.state_expression(**s)}, cse=True)

    @cached_property
    def to_velocity(self) -> ca.Function:
        """The CasADi function x (4n,) -> velocity (dq_l, dq_m) (2n,)."""
        x = ca.SX.sym("x", 4 * self.n)
        velocity = ca.vertcat(*self.velocity_expressions(x))
        return dense_function("to_velocity", {"x": x}, {"velocity": velocity}, cse=True)

    def fingerprint(self) -> bytes:
        """Return a digest of the equations of motion; equal for robots with the same equations."""
        functions = ("M_l", "P_l", "grad_P_l", "inertial_torque", "grad_T")
        parts = [getattr(self.links, name).serialize() for name in functions]
        digest = hashlib.sha256("\n".join(parts).encode())
        for name in ("M_m", "K", "D_l", "D_m", "B_m"):
            digest.update(np.ascontiguousarray(getattr(self, name)).tobytes())
        for curve in (self.cubic, self.torsion):
            digest.update(b"" if curve is None else curve.tobytes())
        return digest.digest()

    def _vector(self, name: str, value: ArrayLike) -> Array:
        return checks.vector(name, value, self.n, StateError)

    @cached_property
    def _hamiltonian(self) -> ca.Function:
        x = ca.SX.sym("x", 4 * self.n)
        return dense_function("hamiltonian", {"x": x}, {"H": self.hamiltonian_expression(x)})


def check_robot(robot: object) -> None:
    """Raise RobotError unless `robot` is a Robot."""
    checks.instance("robot", robot, Robot, RobotError, "a robot, e.g. fjr.single_link()")
