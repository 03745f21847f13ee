# SPDX-License-Identifier: Apache-2.0
"""Fisher information that a periodic motion gives about the parameters of each elastic joint.

The exact equations of both sides are the residuals, in the parameters p = (log K, offset, D_l, f_l, log M_m, D_m, f_m):

    r_l = K (q_m - q_l - offset) - tau(q_l)            tau includes D_l dq_l + f_l tanh(dq_l / v0)
    r_m = u - M_m ddq_m - D_m dq_m - f_m tanh(dq_m / v0) - K (q_m - q_l - offset)

White noise of both encoders enters r at the angular frequency w through A(w), noise of the effort enters r_m:

    S(w) = A diag(s_l^2, s_m^2) A' + diag(0, s_u^2),    A = [[M_l w^2 - K, K], [K, M_m w^2 - K]]

The information of a record of N samples is F = N mean(J' S^-1 J), J = dr/dp, with S^-1 applied to each frequency of J.
A is singular at w = 0, where known efforts reveal friction and weight, and at the resonance of the joint, so both
reveal much as far as s_u permits. M_l is the mean diagonal of the link inertia; damping and the coupling of joints are
neglected in A, and the links (M_l, gravity) are known. F^-1 is then the Cramer-Rao bound of the covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fjr_core.numerics.checks import Array

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
EMPHASIS = 4.0
"""Weight of the stiffness beyond its share in log det F: the law depends on it most, and it is known least."""
_LINK, _MOTOR = 0, 1


@dataclass(frozen=True, eq=False)
class JointNoise:
    """Noise of n joints: of the encoders link, motor (n,) [rad], of the effort (n,) [N m], per sample and white."""

    link: Array
    motor: Array
    effort: Array


@dataclass(frozen=True, eq=False)
class JointMotion:
    """Motion along one period at k instants of n joints, each (k, n): what the regressors consist of."""

    torque: Array  # of the spring, tau [N m]
    dq_l: Array
    dq_m: Array
    ddq_m: Array


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

    def matrices(self, motion: JointMotion) -> Array:
        """Return the information matrices F (n, 7, 7)."""
        J = self._regressors(motion)
        return _products(J, self._whitened(J))

    def criterion(self, motion: JointMotion, emphasis: Array) -> tuple[float, JointMotion]:
        """Return the sum of log det F + emphasis log 1 / var(log K) over the joints, and its gradient in the motion."""
        J = self._regressors(motion)
        filtered = self._whitened(J)
        F = _products(J, filtered)
        C = np.linalg.inv(F)
        value = np.linalg.slogdet(F)[1] - emphasis * np.log(C[:, 0, 0])
        weight = C + emphasis[:, None, None] * C[:, :, :1] * C[:, :1, :] / C[:, :1, :1]
        slope = 2 * np.einsum("eknp,npq->eknq", filtered, weight)
        return float(value.sum()), self._chained(slope, motion)

    def deviations(self, motion: JointMotion) -> Array:
        """Return the Cramer-Rao bounds (n, 7) of the standard deviations; those of K and M_m are relative."""
        variances = np.diagonal(np.linalg.inv(self.matrices(motion)), axis1=1, axis2=2)
        return np.asarray(np.sqrt(variances), dtype=float)

    def _regressors(self, m: JointMotion) -> Array:
        """Return J (2, k, n, 7) of the residuals r_l and r_m."""
        J = np.zeros((2, *m.torque.shape, len(PARAMETERS)))
        J[_LINK, ..., 0], J[_LINK, ..., 1] = m.torque, -self.K
        J[_LINK, ..., 2], J[_LINK, ..., 3] = -m.dq_l, -np.tanh(m.dq_l / SMOOTHING)
        J[_MOTOR, ..., 0], J[_MOTOR, ..., 1] = -m.torque, self.K
        J[_MOTOR, ..., 4], J[_MOTOR, ..., 5] = -self.M_m * m.ddq_m, -m.dq_m
        J[_MOTOR, ..., 6] = -np.tanh(m.dq_m / SMOOTHING)
        return J

    def _chained(self, slope: Array, m: JointMotion) -> JointMotion:
        """Return the derivative with respect to the motion of a function with derivative `slope` in J."""
        bend_l, bend_m = (np.cosh(np.clip(v / SMOOTHING, -50, 50)) ** -2 / SMOOTHING for v in (m.dq_l, m.dq_m))
        return JointMotion(
            slope[_LINK, ..., 0] - slope[_MOTOR, ..., 0],
            -slope[_LINK, ..., 2] - bend_l * slope[_LINK, ..., 3],
            -slope[_MOTOR, ..., 5] - bend_m * slope[_MOTOR, ..., 6],
            -self.M_m * slope[_MOTOR, ..., 4],
        )

    def _whitened(self, J: Array) -> Array:
        """Return N / k S^-1 J (2, k, n, 7): the weights of each frequency, applied to the regressors."""
        k = J.shape[1]
        spectrum = np.fft.rfft(J, axis=1)
        weighted = np.einsum("fnab,bfnp->afnp", self._weights(k), spectrum)
        return np.asarray(np.fft.irfft(weighted, k, axis=1) * (self.samples / k), dtype=float)

    def _weights(self, k: int) -> Array:
        """Return S^-1 (k // 2 + 1, n, 2, 2) at the frequencies of k instants of a period."""
        w2 = (2 * np.pi * np.arange(k // 2 + 1) / self.period)[:, None] ** 2
        A = np.empty((*np.broadcast_shapes(w2.shape, self.K.shape), 2, 2))
        A[..., 0, 0], A[..., 1, 1] = self.M_l * w2 - self.K, self.M_m * w2 - self.K
        A[..., 0, 1] = A[..., 1, 0] = self.K
        S = A * np.stack([self.noise.link, self.noise.motor], axis=-1)[:, None, :] ** 2 @ np.swapaxes(A, -1, -2)
        S[..., 1, 1] += self.noise.effort**2
        return np.asarray(np.linalg.inv(S), dtype=float)


def _products(J: Array, filtered: Array) -> Array:
    """Return J' S^-1 J (n, 7, 7)."""
    return np.asarray(np.einsum("eknp,eknq->npq", J, filtered))


def encoder_noise(bits: Array, white: Array, least: float) -> Array:
    """Return the standard deviation (n,) [rad] of encoders of these bits per turn (0: exact) and white noise.

    A step D of quantisation counts as noise of D / sqrt(12). least [rad]: where both are zero.
    """
    step: NDArray[np.float64] = np.where(bits > 0, 2 * np.pi / 2.0**bits, 0.0)
    return np.maximum(np.hypot(white, step / np.sqrt(12)), least)
