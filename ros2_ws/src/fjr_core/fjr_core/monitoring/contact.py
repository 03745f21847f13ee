# SPDX-License-Identifier: Apache-2.0
"""Tell contact from the errors of the model that are stated: the threshold of the external torques while the arm moves.

The stated errors d are independent and standard normal, in units of their standard deviations. The torques that the
links need are linear in d, so the momentum observer (external_torque.py) of the model without them obeys exactly

    r = L(s) tau - Z d + v        dz_j/dt = L (dp_j/dt - f_j - z_j)        the same observer, of dp_l/dd_j and df/dd_j

with the noise v ~ N(0, N). Contact is where the Mahalanobis distance of what d does not explain exceeds its limit:

    e' S^-1 e > limit        e = r + Z d^,   S = Z P Z' + N

The mean d^ and the covariance P start from 0 and 1, and a Kalman filter improves them while there is no contact
(runtime/contact.c). So the threshold of a joint, sqrt(limit S_ii), is large where the motion shows an error that is not
known yet, and shrinks to that of the noise. A. De Luca, R. Mattone, ICRA 2005, compare r with constants.

The limit is the quantile of chi^2 at which a day has at most 0.355 wrong samples on average: then at most one false
alarm in 24 h has 95 % probability. A sum over all samples needs no independence of theirs.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from math import erfc, exp, gamma, sqrt
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ..model import springs
from ..model.rigid_arm import RigidArm
from ..model.robot import Robot
from ..numerics.checks import Array
from ..numerics.one_line import one_line
from ..numerics.parameter_field import VECTOR, parameter_field
from ..numerics.symbolic import dense_function, symbols
from ..runtime.library import TorqueObserverStruct
from ..simulation.deviations import ChangedLinks, has_bodies
from ..simulation.imperfections import freeze_within_ranges
from .external_torque import ExternalTorqueObserver, observer_function

DAY = 86_400_000
"""Samples of 24 h at 1 kHz."""
WRONG = 0.355
"""Mean of a Poisson distribution whose probability of 0 or 1 is 95 %."""
STICKING = 0.01
"""Speed [rad/s] below which the sign of Coulomb friction is uncertain."""
LEARNING_PERIOD = 3.0
"""Time between two updates of d^, in 1 / bandwidth: r then forgets its noise to 5 %."""
DRIFT = 600.0
"""Time [s] in which the errors may drift to others of the same distribution."""


def _stated(default: float, description: str, unit: str = "", minimum: float = 0.0) -> Any:
    return parameter_field(
        default, f"Standard deviation of {description}", unit, minimum=minimum, maximum=1e6, shape=VECTOR
    )


@dataclass(frozen=True, eq=False)
class StatedErrors:
    """Standard deviations of the errors of the model of n joints; each field is a scalar or (n,), stored as (n,).

    Shares are relative to the value of the model. Raises ParameterError unless all are at least 0, and the noise above.
    """

    n: int
    link_mass: ArrayLike = _stated(0.05, "mass and inertia of each link, as a share")
    joint_stiffness: ArrayLike = _stated(0.05, "joint_stiffness, as a share")
    link_damping: ArrayLike = _stated(0.3, "link_damping, as a share")
    link_coulomb_friction: ArrayLike = _stated(0.1, "the Coulomb friction of the links", "N m")
    link_torque: ArrayLike = _stated(0.1, "a constant torque on each link, as by an offset of an encoder", "N m")
    torque_noise: ArrayLike = _stated(0.1, "~/external_torque at standstill", "N m", 1e-9)

    __repr__ = one_line

    def __post_init__(self) -> None:
        freeze_within_ranges(self, self.n)

    @property
    def deviations(self) -> Array:
        """Standard deviations (m,) of the errors of the model, kind by kind."""
        return np.concatenate([np.asarray(getattr(self, each.name)) for each in fields(self)[1:-1]])


def chi_squared_quantile(n: int, beyond: float) -> float:
    """Return what chi^2 of n degrees exceeds with the probability `beyond`, by bisection; a node does without SciPy.

    P(chi^2 > 2 y) = erfc(sqrt(y)) (n odd) + exp(-y) sum_h y^h / Gamma(h + 1), h = n/2 - 1, n/2 - 2, .. >= 0
    (Abramowitz and Stegun 26.4.4, 26.4.5).
    """
    powers = [n / 2 - k for k in range(1, n // 2 + 1)]
    low, high = 0.0, 100.0 + 2 * n
    for _ in range(80):
        y = (low + high) / 2
        tail = exp(-y) * sum(y**h / gamma(h + 1) for h in powers) + (erfc(sqrt(y)) if n % 2 else 0.0)
        low, high = (y, high) if tail > beyond else (low, y)
    return low + high


class ContactObserver(ExternalTorqueObserver):
    """External torques r on the links and their derivatives -Z by the stated errors.

    Its function keeps (3 n (1 + m),): p_l with its derivatives by the m errors, column by column; their rates without
    tau; r and z [N m].
    """

    name = "contact"

    def __init__(self, robot: Robot, bandwidth: float, errors: StatedErrors, compile: bool = False) -> None:
        super().__init__(robot, bandwidth, compile)
        self.errors, self.stated = errors, str(errors.deviations.tolist())

    @cached_property
    def limit(self) -> float:
        """Square of the Mahalanobis distance beyond which there is contact."""
        return chi_squared_quantile(self.robot.n, WRONG / DAY)

    def struct(self, ffi: Any) -> TorqueObserverStruct:
        """Return the observer for C; ffi: with the types of step.h."""
        noise, period = np.asarray(self.errors.torque_noise), LEARNING_PERIOD / self.bandwidth
        return TorqueObserverStruct(ffi, self.function, self.bandwidth, noise, self.limit, period, DRIFT)

    def _function(self) -> ca.Function:
        size = self.robot.n * (1 + len(self.errors.deviations))
        return observer_function(self.name, self.robot.n, size, self.momenta)

    @cached_property
    def momenta(self) -> ca.Function:
        """The function (position, velocity) -> p_l and dp_l/dt - tau (n (1 + m),), with derivatives by columns."""
        n, robot = self.robot.n, self.robot
        s = symbols(position=2 * n, velocity=2 * n)
        q_l, dq_l, theta = s["position"][:n], s["velocity"][:n], ca.SX.sym("theta", len(self.errors.deviations))
        mass, stiffness, damping, friction, constant = ca.vertsplit(theta, n)
        links: RigidArm = robot.links
        common = 1 + mass[0]  # of links whose bodies are not known
        if has_bodies(robot.links):
            links, common = ChangedLinks(robot.links, {"link_mass": 1 + mass}), 1.0
        p = common * (links.M_l(q_l) @ dq_l)
        spring = springs.torque(robot, s["position"][n:] - q_l)
        f = common * (links.grad_T(q_l, dq_l) - links.grad_P_l(q_l))
        f += (1 + stiffness) * spring - (1 + damping) * (ca.DM(robot.D_l) @ dq_l)
        f += constant - friction * ca.tanh(dq_l / STICKING)
        by = ca.substitute(ca.jacobian(ca.vertcat(p, f), theta), theta, 0)
        by = by @ ca.diag(ca.DM(self.errors.deviations))
        nominal = ca.substitute(ca.vertcat(p, f), theta, 0)
        outputs = {"p": ca.horzcat(nominal[:n], by[:n, :]), "f": ca.horzcat(nominal[n:], by[n:, :])}
        return dense_function("contact_momenta", s, {name: ca.vec(each) for name, each in outputs.items()}, cse=True)
