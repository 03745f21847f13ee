# SPDX-License-Identifier: Apache-2.0
"""How a robot, its sensors or its loop may differ from the model: one glossary for studies, errors and stated errors.

A sweep draws them under `vary`, `fjr check --error` bounds what their largest errors do, `robot.deviations` in a robot
file states their standard deviations, an identification has a posterior of those that it finds. Everywhere the factor
1.2, or the error 0.2, of `link_mass` at joint 2 is 20 % more mass of that link.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

from ..model.newton_euler import ChainAt, Mass
from ..model.rigid_arm import ArmDynamics
from ..numerics.parameter_field import declared
from .imperfections import Imperfections

POSITIVE, NONNEGATIVE, SIGNED = "positive", "non-negative", "signed"
JOINT, RUN, DIRECTION, POINT = 0, 1, 2, 3
"""Numbers of a deviation; 0: one for each joint."""


@dataclass(frozen=True)
class Deviation:
    """One way in which a robot, its sensors or its loop differ from the model.

    of: what it changes, in a sentence. unit: of a level; "" for a factor on the values of the model. sign: which values
    are allowed. per: JOINT if the value may differ between joints, RUN for one number, DIRECTION for two angles, POINT
    for x, y, z. nominal: value of the model. matrix: of a Robot whose diagonal the factor scales. parameter: its name
    in a robot file, a scenario and an identification, "" for none.
    """

    name: str
    of: str
    unit: str = ""
    sign: str = NONNEGATIVE
    per: int = JOINT
    nominal: float = 0.0
    matrix: str = ""
    parameter: str = ""

    @property
    def is_factor(self) -> bool:
        """Return whether the value is a factor, not a level."""
        return not self.unit

    @property
    def per_run(self) -> bool:
        """Return whether a run has one number."""
        return self.per == RUN

    def width(self, n: int) -> int:
        """Return the numbers of a robot of n joints."""
        return self.per or n


def _factor(name: str, of: str, sign: str = POSITIVE, per: int = JOINT, matrix: str = "", own: str = "") -> Deviation:
    return Deviation(name, of, "", sign, per, 1.0, matrix, own)


def _of_plant(name: str, of: str, sign: str = NONNEGATIVE, per: int = JOINT) -> Deviation:
    """Return the deviation that is an imperfection of the plant, with its unit, default and name of a parameter."""
    own = declared(Imperfections)[name]
    return Deviation(name, of, own.unit, sign, per, own.default, parameter=own.name)  # type: ignore[arg-type]


DEVIATIONS = {
    each.name: each
    for each in (
        _factor("payload", "all link masses and inertias", per=RUN),
        _of_plant("payload_mass", "a mass at the last link", per=RUN),
        _of_plant("payload_position", "its place", SIGNED, POINT),
        _factor("link_mass", "mass and inertia of each link", own="link_mass"),
        _factor("link_central_inertia", "inertia of each link about its centre of mass"),
        _factor("link_inertia", "the inertia matrix of the links, without their weight"),
        _factor("gravity", "gravity", SIGNED),
        Deviation("gravity_direction", "the direction of gravity", "rad", SIGNED, DIRECTION),
        _factor("stiffness", "each joint stiffness", matrix="K", own="joint_stiffness"),
        _factor("motor_inertia", "each motor inertia", matrix="M_m", own="motor_inertia"),
        _factor("link_damping", "each link damping", NONNEGATIVE, matrix="D_l", own="link_damping"),
        _factor("motor_damping", "each motor damping", NONNEGATIVE, matrix="D_m", own="motor_damping"),
        _of_plant("coulomb_l", "Coulomb friction of the links"),
        _of_plant("coulomb_m", "Coulomb friction of the motors"),
        _of_plant("smoothing", "the smoothing velocity of friction", POSITIVE, RUN),
        Deviation("link_torque", "link torques", "N m", SIGNED, parameter="link_torque"),
        Deviation("motor_torque", "motor torques", "N m", SIGNED),
        _of_plant("cubic", "cubic stiffness beside the curve of the springs", SIGNED),
        _of_plant("hysteresis", "the torque at which a Maxwell element beside a spring slips"),
        _of_plant("slip", "the deflection at which it slips", POSITIVE),
        Deviation("delay", "the delay from a sample to its effort", "s", per=RUN, parameter="effort_delay"),
        Deviation("position_noise", "white noise of positions", "rad", per=RUN),
        Deviation("velocity_noise", "white noise of velocities", "rad/s", per=RUN),
        Deviation("resolution", "the step of the encoders", "rad", per=RUN),
        _of_plant("effort_limit", "the limit of commands, known to the law", POSITIVE),
    )
}
"""The glossary: all deviations by name."""
MATRICES = {each.name: each.matrix for each in DEVIATIONS.values() if each.matrix}
"""Matrices of a robot whose diagonals factors scale."""
CHAIN = ("link_mass", "link_central_inertia", "gravity_direction")
"""Deviations of the bodies of an arm."""


def has_bodies(links: ArmDynamics) -> bool:
    """Return whether the bodies of an arm are known, which the deviations of CHAIN need."""
    return bool(links.bodies) and links.end_effector is not None


class ChangedLinks:
    """A chain with the deviations CHAIN, as expressions; those that are not given are as in the model.

    deviations: by name, factors (n,) by joint of the robot. Gravity is turned by two angles [rad] about the axes normal
    to it.
    """

    def __init__(self, links: ArmDynamics, deviations: Mapping[str, ca.SX]) -> None:
        self._links, self._order = links, list(links.order)
        self._along = [self._order.index(i) for i in range(links.n)]
        one = ca.DM.ones(links.n)
        mass, central = (deviations.get(name, one)[self._along] for name in CHAIN[:2])
        self._masses = []
        for i, body in enumerate(links.bodies):
            com, inertia = np.asarray(body.com), np.asarray(body.inertia)
            second, m = np.trace(inertia) / 2 * np.eye(3) - inertia, ca.SX(mass[i])
            J = m * (central[i] * ca.SX(second) + ca.SX(body.mass * np.outer(com, com)))
            self._masses.append(Mass(m * body.mass, m * ca.SX(body.mass * com), J))
        self.gravity = turned_gravity(links, deviations)

    def M_l(self, q_l: ca.SX) -> ca.SX:
        """Inertia M_l (n, n) [kg m^2]."""
        return self._at(q_l).inertia()[self._order, self._order]

    def P_l(self, q_l: ca.SX) -> ca.SX:
        """Potential energy P_l [J]."""
        return self._at(q_l).potential_energy()

    def grad_P_l(self, q_l: ca.SX) -> ca.SX:
        """Gravity torque grad P_l (n,) [N m]."""
        return self._at(q_l).gravity_torque()[self._order]

    def grad_T(self, q_l: ca.SX, v: ca.SX) -> ca.SX:
        """d/dq_l (v' M_l v / 2) (n,) [N m], v constant."""
        return self._at(q_l).kinetic_gradient(v[self._along])[self._order]

    def inertial_torque(self, q_l: ca.SX, v: ca.SX, w: ca.SX, a: ca.SX) -> ca.SX:
        """M_l a + C(q_l, v) w (n,) [N m]."""
        return self._at(q_l).inertial_torque(*(each[self._along] for each in (v, w, a)))[self._order]

    def _at(self, q_l: ca.SX) -> ChainAt:
        return ChainAt(self._links.bodies, self._masses, self.gravity, q_l[self._along])


def turned_gravity(links: ArmDynamics, deviations: Mapping[str, ca.SX]) -> ca.SX:
    """Return gravity (3,) [m/s^2] in the base frame, turned by `gravity_direction` (2,) [rad] if it is given.

    The angles are about two axes normal to gravity. Links without an end effector, or gravity, have none.
    """
    gravity = np.zeros(3) if links.end_effector is None else links.end_effector.gravity
    if "gravity_direction" not in deviations or not gravity.any():
        return ca.SX(ca.DM(gravity))
    size, (x, y) = np.linalg.norm(gravity), np.linalg.svd(gravity[None, :])[2][1:]
    a, b = ca.vertsplit(deviations["gravity_direction"])
    turned = ca.vertcat(ca.sin(b), -ca.sin(a) * ca.cos(b), ca.cos(a) * ca.cos(b))
    return ca.DM(size * np.column_stack([x, y, gravity / size])) @ turned
