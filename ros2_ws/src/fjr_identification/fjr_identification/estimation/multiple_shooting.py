# SPDX-License-Identifier: Apache-2.0
"""The likelihood of z over all segments of the records, each simulated from its own initial state (H. G. Bock).

-log L = sum_i (N_i log s_i^2 + sum r_i^2 / s_i^2) / 2 + ((z - z_prior) / width)^2 / 2
         + sum_k ((x_k - filtered_k) / state_width)^2 / 2

s_i: root mean square of the residuals r_i of signal i, but at least the noise of its steps. x_k: initial state of
segment k. A segment starts and ends some samples outside what is compared: signals with a skew are evaluated there.

The normal equations of Gauss-Newton of a segment, by its initial state x and by z, are reduced to those of z by their
Schur complement, dx = a - B dz (variable projection; G. H. Golub, V. Pereyra, SIAM J. Numer. Anal. 10(2), 1973).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from fjr_core.numerics.checks import Array

from .motion_record import SIGNALS, MotionRecord
from .parameters import LARGEST_SKEW, RATIO, ParameterCoordinates
from .shooting import HeldEffort, Shooting

SKEWS = {"q_l": "link_skew", "torque": "torque_skew"}
RIDGE = 1e-10  # of the scaled Hessian of an initial state, so that it can be factored
FEWEST = 25  # samples that are compared of a segment
SOFT = 1e-6  # damping of the first step
SETTLED = 0.02  # decrease of the sum of squares, in units of the noise, that a step of an initial state is worth
SHARE = 1e-4  # of the sum of squares: a smaller decrease is left to the next step of z
MOST_SETTLING = 8  # steps of the initial state of a segment
ROUGH = 1e-4  # rad, N m; noise that is assumed before residuals are known
_pool = cache(ThreadPoolExecutor)  # which starts its threads once: a search evaluates a problem some hundred times

Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class Segment:
    """Samples first .. first + count - 1 of a record, integrated from `pad` samples before to as many after."""

    record: MotionRecord
    effort: HeldEffort
    first: int
    count: int
    pad: int

    def measured(self, signal: str, joint: int) -> Array:
        """Return the measurements (count,) of a signal of a joint, NaN: none."""
        return np.asarray(getattr(self.record, signal)[self.first : self.first + self.count, joint])


def cut(record: MotionRecord, effort: HeldEffort, length: float) -> list[Segment]:
    """Return segments of about `length` [s], all of the same number of samples but the last ones."""
    pad = int(np.ceil(LARGEST_SKEW / record.dt)) + 1
    usable = len(record.u) - 2 * pad - 1
    number = max(1, round(usable * record.dt / length))
    edges = pad + np.round(np.linspace(0, usable, number + 1)).astype(int)
    return [Segment(record, effort, int(a), int(b - a), pad) for a, b in pairwise(edges)]


def measured_signals(records: Sequence[MotionRecord]) -> tuple[tuple[str, int], ...]:
    """Return (signal, joint) of all that is measured in some record."""
    pairs = [(signal, j) for signal in SIGNALS for j in range(len(records[0].joints))]
    return tuple((s, j) for s, j in pairs if any(record.measured(s)[j] for record in records))


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """H dz = g, H (p, p), g (p,), of the step of z to the most likely one; a state follows by dx = a - B dz, if any."""

    H: Array
    g: Array
    a: Array = field(default_factory=lambda: np.zeros(0))
    B: Array = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True, eq=False)
class Whitening:
    """What random jumps explain of the residuals of a segment, (signals, count), in units of the noise.

    penalty: of their prior. squares, counts: of the jumps of each width, and their number.
    """

    explained: Array
    penalty: float
    squares: Array
    counts: Array


@dataclass(frozen=True, eq=False)
class Comparison:
    """Prediction of a segment: predicted (signals, count), and with residuals in units of their noise, J = d predicted.

    size: of the initial state, 4n.
    squares, counts (signals,): sum of squared residuals in units of the signals, and their number. H = J'J, g = J'r by
    the initial state (4n) and z. penalty: what the prior of the initial state adds to the sum of squares; unsettled:
    by how much the most likely initial state would lower it.
    """

    size: int
    predicted: Array
    squares: Array
    counts: Array
    H: Array
    g: Array
    penalty: float
    whitening: Whitening | None
    unsettled: float = 0.0

    @cached_property
    def projected(self) -> NormalEquations:
        """The normal equations of z, without the initial state."""
        size, (scale, factor) = self.size, self.state_factor(0.0)
        across = self.H[:size, size:]
        B = cho_solve(factor, across / scale[:, None]) / scale[:, None]
        a = cho_solve(factor, self.g[:size] / scale) / scale
        return NormalEquations(self.H[size:, size:] - across.T @ B, self.g[size:] - across.T @ a, a, B)

    def state_step(self, damping: float) -> tuple[Array, float]:
        """Return the damped step of the initial state (4n,), and by how much it lowers the sum of squares."""
        scale, factor = self.state_factor(damping)
        g = self.g[: self.size]
        dx = cho_solve(factor, g / scale) / scale
        return dx, float(dx @ g)

    def state_factor(self, damping: float) -> tuple[Array, Any]:
        """Return the scale (4n,) of the initial state, and the Cholesky factor of its scaled and damped Hessian."""
        H = self.H[: self.size, : self.size]
        scale = np.sqrt(np.diag(H))
        scale = np.where(scale > 0, scale, 1.0)
        return scale, cho_factor(H / np.outer(scale, scale) + (RIDGE + damping) * np.eye(self.size))


def _output(segment: Segment, signal: str, joint: int, p: Mapping[str, Array], X: Array, S: Array) -> tuple[Array, ...]:
    """Return a signal (count,), its derivative by its skew, and its sensitivities (count, columns)."""
    n, dt = len(segment.record.joints), segment.record.dt
    skew = np.clip(p[SKEWS[signal]][joint], -LARGEST_SKEW, LARGEST_SKEW) / dt if signal in SKEWS else 0.0
    late = int(np.floor(skew))
    first = segment.pad + late
    samples = [slice(first + k, first + k + segment.count) for k in (0, 1)]
    weights, slopes = _hermite(skew - late, dt)
    values = [_position(signal, joint, n, X[at, part:]) for at in samples for part in (0, 2 * n)]
    y, dy = (sum(w * value for w, value in zip(factors, values, strict=True)) for factors in (weights, slopes))
    if skew == late:
        sensitivities = _position(signal, joint, n, S[samples[0]])
    else:
        columns = [_position(signal, joint, n, S[at, part:]) for at in samples for part in (0, 2 * n)]
        sensitivities = sum(w * column for w, column in zip(weights, columns, strict=True))
    if signal == "torque":
        K = p["joint_stiffness"][joint]
        return K * (y - p["offset"][joint]), K * dy, K * sensitivities
    if signal == "q_m" and (error := p[RATIO][joint]):
        return (1 + error) * y, (1 + error) * dy, (1 + error) * sensitivities
    return y, dy, sensitivities


def _position(signal: str, joint: int, n: int, states: Array) -> Array:
    """Return the position, or deflection, of a joint from states (k, 2n or 4n, ...); of velocities, the velocity."""
    link, motor = states[:, joint], states[:, n + joint]
    if signal == "torque":
        return motor - link
    return link if signal == "q_l" else motor


def _hermite(f: float, dt: float) -> tuple[Array, Array]:
    """Return the weights of (y_0, dy_0, y_1, dy_1) in cubic Hermite interpolation at f dt, and in its derivative."""
    weights = [(1 + 2 * f) * (1 - f) ** 2, dt * f * (1 - f) ** 2, f**2 * (3 - 2 * f), dt * f**2 * (f - 1)]
    slopes = [6 * f * (f - 1) / dt, (1 - f) * (1 - 3 * f), 6 * f * (1 - f) / dt, f * (3 * f - 2)]
    return np.array(weights), np.array(slopes)


@dataclass(frozen=True, eq=False)
class Problem:
    """Segments and signals with the model that predicts them. floor (signals,): least noise, of the encoder's steps.

    filtered (segments, 4n), state_width (4n,): weak normal prior of the initial states, which keeps states that are not
    measured within reach where the model is wrong.
    """

    segments: Sequence[Segment]
    shooting: Shooting
    coordinates: ParameterCoordinates
    signals: tuple[tuple[str, int], ...]
    floor: Array
    filtered: Array
    state_width: Array
    threads: int = 2
    reversals: Any = None

    @property
    def rough_noise(self) -> Array:
        """Return the noise (signals,) that is assumed before residuals are known."""
        return np.maximum(self.floor, ROUGH)

    def part(self, stride: int, share: int) -> Problem:
        """Return the problem of the first 1 / share, at least FEWEST samples, of every `stride`-th segment."""
        segments = [
            replace(segment, count=max(segment.count // share, min(segment.count, FEWEST)))
            for segment in self.segments[::stride]
        ]
        return replace(self, segments=segments, filtered=self.filtered[::stride])

    def holding(self, held: Collection[int]) -> Problem:
        """Return the same problem with other entries of z held."""
        coordinates = replace(self.coordinates, held=frozenset(held))
        arm = replace(self.shooting.arm, free=coordinates.dynamic)
        return replace(self, coordinates=coordinates, shooting=Shooting(arm, coordinates.delays))

    def of_each(self, work: Callable[[int], Result]) -> list[Result]:
        """Return the results of work(k) for each segment k, some of which are computed at the same time."""
        _ = self.shooting.library, self.shooting.function  # compiled in this thread
        return list(_pool(self.threads).map(work, range(len(self.segments))))

    def evaluate(self, z: Array, x0: Array, noise: Array) -> PredictedSegments | None:
        """Return the prediction at z from settled initial states near x0, None if one does not stay finite."""
        settled = [result for result in self.of_each(lambda k: self._settle(k, z, x0[k], noise)) if result is not None]
        if len(settled) < len(self.segments):
            return None
        return PredictedSegments(
            self, z, np.array([x for x, _ in settled]), noise, [compared for _, compared in settled]
        )

    def _settle(self, k: int, z: Array, x: Array, noise: Array) -> tuple[Array, Comparison] | None:
        """Return the most likely initial state of a segment at z, by Levenberg-Marquardt, and the comparison there."""
        compared, damping = self.compare(k, z, x, noise), SOFT
        for _ in range(MOST_SETTLING):
            if compared is None:
                return None
            dx, decrease = compared.state_step(damping)
            if decrease < max(SETTLED, SHARE * _weighted(compared, noise)):
                return x, replace(compared, unsettled=decrease)
            trial, before = self.compare(k, z, x + dx, noise), _weighted(compared, noise)
            gain = before - _weighted(trial, noise) if trial is not None else -1.0
            if trial is not None and gain >= 0:
                x, compared = x + dx, trial
            damping *= 0.1 if gain > decrease / 2 else 1.0 if gain >= 0 else 100.0
        return None if compared is None else (x, compared)

    @np.errstate(over="ignore", invalid="ignore")
    def compare(self, k: int, z: Array, x: Array, noise: Array) -> Comparison | None:
        """Return the comparison of segment k at z and the initial state x (4n,), or None if it does not stay finite.

        noise (signals,): unit of the residuals.
        """
        segment, p, moving = self.segments[k], self.coordinates.parameters(z), self.coordinates.moving
        motion = self.shooting(x, segment.effort, segment.first - segment.pad, segment.count + 2 * segment.pad, p)
        if motion is None:
            return None
        size, (predicted, J) = len(x), self._linearised(segment, p, *motion, noise)
        residual = np.array([segment.measured(*signal) for signal in self.signals]) - predicted
        known = np.isfinite(residual)
        if not known.all():
            residual[~known], J[~known] = 0.0, 0.0
        weighted, whitening = residual / noise[:, None], None
        if self.reversals:
            J, weighted, whitening = self.reversals.whitened(segment, *motion, p, J, weighted, noise)
            residual = residual - whitening.explained * noise[:, None]
        H, g = np.zeros((size + len(z),) * 2), np.zeros(size + len(z))
        places = np.concatenate([np.arange(size), size + np.array(moving, dtype=int)])
        reduced = self.shooting.normal_equations(J.reshape(-1, J.shape[2]), weighted.ravel())
        H[np.ix_(places, places)], g[places] = reduced
        scale, away = np.append(np.ones(size), self.coordinates.scale(z)), (x - self.filtered[k]) / self.state_width
        H *= np.outer(scale, scale)
        g *= scale
        if not np.isfinite(H).all():
            return None
        H[range(size), range(size)] += self.state_width**-2
        g[:size] -= away / self.state_width
        squares, counts = np.sum(residual**2, axis=1), known.sum(axis=1)
        penalty = (whitening.penalty if whitening else 0.0) + float(away @ away)
        return Comparison(size, predicted, squares, counts, H, g, penalty, whitening)

    def _linearised(
        self, segment: Segment, p: Mapping[str, Array], X: Array, S: Array, noise: Array
    ) -> tuple[Array, Array]:
        """Return the prediction (signals, count), and J (signals, count, columns) in units of the noise."""
        size, moving = X.shape[1], self.coordinates.moving
        J = np.zeros((len(self.signals), segment.count, size + len(moving)))
        predicted = np.empty((len(self.signals), segment.count))
        for k, (signal, joint) in enumerate(self.signals):
            predicted[k], dy, sensitivities = _output(segment, signal, joint, p, X, S)
            np.divide(sensitivities, noise[k], out=J[k, :, : self.shooting.columns])
            measuring = {SKEWS.get(signal, ""): dy}  # derivatives by parameters of the measurement
            if signal == "torque":
                K = p["joint_stiffness"][joint]
                measuring |= {"joint_stiffness": predicted[k] / K, "offset": np.full(len(dy), -K)}
            elif signal == "q_m":
                measuring[RATIO] = predicted[k] / (1 + p[RATIO][joint])
            for column, (name, i) in enumerate((self.coordinates.free[i] for i in moving), start=size):
                if i == joint and name in measuring:
                    J[k, :, column] += measuring[name] / noise[k]
        return predicted, J


def _weighted(compared: Comparison, noise: Array) -> float:
    return float(np.sum(compared.squares / noise**2)) + compared.penalty


@dataclass(frozen=True, eq=False)
class PredictedSegments:
    """All segments predicted at z (p,) from settled initial states x0 (segments, 4n), compared in units of noise.

    converged: whether a search has ended here, at a minimum.
    """

    problem: Problem
    z: Array
    x0: Array
    noise: Array
    compared: Sequence[Comparison]
    converged: bool = False

    @cached_property
    def residual(self) -> Array:
        """Root mean square residual of each signal (signals,), at least the noise of its steps."""
        squares, counts = (sum(getattr(segment, name) for segment in self.compared) for name in ("squares", "counts"))
        return np.asarray(np.maximum(np.sqrt(squares / np.maximum(counts, 1)), self.problem.floor))

    @cached_property
    def cost(self) -> float:
        """Return -log L at the most likely initial states: less what those of the comparisons are short of."""
        counts, squares = (sum(getattr(segment, name) for segment in self.compared) for name in ("counts", "squares"))
        coordinates = self.problem.coordinates
        prior = (self.z - coordinates.mean) / coordinates.width
        states = sum(segment.penalty - segment.unsettled for segment in self.compared)
        squares = np.sum(squares / self.residual**2)
        return float(counts @ np.log(self.residual) + (squares + prior @ prior + states) / 2)

    @cached_property
    def projected(self) -> list[NormalEquations]:
        """Normal equations of each segment, without its initial state."""
        return [segment.projected for segment in self.compared]

    @cached_property
    def normal_equations(self) -> tuple[Array, Array]:
        """Information about z with the prior (p, p), and the gradient of log L (p,)."""
        return with_prior(self.problem.coordinates, self.z, self.projected)


def with_prior(coordinates: ParameterCoordinates, z: Array, parts: Sequence[NormalEquations]) -> tuple[Array, Array]:
    """Return the information about z with the prior, and the gradient of log L, of segments or blocks."""
    H = np.asarray(sum(part.H for part in parts)) + np.diag(coordinates.width**-2)
    return H, np.asarray(sum(part.g for part in parts)) - (z - coordinates.mean) / coordinates.width**2
