# SPDX-License-Identifier: Apache-2.0
"""Robots whose parameters differ from those of the law by at most stated errors: their equations as expressions.

    p (M(q_l) ddq_l + C dq_l + grad P_l) + D_l dq_l = K (q_m - q_l),   M_m ddq_m + D_m dq_m + K (q_m - q_l) = B_m u

Every uncertain parameter, or its inverse, is a middle plus a share s_j, -1 to 1, of half its width; the shares (u,) are
a box. Mass and inertia of a link enter through the bodies of its chain, a payload as a point mass at the last link.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from types import SimpleNamespace
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from fjr_core.errors import ParameterError
from fjr_core.model.newton_euler import ChainAt, Mass
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array, floats
from fjr_core.numerics.symbolic import PackedVector, directional, sparse

LARGEST = 0.9
"""Largest error: relative, of a factor; in rad, of the direction of gravity."""


class Uncertainty(NamedTuple):
    """An uncertain parameter: what it is of, the numbers of it (0: one for each joint), its unit; "" for a factor."""

    of: str
    numbers: int = 0
    unit: str = ""


PARAMETERS = {
    "payload": Uncertainty("all link masses and inertias", numbers=1),
    "payload_mass": Uncertainty("a mass at the last link", numbers=1, unit="kg"),
    "payload_position": Uncertainty("its place", numbers=3, unit="m"),
    "link_mass": Uncertainty("mass and inertia of each link"),
    "link_inertia": Uncertainty("inertia of each link about its centre of mass"),
    "gravity": Uncertainty("gravity", numbers=1),
    "gravity_direction": Uncertainty("the direction of gravity", numbers=2, unit="rad"),
    "stiffness": Uncertainty("each joint stiffness"),
    "motor_inertia": Uncertainty("each motor inertia"),
    "link_damping": Uncertainty("each link damping"),
    "motor_damping": Uncertainty("each motor damping"),
}
"""Uncertain parameters; their errors are relative for factors, else in their units."""
CHAIN = ("link_mass", "link_inertia", "gravity_direction")
"""Parameters that need the bodies of the arm."""
INVERSE = ("payload", "motor_inertia")
"""Factors whose inverse is linear in the share: the equations are divided by them."""
MATRICES = {"stiffness": "K", "motor_inertia": "M_m", "link_damping": "D_l", "motor_damping": "D_m"}
"""Matrices of the robot whose diagonal entries the factors multiply."""


class UncertainRobot:
    """A robot whose parameters are uncertain within errors: relative, or in their units; one number or one for each.

    A payload has 0 to payload_mass [kg] at payload_position (3,) [m] in the frame of the last link, each coordinate up
    to its error beside it. nominal (u,): shares of the robot itself. Raises ParameterError for an unknown name, for an
    error that is negative, too large or of a wrong number of entries, and for one that the robot cannot have.
    """

    def __init__(
        self, robot: Robot, errors: Mapping[str, ArrayLike] = {}, payload_position: ArrayLike = (0.0, 0.0, 0.0)
    ) -> None:
        self.robot, n = robot, robot.n
        self._layout = PackedVector({name: kind.numbers or n for name, kind in PARAMETERS.items()})
        sizes = {name: _checked(name, errors.get(name, 0.0), size) for name, size in self._layout.sizes.items()}
        own: dict[str, Array] = {
            name: np.full(size, 0.0 if PARAMETERS[name].unit else 1.0) for name, size in self._layout.sizes.items()
        }
        own["payload_position"] = floats("payload_position", payload_position, ParameterError)
        self._middle, half = (np.concatenate([part[name] for name in PARAMETERS]) for part in (own, sizes))
        first, _ = self._place("payload_mass")
        itself = self._middle.copy()
        half[first] /= 2
        self._middle[first] = half[first]
        for name in INVERSE:
            ends = slice(*self._place(name))
            self._middle[ends] = 1 / (1 - half[ends] ** 2)
            half[ends] *= self._middle[ends]
        self._active = np.flatnonzero(half)
        self._half: Array = half[self._active]
        self.nominal: Array = (itself - self._middle)[self._active] / self._half
        self._refuse(sizes)

    @property
    def count(self) -> int:
        """Number u of uncertain parameters."""
        return len(self._half)

    def of_joints(self, name: str, shares: Array) -> Array:
        """Return the factors (n,) of a parameter at shares (u,)."""
        values = self._middle.copy()
        values[self._active] += self._half * shares
        at = values[slice(*self._place(name))]
        return np.asarray(1 / at if name in INVERSE else at)

    @cached_property
    def links(self) -> ca.Function:
        """(q, dq, ddq, shares) -> M ddq + C dq + grad P_l (n,) [N m], and M (n, n) [kg m^2]."""
        q, dq, ddq = motion = [ca.SX.sym(name, self.robot.n) for name in ("q", "dq", "ddq")]
        shares = ca.SX.sym("shares", self.count)
        p, own, order = self._values(shares), self.robot.links, list(self.robot.links.order)
        if self._changes(*CHAIN):
            chain = self._chain(p, q)
            inertial = chain.inertial_torque(*(vector[self._along] for vector in (dq, dq, ddq)))
            torque, M = (inertial + p.gravity * chain.gravity_torque())[order], chain.inertia()[order, order]
        else:
            torque, M = own.inertial_torque(q, dq, dq, ddq) + p.gravity * own.grad_P_l(q), own.M_l(q)
        if self._changes("payload_mass") and own.end_effector is not None:
            place = own.end_effector.position(q, p.payload_position)
            J, states = ca.jacobian(place, q), ca.vertcat(q, dq)
            acceleration = directional(directional(place, q, dq), states, ca.vertcat(dq, ddq))
            torque += p.payload_mass * (J.T @ (acceleration - p.gravity * self._gravity(p)))
            M += p.payload_mass * (J.T @ J)
        return ca.Function("links", [*motion, shares], [torque, M])

    def factor(self, name: str, shares: ca.SX) -> ca.SX:
        """Return the factors of a parameter: one of all joints, or (n,)."""
        return getattr(self._values(shares), name)

    def matrix(self, name: str, shares: ca.SX) -> ca.SX:
        """Return K, M_m, D_l or D_m (n, n), named by its factors."""
        return ca.diag(self.factor(name, shares)) @ sparse(getattr(self.robot, MATRICES[name]))

    def _values(self, shares: ca.SX) -> SimpleNamespace:
        values = ca.SX(ca.DM(self._middle))
        for j, place in enumerate(self._active):
            values[int(place)] += self._half[j] * shares[j]
        named = self._layout.named(values)
        for name in INVERSE:
            setattr(named, name, 1 / getattr(named, name))
        return named

    def _chain(self, p: SimpleNamespace, q: ca.SX) -> ChainAt:
        """Return the chain of the changed bodies."""
        masses = []
        for i, body in enumerate(self.robot.links.bodies):
            com, inertia = np.asarray(body.com), np.asarray(body.inertia)
            second = np.trace(inertia) / 2 * np.eye(3) - inertia
            a, b = p.link_mass[self._along[i]], p.link_inertia[self._along[i]]
            J = a * (b * ca.SX(ca.DM(second)) + ca.SX(ca.DM(body.mass * np.outer(com, com))))
            masses.append(Mass(a * body.mass, a * ca.SX(ca.DM(body.mass * com)), J))
        return ChainAt(self.robot.links.bodies, masses, self._gravity(p), q[self._along])

    @property
    def _along(self) -> list[int]:
        """Joint of the robot at each place of the chain."""
        return [self.robot.links.order.index(i) for i in range(self.robot.n)]

    def _gravity(self, p: SimpleNamespace) -> ca.SX:
        """Return gravity (3,) [m/s^2] of the model, turned by two angles about horizontal axes."""
        end_effector = self.robot.links.end_effector
        if end_effector is None or not self._changes("gravity_direction"):
            return ca.SX(ca.DM(np.zeros(3) if end_effector is None else end_effector.gravity))
        size = np.linalg.norm(end_effector.gravity)
        x, y = np.linalg.svd(end_effector.gravity[None, :])[2][1:]  # normal to gravity
        (a, b), columns = ca.vertsplit(p.gravity_direction), (x, y, end_effector.gravity / size)
        turned = ca.vertcat(ca.sin(b), -ca.sin(a) * ca.cos(b), ca.cos(a) * ca.cos(b))
        return ca.DM(size * np.column_stack(columns)) @ turned

    def _place(self, name: str) -> tuple[int, int]:
        """Return the first place of a parameter among all values, and the one behind the last."""
        before = list(self._layout.sizes)[: list(PARAMETERS).index(name)]
        first = sum(self._layout.sizes[each] for each in before)
        return first, first + self._layout.sizes[name]

    def _changes(self, *names: str) -> bool:
        """Return whether one of these parameters is uncertain."""
        return any(np.isin(np.arange(*self._place(name)), self._active).any() for name in names)

    def _refuse(self, sizes: Mapping[str, Array]) -> None:
        """Raise ParameterError for an error that the robot cannot have."""
        links = self.robot.links
        for name in CHAIN:
            if np.any(sizes[name]) and (not links.bodies or links.end_effector is None):
                raise ParameterError(f"error '{name}' is given for an arm without bodies; expected a chain of bodies")
        if np.any(sizes["payload_mass"]) and links.end_effector is None:
            raise ParameterError("error 'payload_mass' is given for an arm without an end effector; expected one")
        if np.any(sizes["payload_position"]) and not np.any(sizes["payload_mass"]):
            raise ParameterError("error 'payload_position' is given alone; expected one with payload_mass")
        for name, matrix in MATRICES.items():
            entries = getattr(self.robot, matrix)
            if np.any(sizes[name]) and np.any(entries != np.diag(np.diag(entries))):
                raise ParameterError(f"error '{name}' is given for a matrix {matrix} that is not diagonal")


def _checked(name: str, error: ArrayLike, numbers: int) -> Array:
    """Return the errors (numbers,) of a parameter."""
    size = floats(f"error '{name}'", error, ParameterError)
    limit = np.inf if PARAMETERS[name].unit in ("kg", "m") else LARGEST
    if size.shape not in ((), (numbers,)):
        raise ParameterError(f"error '{name}' has shape {size.shape}; expected one number or {numbers}")
    if not np.all((size >= 0) & (size <= limit) & np.isfinite(size)):
        raise ParameterError(f"error '{name}' is {size.tolist()}; expected 0 to {limit}")
    return np.broadcast_to(size, numbers).astype(float)
