# SPDX-License-Identifier: Apache-2.0
"""A motion of both sides of the springs: its limits, and the Fisher information that it gives about each joint.

The exact equations of both sides are the residuals, in the parameters p = (log K, offset, D_l, f_l, log M_m, D_m, f_m):

    r_l = K (q_m - q_l - offset) - tau(q_l)            tau includes D_l dq_l + f_l tanh(dq_l / v0)
    r_m = u - M_m ddq_m - D_m dq_m - f_m tanh(dq_m / v0) - K (q_m - q_l - offset)

White noise of both encoders enters r at the angular frequency w through A(w), noise of the effort enters r_m:

    S(w) = A diag(s_l^2, s_m^2) A' + diag(0, s_u^2),    A = [[M_l w^2 - K, K], [K, M_m w^2 - K]]

The information of a record of N samples is F = N mean(J' S^-1 J), J = dr/dp, with S^-1 applied to each frequency of J.
On a curve (model.springs), log K is that of a factor on the whole curve, and K elsewhere its mean tangent up to the
torque limit. A is singular at w = 0, where known efforts reveal friction and weight, and at the resonance of the joint,
so both reveal much as far as s_u permits. M_l is the mean diagonal of the link inertia; damping and the coupling of
joints are neglected in A, and the links (M_l, gravity) are known. F^-1 is then the Cramer-Rao bound of the covariance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from fjr_core.errors import TrajectoryError
from fjr_core.model import springs
from fjr_core.model.robot import Robot
from fjr_core.motions.inverse_dynamics import inverse_dynamics
from fjr_core.motions.reference import JETS, Reference
from fjr_core.numerics.checks import Array
from fjr_core.runtime.safety_settings import Settings

from ..estimation.elastic_arm import coulomb

INSTANTS = 2000  # of a reference that stands for missing limits
ACCELERATION = 0.99  # of the limit, which the reference has to keep, not the robot
RESTING = 1e-6  # rad, rad/s, N m; range of a quantity that does not move
COMPLETED = {"q_l": "position", "dq_l": "velocity", "u": "effort"}
PARAMETERS = (
    "joint_stiffness",
    "offset",
    "link_damping",
    "link_coulomb_friction",
    "motor_inertia",
    "motor_damping",
    "motor_coulomb_friction",
)
"""Order of p; of stiffness and motor inertia the logarithm."""
SMOOTHING = 0.05  # rad/s; v0 of the friction regressors
_LINK, _MOTOR = 0, 1


class ElasticMotion(NamedTuple):
    """Motion of n elastic joints at k instants, each (k, n): what limits and information depend on."""

    q_l: Array  # [rad]
    dq_l: Array  # [rad/s]
    ddq_l: Array  # [rad/s^2]
    torque: Array  # of the springs [N m]
    q_m: Array  # [rad]
    dq_m: Array  # [rad/s]
    ddq_m: Array  # [rad/s^2]
    u: Array  # effort [N m]


QUANTITIES = ElasticMotion._fields


def motion_function(robot: Robot) -> ca.Function:
    """Return the function of q .. d4q (5 n,) of the links with the QUANTITIES (8 n,) as its value."""
    jets = ca.SX.sym("jets", JETS * robot.n)
    q, dq, ddq, *others = ca.vertsplit(jets, robot.n)
    *motors, torque = inverse_dynamics(robot)(q, dq, ddq, *others)
    motion = ca.vertcat(q, dq, ddq, *motors, ca.DM(np.linalg.inv(robot.B_m)) @ torque)
    return ca.Function("elastic_motion", [jets], [ca.densify(motion)], {"cse": True})


def elastic_motion(robot: Robot, jets: Array, function: ca.Function | None = None) -> ElasticMotion:
    """Return the motion of both sides along jets (k, 5, n) of the links.

    function: of the robot for k instants, where it was prepared for many calls.
    """
    motion = (function or motion_function(robot).map(len(jets)))(jets.reshape(len(jets), -1).T).full().T
    return ElasticMotion(*np.split(motion, len(QUANTITIES), axis=1))


@dataclass(frozen=True, eq=False)
class MotionEnvelope:
    """Lower and upper limits (8, n) of QUANTITIES, infinite on both sides for none."""

    lower: Array
    upper: Array

    @cached_property
    def middle(self) -> Array:
        """Middle (8, n) of the limits, 0 without."""
        bounded = np.isfinite(self.upper)
        return (np.where(bounded, self.lower, 0.0) + np.where(bounded, self.upper, 0.0)) / 2

    @cached_property
    def slope(self) -> Array:
        """Derivative (8, 1, n) of the ratios: the inverse of half the distance of the limits."""
        return np.asarray(2.0 / (self.upper - self.lower)[:, None])

    def ratios(self, values: Array) -> Array:
        """Return the distance of values (8, k, n) from the middle, from -1 to 1 within the limits; 0 without."""
        return np.asarray((values - self.middle[:, None]) * self.slope)

    def keeps(self, motion: ElasticMotion) -> bool:
        """Return whether a motion is within the limits."""
        return bool(np.abs(self.ratios(np.stack(motion))).max() <= 1.0)


def motion_envelope(
    robot: Robot, settings: Settings, acceleration: Array, reference: Reference, share: float, horizon: float
) -> MotionEnvelope:
    """Return the part `share` of the limits of settings and robot, and those of acceleration (n,) [rad/s^2].

    Where position, speed or effort of a joint have no limit, the extremes of the reference in `horizon` [s] stand for
    it, undiminished. Motor positions count if both sides are limited. Raises TrajectoryError if the reference rests
    where it must stand for a limit.
    """
    held = settings if robot.limits is None else settings.tightened(robot.limits)
    none, torque = np.full(robot.n, np.inf), np.diag(robot.K) * np.asarray(held.deflection)
    if robot.curve:
        deflection = np.where(np.isfinite(torque), held.deflection, 0.0)
        torque = np.where(np.isfinite(torque), springs.torques(robot, deflection[None])[0], np.inf)
    acceleration = ACCELERATION / share * acceleration
    links, motors = (none, held.link_velocity, acceleration, torque), (none, held.motor_velocity, none, held.effort)
    upper = np.stack([*links, *motors])
    lower = -upper
    for row, side in ((0, "link"), (4, "motor")):
        ends = np.stack([getattr(held, f"{side}_position_{end}") for end in ("lower", "upper")])
        lower[row], upper[row] = np.where(np.isfinite(ends).all(axis=0), ends, [-none, none])
    middle = MotionEnvelope(lower, upper).middle
    shrunk = MotionEnvelope(middle + share * (lower - middle), middle + share * (upper - middle))
    return _completed(shrunk, robot, reference, horizon, settings.joints)


def _completed(
    given: MotionEnvelope, robot: Robot, reference: Reference, horizon: float, joints: Sequence[str]
) -> MotionEnvelope:
    """Return the envelope with the extremes of the reference in place of missing limits."""
    lower, upper = given.lower.copy(), given.upper.copy()
    motion = elastic_motion(robot, np.asarray(reference.jets(np.linspace(0.0, min(horizon, reference.end), INSTANTS))))
    for name in COMPLETED:
        values, row = getattr(motion, name), QUANTITIES.index(name)
        peak = np.abs(values).max(axis=0)
        low, high = (values.min(axis=0), values.max(axis=0)) if name == "q_l" else (-peak, peak)
        missing = ~np.isfinite(upper[row])
        if np.any(still := missing & ~(high - low > RESTING)):
            raise TrajectoryError(
                f"joint '{joints[int(np.argmax(still))]}' has no {COMPLETED[name]} limit and rests along the "
                "reference; expected limits.* or a moving reference"
            )
        lower[row], upper[row] = np.where(missing, low, lower[row]), np.where(missing, high, upper[row])
    return MotionEnvelope(lower, upper)


@dataclass(frozen=True, eq=False)
class JointNoise:
    """Noise of n joints: of the encoders link, motor (n,) [rad], of the effort (n,) [N m], per sample and white."""

    link: Array
    motor: Array
    effort: Array


def encoder_noise(bits: Array, white: Array, least: float) -> Array:
    """Return the standard deviation (n,) [rad] of encoders of these bits per turn (0: exact) and white noise.

    A step D of quantisation counts as noise of D / sqrt(12). least [rad]: where both are zero.
    """
    step: NDArray[np.float64] = np.where(bits > 0, 2 * np.pi / 2.0**bits, 0.0)
    return np.maximum(np.hypot(white, step / np.sqrt(12)), least)


@dataclass(frozen=True, eq=False)
class InformationModel:
    """Elastic joints K, M_m and mean link inertia M_l, each (n,), their noise, and the period [s] of k instants.

    samples: number N of samples of the record.
    """

    K: Array
    M_m: Array
    M_l: Array
    noise: JointNoise
    period: float
    samples: int

    def matrices(self, motion: ElasticMotion) -> Array:
        """Return the information matrices F (n, 7, 7)."""
        J = self._regressors(motion)
        return _products(J, self._whitened(J))

    def criterion(self, motion: ElasticMotion, emphasis: Array) -> tuple[float, Array]:
        """Return the sum of log det F + emphasis log 1 / var(log K) over the joints, and its gradient (8, k, n).

        The gradient is by QUANTITIES of the motion.
        """
        J = self._regressors(motion)
        whitened = self._whitened(J)
        F = _products(J, whitened)
        C = np.linalg.inv(F)
        value = np.linalg.slogdet(F)[1] - emphasis * np.log(C[:, 0, 0])
        weight = C + emphasis[:, None, None] * C[:, :, :1] * C[:, :1, :] / C[:, :1, :1]
        return float(value.sum()), self._chained(2 * np.einsum("eknp,npq->eknq", whitened, weight), motion)

    def deviations(self, motion: ElasticMotion) -> Array:
        """Return the Cramer-Rao bounds (n, 7) of the standard deviations; those of K and M_m are relative."""
        variances = np.diagonal(np.linalg.inv(self.matrices(motion)), axis1=1, axis2=2)
        return np.asarray(np.sqrt(variances), dtype=float)

    def _regressors(self, m: ElasticMotion) -> Array:
        """Return J (2, k, n, 7) of the residuals r_l and r_m."""
        J = np.zeros((2, *m.torque.shape, len(PARAMETERS)))
        J[_LINK, ..., 0], J[_LINK, ..., 1] = m.torque, -self.K
        J[_LINK, ..., 2], J[_LINK, ..., 3] = -m.dq_l, -coulomb(m.dq_l, SMOOTHING)
        J[_MOTOR, ..., 0], J[_MOTOR, ..., 1] = -m.torque, self.K
        J[_MOTOR, ..., 4], J[_MOTOR, ..., 5] = -self.M_m * m.ddq_m, -m.dq_m
        J[_MOTOR, ..., 6] = -coulomb(m.dq_m, SMOOTHING)
        return J

    def _chained(self, slope: Array, m: ElasticMotion) -> Array:
        """Return the derivative (8, k, n) by QUANTITIES of a function with derivative `slope` in J."""
        bend_l, bend_m = (np.cosh(np.clip(v / SMOOTHING, -50, 50)) ** -2 / SMOOTHING for v in (m.dq_l, m.dq_m))
        by = {
            "torque": slope[_LINK, ..., 0] - slope[_MOTOR, ..., 0],
            "dq_l": -slope[_LINK, ..., 2] - bend_l * slope[_LINK, ..., 3],
            "dq_m": -slope[_MOTOR, ..., 5] - bend_m * slope[_MOTOR, ..., 6],
            "ddq_m": -self.M_m * slope[_MOTOR, ..., 4],
        }
        return np.stack([by.get(name, np.zeros_like(m.torque)) for name in QUANTITIES])

    def _whitened(self, J: Array) -> Array:
        """Return N / k S^-1 J (2, k, n, 7): the weights of each frequency, applied to the regressors."""
        k = J.shape[1]
        w2 = (2 * np.pi * np.arange(k // 2 + 1) / self.period)[:, None] ** 2
        A = np.empty((*np.broadcast_shapes(w2.shape, self.K.shape), 2, 2))
        A[..., 0, 0], A[..., 1, 1] = self.M_l * w2 - self.K, self.M_m * w2 - self.K
        A[..., 0, 1] = A[..., 1, 0] = self.K
        S = A * np.stack([self.noise.link, self.noise.motor], axis=-1)[:, None, :] ** 2 @ np.swapaxes(A, -1, -2)
        S[..., 1, 1] += self.noise.effort**2
        weighted = np.einsum("fnab,bfnp->afnp", np.linalg.inv(S), np.fft.rfft(J, axis=1))
        return np.asarray(np.fft.irfft(weighted, k, axis=1) * (self.samples / k), dtype=float)


def _products(J: Array, whitened: Array) -> Array:
    """Return J' S^-1 J (n, 7, 7)."""
    return np.asarray(np.einsum("eknp,eknq->npq", J, whitened))
