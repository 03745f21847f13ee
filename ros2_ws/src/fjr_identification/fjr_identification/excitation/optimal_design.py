# SPDX-License-Identifier: Apache-2.0
"""Design the motion of a record from which the parameters of elastic joints are known best: D-optimal, within limits.

The reference is a finite Fourier series in each joint, at rest at the start and the end of each period. Its free
coefficients maximise log det of the Fisher information (`elastic_motion`) of stiffness, offset, rotor inertia, friction
and damping over the record, along the inverse dynamics of the flexible-joint robot, by L-BFGS-B with exact gradients
from a few random starts, of which the one with the largest least gain in stiffness is kept. Limits enter as a quadratic
penalty; the result is then scaled about its offset until it keeps them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from fjr_core.errors import TrajectoryError
from fjr_core.model.robot import Robot
from fjr_core.motions.reference import JETS, Reference
from fjr_core.motions.sine import MultiSine
from fjr_core.numerics.checks import Array
from fjr_core.numerics.jit import compiled

from ..estimation.parameters import prior_of
from .elastic_motion import InformationModel, JointNoise, MotionEnvelope, elastic_motion, motion_function

LONGEST_PERIOD = 10.0  # s
HARMONICS = 10  # of the series, at most
BELOW_RESONANCE = 0.7  # highest frequency, as a fraction of the lowest spring resonance
SAMPLES_PER_CYCLE = 25.0  # least samples of the loop per cycle of the highest frequency
INSTANTS_PER_CYCLE = 4  # of the highest frequency, at which a motion is evaluated in the search
FEWEST_INSTANTS = 256  # of a period
STARTS = 3  # of the search, random
PENALTIES, FINAL_PENALTY = (1e3, 1e4), 1e5  # weights of the excess in the search from each start, and from the best
STEPS = 80  # of L-BFGS-B per weight
ROUNDS = 3  # of the search from the best motion, with more emphasis on the joints whose stiffness gains least
START = 0.1  # of the acceleration that random coefficients may ask for
FINE = 8  # times as many instants when limits are checked
HALVINGS = 40  # of the interval of the factor that keeps the limits
POSES = 64  # configurations whose mean link inertia counts
FEWEST = 3  # harmonics with which sines and cosines can start at rest and still move
EMPHASIS = 4.0
"""Weight of the stiffness beyond its share in log det F: the law depends on it most, and it is known least."""


@dataclass(frozen=True, eq=False)
class Excitation:
    """A designed reference of `duration` [s], which rests at 0 and at each multiple of `period` [s].

    deviations, before (n, 7): Cramer-Rao bounds of the standard deviations of elastic_motion.PARAMETERS, of this motion
    and of the reference it was compared with; those of stiffness and motor inertia are relative.
    """

    reference: MultiSine
    duration: float
    period: float
    deviations: Array
    before: Array


def design(
    robot: Robot,
    limits: MotionEnvelope,
    noise: JointNoise,
    before: Reference,
    duration: float,
    sample_period: float,
    seed: int = 0,
) -> Excitation:
    """Return the motion of `duration` [s] within the limits that determines the parameters of the joints best.

    before: reference whose information is compared, over the same duration and with the same noise. seed: of the random
    starts. Raises TrajectoryError if no motion keeps the limits, ParameterError for coupled joints.
    """
    prior_of(robot)  # as identification does, it refuses matrices that are not diagonal
    task = ExcitationDesign(robot, limits, noise, duration, sample_period)
    bounds, rng = task.deviations(before), np.random.default_rng(seed)
    best, most = None, 0.0
    for _ in range(STARTS):
        c = task.start(rng)
        for weight in PENALTIES:
            c = task.improved(c, weight)
        if (gain := task.least_gain(c, bounds)) > most:
            best, most = c, gain
    if best is None:
        raise TrajectoryError(
            f"no motion of {STARTS} random starts keeps the limits; expected wider limits or a lighter arm"
        )
    for _ in range(ROUNDS):
        gains = task.gains(best, bounds)
        refined = task.improved(best, FINAL_PENALTY, EMPHASIS * gains.max() / gains)
        if (least := task.least_gain(refined, bounds)) <= most:
            break
        best, most = refined, least
    reference = task.series.reference(task.within(best))
    return Excitation(reference, duration, task.series.period, task.deviations(reference), bounds)


@dataclass(frozen=True, eq=False)
class ExcitationDesign:
    """Search of the free coefficients c (size, n) of a RestingSeries in each joint."""

    robot: Robot
    limits: MotionEnvelope
    noise: JointNoise
    duration: float
    sample_period: float

    @cached_property
    def series(self) -> RestingSeries:
        """Harmonics on a logarithmic scale up to the highest frequency that springs and loop permit.

        Raises TrajectoryError if the record is too short for three of them.
        """
        period = self.duration / max(1, np.ceil(self.duration / LONGEST_PERIOD))
        M_m, softest = np.diag(self.robot.M_m), np.diag(self.robot.K)
        if self.robot.torsion is not None:
            softest = np.array([np.min(of.stiffness) for of in self.robot.curves])
        resonance = BELOW_RESONANCE * float(np.sqrt(softest * (1 / self._M_l + 1 / M_m)).min())
        highest = min(resonance / (2 * np.pi), 1 / (SAMPLES_PER_CYCLE * self.sample_period))
        if highest * period < FEWEST:
            raise TrajectoryError(
                f"the record lasts {self.duration:g} s; expected at least {FEWEST / highest:.3g} s, {FEWEST} cycles of "
                f"the highest frequency of {highest:.3g} Hz"
            )
        return RestingSeries(period, logarithmic_harmonics(int(highest * period), HARMONICS))

    @cached_property
    def model(self) -> InformationModel:
        """Information of the whole record, from the instants of one period."""
        K, samples = np.diag(self.robot.K), round(self.duration / self.sample_period)
        if self.robot.curve:
            most = np.minimum(self.limits.upper[3], np.abs(self.robot.B_m) @ self.limits.upper[7])  # spring, motor
            K = most / self.robot.deflection(most)
        return InformationModel(K, np.diag(self.robot.M_m), self._M_l, self.noise, self.series.period, samples)

    @cached_property
    def _M_l(self) -> Array:
        """Mean diagonal of the link inertia at positions spread evenly within the limits."""
        poses = np.random.default_rng(0).uniform(self.limits.lower[0], self.limits.upper[0], (POSES, self.robot.n))
        return np.mean([np.diag(self.robot.M_l(q_l)) for q_l in poses], axis=0)

    @cached_property
    def _instants(self) -> Array:
        k = max(FEWEST_INSTANTS, INSTANTS_PER_CYCLE * self.series.harmonics[-1])
        return np.arange(k) * self.series.period / k

    @cached_property
    def _basis(self) -> Array:
        return self.series.jet_basis(self._instants)

    def start(self, rng: np.random.Generator) -> Array:
        """Return random coefficients of small accelerations about a random position in the middle half of the range."""
        c = START * self._scale() * rng.standard_normal((self.series.size, self.robot.n))
        c[-1] = self.limits.middle[0] + 0.5 * self._scale()[-1] * rng.uniform(-1, 1, self.robot.n)
        return c

    def improved(self, coefficients: Array, weight: float, emphasis: ArrayLike = EMPHASIS) -> Array:
        """Return coefficients of a locally largest criterion minus weight times the mean squared excess.

        emphasis: scalar or (n,), on the stiffness of each joint.
        """
        from scipy.optimize import minimize  # loaded on use: see law/gains.py

        scale, emphasised = self._scale(), np.broadcast_to(np.asarray(emphasis, float), self.robot.n)

        def loss(x: Array) -> tuple[float, Array]:
            value, slope = self._loss(x.reshape(coefficients.shape) * scale, weight, emphasised)
            return value, (slope * scale).ravel()

        options = {"maxiter": STEPS, "maxcor": 30}
        best = minimize(loss, (coefficients / scale).ravel(), jac=True, method="L-BFGS-B", options=options)
        return np.asarray(best.x.reshape(coefficients.shape) * scale)

    def _scale(self) -> Array:
        """Return the size (size, n) of coefficients: an acceleration, and for the offset half the range."""
        peak = np.minimum(self.limits.upper[2], self.limits.upper[1] * 2 * np.pi)
        scale = np.tile(peak / np.sqrt(self.series.size), (self.series.size, 1))
        scale[-1] = (self.limits.upper[0] - self.limits.lower[0]) / 2
        return scale

    def _loss(self, c: Array, weight: float, emphasis: Array) -> tuple[float, Array]:
        """Return the loss of coefficients and its gradient (size, n)."""
        jets = (self._basis @ c).swapaxes(0, 1)
        motion = elastic_motion(self.robot, jets, self._motion)
        information, rate = self.model.criterion(motion, emphasis)
        ratios, k = self.limits.ratios(np.stack(motion)), len(jets)
        over = np.sign(ratios) * np.maximum(np.abs(ratios) - 1.0, 0.0)
        loss = -information + weight * float((over**2).sum()) / k
        slope = 2 * weight / k * over * self.limits.slope - rate  # by the motion (8, k, n)
        columns = (each.reshape(k, -1).T for each in (jets, slope.swapaxes(0, 1)))
        by_jets = self._adjoint(*columns).full().T.reshape(jets.shape)
        return loss, np.asarray(np.tensordot(self._basis, by_jets, ((0, 1), (1, 0))), float)

    @cached_property
    def _motion(self) -> ca.Function:
        return compiled(motion_function(self.robot)).map(len(self._instants))

    @cached_property
    def _adjoint(self) -> ca.Function:
        """Build (q .. d4q, derivative by the motion (8 n,)) -> derivative by q .. d4q (5 n,), at all instants."""
        motion = motion_function(self.robot)
        jets, slope = ca.SX.sym("jets", motion.size1_in(0)), ca.SX.sym("slope", motion.size1_out(0))
        adjoint = ca.jtimes(motion(jets), jets, slope, True)
        function = ca.Function("elastic_motion_adjoint", [jets, slope], [ca.densify(adjoint)], {"cse": True})
        return compiled(function).map(len(self._instants))

    def least_gain(self, c: Array, bounds: Array) -> float:
        """Return the least of the gains, 0 if the limits leave no room for the motion."""
        try:
            return float(self.gains(c, bounds).min())
        except TrajectoryError:
            return 0.0

    def gains(self, c: Array, bounds: Array) -> Array:
        """Return the factors (n,) by which the deviations of K of the motion within the limits are below bounds (n, 7).

        Raises TrajectoryError if the limits leave no room for it.
        """
        return bounds[:, 0] / self.deviations(self.series.reference(self.within(c)))[:, 0]

    def within(self, c: Array) -> Array:
        """Return the coefficients scaled about the offset until the motion keeps all limits.

        Raises TrajectoryError if even the offset does not.
        """
        k = FINE * len(self._instants)
        basis = self.series.jet_basis(np.arange(k) * self.series.period / k)
        function = compiled(motion_function(self.robot)).map(k)

        def scaled(factor: float) -> Array:
            return np.vstack([factor * c[:-1], c[-1:]])

        def keeps(factor: float) -> bool:
            jets = (basis @ scaled(factor)).swapaxes(0, 1)
            return self.limits.keeps(elastic_motion(self.robot, jets, function))

        if keeps(1.0):
            return c
        low, high = 0.0, 1.0
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            low, high = (middle, high) if keeps(middle) else (low, middle)
        if not low > 0:
            raise TrajectoryError(
                "the limits leave no room for a motion about its best position; expected wider limits or a lighter arm"
            )
        return scaled(low)

    def deviations(self, reference: Reference) -> Array:
        """Return the Cramer-Rao bounds (n, 7) of a reference over the whole record; see Excitation."""
        k = int(np.ceil(len(self._instants) * self.duration / self.series.period))
        motion = elastic_motion(self.robot, np.asarray(reference.jets(np.arange(k) * self.duration / k)))
        return replace(self.model, period=self.duration).deviations(motion)


@dataclass(frozen=True, eq=False)
class RestingSeries:
    """Finite Fourier series of each joint, with these m harmonics of a period [s], that rest at both ends of a period.

        q_ld(t) = offset + sum_h a_h sin(w_h t) + b_h cos(w_h t),    w_h = 2 pi h / period

    A motion that joins rest with class C^4 has dq = ddq = d3q = d4q = 0 at t = 0, which is four linear equations:

        sum a_h w_h = sum a_h w_h^3 = 0,    sum b_h w_h^2 = sum b_h w_h^4 = 0

    The free coefficients (2 m - 3,) span their null space; the last is the offset. (J. Swevers et al., Optimal robot
    excitation and identification, IEEE Transactions on Robotics and Automation 13(5), 1997, with rest at both ends.)
    Raises TrajectoryError for fewer than three harmonics.
    """

    period: float
    harmonics: tuple[int, ...]

    def __post_init__(self) -> None:
        if len(self.harmonics) < FEWEST:
            raise TrajectoryError(f"the series has {len(self.harmonics)} harmonics; expected {FEWEST} or more")

    @property
    def frequencies(self) -> Array:
        """Angular frequencies (m,) [rad/s]."""
        return 2 * np.pi * np.array(self.harmonics) / self.period

    @cached_property
    def null_space(self) -> Array:
        """Orthonormal basis (2 m, 2 m - 4) of the coefficients (a_1 .. a_m, b_1 .. b_m) that start at rest.

        Coefficients are scaled by 1 / w^2, so that each basis vector has an acceleration of the same size.
        """
        ratio, m = self.frequencies / self.frequencies[-1], len(self.harmonics)
        rest = np.zeros((4, 2 * m))
        rest[:2, :m] = ratio**-1, ratio
        rest[2:, m:] = np.ones(m), ratio**2
        free = np.linalg.svd(rest)[2][4:].T
        return free / np.tile(self.frequencies**2, 2)[:, None]

    @property
    def size(self) -> int:
        """Number of free coefficients, the offset included."""
        return 2 * len(self.harmonics) - 3

    def jet_basis(self, t: Array) -> Array:
        """Return the matrix (5, k, size) that maps free coefficients to q_ld .. d4q_ld at t (k,) [s]."""
        w = self.frequencies
        angle = np.multiply.outer(t, w)
        basis = np.zeros((JETS, len(t), self.size))
        for row in range(JETS):
            shift = row * np.pi / 2
            waves = np.hstack([w**row * np.sin(angle + shift), w**row * np.cos(angle + shift)])
            basis[row, :, :-1] = waves @ self.null_space
        basis[0, :, -1] = 1.0
        return basis

    def reference(self, coefficients: Array) -> MultiSine:
        """Return the reference of free coefficients (size, n) of n joints."""
        n, m = coefficients.shape[1], len(self.harmonics)
        a, b = np.split(self.null_space @ coefficients[:-1], [m])
        frequency = np.repeat(self.frequencies[:, None], n, axis=1)
        return MultiSine(np.hypot(a, b), frequency, np.arctan2(b, a), coefficients[-1])


def logarithmic_harmonics(highest: int, count: int) -> tuple[int, ...]:
    """Return at most `count` harmonics from 1 to `highest`, spaced evenly on a logarithmic scale."""
    spaced = np.unique(np.geomspace(1, highest, count).round().astype(int))
    missing = [h for h in range(1, highest + 1) if h not in spaced][: count - len(spaced)]
    return tuple(int(h) for h in np.sort(np.append(spaced, np.array(missing, dtype=int))))
