# SPDX-License-Identifier: Apache-2.0
"""Robots whose parameters differ from those of the law by at most stated errors: their equations as expressions.

    p (M(q_l) ddq_l + C dq_l + grad P_l) + D_l dq_l = K (q_m - q_l),   M_m ddq_m + D_m dq_m + K (q_m - q_l) = B_m u

p, the payload as a factor, is of the links: the mass of a payload in kg is divided by p in M, C and P_l. Every
uncertain parameter, or its inverse, is a middle plus a share s_j, -1 to 1, of half its width; the shares (u,) are a
box. The names are those of the glossary (`fjr_core.simulation.deviations`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from types import SimpleNamespace

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from fjr_core.errors import ParameterError
from fjr_core.model.rigid_arm import ArmDynamics, PayloadArm
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array, floats, is_diagonal
from fjr_core.numerics.symbolic import PackedVector, sparse
from fjr_core.simulation.deviations import CHAIN, DEVIATIONS, MATRICES, ChangedLinks, has_bodies, turned_gravity

LARGEST = 0.9
"""Largest error: relative, of a factor; in rad, of the direction of gravity."""
PARAMETERS = ("payload", "payload_mass", "payload_position", *CHAIN[:2], "gravity", CHAIN[2], *MATRICES)
"""Deviations that are uncertain parameters, whose errors do not change with time."""
INVERSE = ("payload", "motor_inertia")
"""Factors whose inverse is linear in the share: the equations are divided by them."""


class UncertainRobot:
    """A robot whose parameters are uncertain within errors: relative, or in their units; one number or one for each.

    A payload has 0 to payload_mass [kg] at payload_position (3,) [m] in the frame of the last link, each coordinate up
    to its error beside it. nominal (u,): shares of the robot itself. Raises ParameterError for an unknown name, for an
    error that is negative, too large or of a wrong number of entries, and for one that the robot cannot have.
    """

    def __init__(
        self, robot: Robot, errors: Mapping[str, ArrayLike] = {}, payload_position: ArrayLike = (0.0, 0.0, 0.0)
    ) -> None:
        self.robot = robot
        widths = {name: DEVIATIONS[name].width(robot.n) for name in PARAMETERS} | {"gravity": 1}
        self._layout = PackedVector(widths)
        sizes = {name: _checked(name, errors.get(name, 0.0), width) for name, width in widths.items()}
        self._given = [name for name, size in sizes.items() if np.any(size)]
        self._refuse()
        own: dict[str, Array] = {name: np.full(width, DEVIATIONS[name].nominal) for name, width in widths.items()}
        own["payload_position"] = floats("payload_position", payload_position, ParameterError)
        middle, half = own.copy(), sizes.copy()
        middle["payload_mass"] = half["payload_mass"] = sizes["payload_mass"] / 2
        for name in INVERSE:
            middle[name] = 1 / (1 - sizes[name] ** 2)
            half[name] = sizes[name] * middle[name]
        itself, self._middle, every = (np.concatenate([part[name] for name in widths]) for part in (own, middle, half))
        self._active = np.flatnonzero(every)
        self._half: Array = every[self._active]
        self.nominal: Array = (itself - self._middle)[self._active] / self._half

    @property
    def count(self) -> int:
        """Number u of uncertain parameters."""
        return len(self._half)

    def of_joints(self, name: str, shares: Array) -> Array:
        """Return the factors (n,) of a parameter at shares (u,)."""
        values = self._middle.copy()
        values[self._active] += self._half * shares
        ends = np.cumsum(list(self._layout.sizes.values()))[:-1]
        at = np.split(values, ends)[PARAMETERS.index(name)]
        return np.asarray(1 / at if name in INVERSE else at)

    @cached_property
    def links(self) -> ca.Function:
        """(q, dq, ddq, shares) -> M ddq + C dq + grad P_l (n,) [N m], and M (n, n) [kg m^2]."""
        q, dq, ddq = motion = [ca.SX.sym(name, self.robot.n) for name in ("q", "dq", "ddq")]
        shares, links = ca.SX.sym("shares", self.count), self.robot.links
        p = self._values(shares)
        given = {name: getattr(p, name) for name in self._given}
        arm: ArmDynamics | ChangedLinks = ChangedLinks(links, given) if given.keys() & CHAIN else links
        inertial, weight, M = arm.inertial_torque(q, dq, dq, ddq), arm.grad_P_l(q), arm.M_l(q)
        if "payload_mass" in given and links.end_effector is not None:
            end_effector = replace(links.end_effector, gravity=turned_gravity(links, given))
            loaded = PayloadArm(arm, end_effector, p.payload_mass / p.payload, p.payload_position)
            inertial += loaded.inertial_torque_of_mass(q, dq, ddq)
            weight, M = loaded.grad_P_l(q), loaded.M_l(q)
        return ca.Function("links", [*motion, shares], [inertial + p.gravity * weight, M])

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

    def _refuse(self) -> None:
        """Raise ParameterError for an error that the robot cannot have."""
        links = self.robot.links
        for name in self._given:
            matrix = getattr(self.robot, MATRICES[name]) if name in MATRICES else np.zeros((1, 1))
            if name in CHAIN and not has_bodies(links):
                raise ParameterError(f"error '{name}' is given for an arm without bodies; expected a chain of bodies")
            if name == "payload_mass" and links.end_effector is None:
                raise ParameterError("error 'payload_mass' is given for an arm without an end effector; expected one")
            if name == "payload_position" and "payload_mass" not in self._given:
                raise ParameterError("error 'payload_position' is given alone; expected one with payload_mass")
            if not is_diagonal(matrix):
                raise ParameterError(f"error '{name}' is given for a matrix {MATRICES[name]} that is not diagonal")


def _checked(name: str, error: ArrayLike, numbers: int) -> Array:
    """Return the errors (numbers,) of a parameter."""
    size = floats(f"error '{name}'", error, ParameterError)
    limit = np.inf if DEVIATIONS[name].unit in ("kg", "m") else LARGEST
    if size.shape not in ((), (numbers,)):
        raise ParameterError(
            f"error '{name}' is {size.tolist()}; expected one number{f' or {numbers}' if numbers > 1 else ''}"
        )
    if not np.all((size >= 0) & (size <= limit) & np.isfinite(size)):
        raise ParameterError(f"error '{name}' is {size.tolist()}; expected 0 to {limit}")
    return np.broadcast_to(size, numbers).astype(float)
