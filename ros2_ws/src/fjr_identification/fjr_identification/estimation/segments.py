# SPDX-License-Identifier: Apache-2.0
"""Cut records into segments, compare each with its prediction, and add up the normal equations of Gauss-Newton.

A segment is integrated from a free initial state. It starts and ends some samples outside what is compared, so that
signals with a skew can be evaluated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from fjr_core.numerics.checks import Array

from .coordinates import Coordinates, packed
from .motion_record import MotionRecord
from .parameters import LARGEST_SKEW
from .shooting import HeldEffort, Shooting

SIGNALS = ("q_l", "q_m", "torque")
SKEWS = {"q_l": "link_skew", "torque": "torque_skew"}


@dataclass(frozen=True, eq=False)
class Segment:
    """Samples first .. first + count - 1 of a record, integrated from `pad` samples before to as many after."""

    record: MotionRecord
    effort: HeldEffort
    first: int
    count: int
    pad: int

    def shortened(self, count: int) -> Segment:
        """Return the first samples of the segment."""
        return replace(self, count=count)

    def measured(self, signal: str, joint: int) -> Array:
        """Return the measurements (count,) of a signal of a joint, NaN: none."""
        return np.asarray(getattr(self.record, signal)[self.first : self.first + self.count, joint])


@dataclass(frozen=True, eq=False)
class Comparison:
    """Prediction of a segment: predicted (signals, count), and with residuals in units of their noise, J = d predicted.

    squares, counts (signals,): sum of squared residuals in units of the signals, and their number. H = J'J, g = J'r by
    the initial state (4n) and z. penalty: what the prior of the initial state adds to the sum of squares; unsettled:
    by how much the most likely initial state would lower it.
    """

    predicted: Array
    squares: Array
    counts: Array
    H: Array
    g: Array
    penalty: float = 0.0
    unsettled: float = 0.0


def measured_signals(records: Sequence[MotionRecord]) -> tuple[tuple[str, int], ...]:
    """Return (signal, joint) of all that is measured in some record."""
    n = len(records[0].joints)
    pairs = [(signal, j) for signal in SIGNALS for j in range(n)]
    return tuple((s, j) for s, j in pairs if any(np.any(np.isfinite(getattr(r, s)[:, j])) for r in records))


def cut(record: MotionRecord, effort: HeldEffort, length: float) -> list[Segment]:
    """Return segments of about `length` [s], all of the same number of samples but the last ones."""
    pad = int(np.ceil(LARGEST_SKEW / record.dt)) + 1
    usable = len(record.u) - 2 * pad - 1
    number = max(1, round(usable * record.dt / length))
    edges = pad + np.round(np.linspace(0, usable, number + 1)).astype(int)
    return [Segment(record, effort, int(a), int(b - a), pad) for a, b in pairwise(edges)]


def compare(
    segment: Segment,
    shooting: Shooting,
    coordinates: Coordinates,
    z: Array,
    x0: Array,
    signals: Sequence[tuple[str, int]],
    noise: Array,
) -> Comparison | None:
    """Return the comparison of a segment, or None if the prediction does not stay finite. noise (signals,)."""
    p = coordinates.parameters(z)
    start, samples = segment.first - segment.pad, segment.count + 2 * segment.pad
    found = shooting(x0, segment.effort, start, samples, packed(shooting.arm, p), p["effort_delay"])
    if found is None:
        return None
    n, scale = len(segment.record.joints), coordinates.scale(z)
    J = np.zeros((len(signals), segment.count, 4 * n + len(z)))
    predicted = np.empty((len(signals), segment.count))
    for k, (signal, joint) in enumerate(signals):
        y, dy, J[k, :, : shooting.columns] = _output(segment, signal, joint, p, *found)
        _own_columns(J[k, :, 4 * n :], coordinates, signal, joint, dy, y / p["joint_stiffness"][joint], p)
        predicted[k] = y
    J[:, :, 4 * n :] *= scale
    return _compared(segment, shooting, signals, predicted, J, noise)


def _compared(
    segment: Segment,
    shooting: Shooting,
    signals: Sequence[tuple[str, int]],
    predicted: Array,
    J: Array,
    noise: Array,
) -> Comparison:
    residual = np.array([segment.measured(*each) for each in signals]) - predicted
    known = np.isfinite(residual)
    residual[~known] = 0.0
    J[~known] = 0.0
    J /= noise[:, None, None]
    H, g = shooting.normal_equations(J.reshape(-1, J.shape[2]), (residual / noise[:, None]).ravel())
    return Comparison(predicted, np.sum(residual**2, axis=1), known.sum(axis=1), H, g)


def _output(segment: Segment, signal: str, joint: int, p: Mapping[str, Array], X: Array, S: Array) -> tuple[Array, ...]:
    """Return a signal (count,), its derivative by its skew, and its sensitivities (count, columns)."""
    n, dt = len(segment.record.joints), segment.record.dt
    skew = np.clip(p[SKEWS[signal]][joint], -LARGEST_SKEW, LARGEST_SKEW) / dt if signal in SKEWS else 0.0
    late = int(np.floor(skew))
    at = slice(segment.pad + late, segment.pad + late + segment.count)
    after = slice(at.start + 1, at.stop + 1)
    weights, slopes = _hermite(skew - late, dt)
    parts = [_position(signal, joint, n, each) for each in (X[at], X[after])]
    speeds = [_position(signal, joint, n, each[:, 2 * n :]) for each in (X[at], X[after])]
    values = (parts[0], speeds[0], parts[1], speeds[1])
    y, dy = (sum(w * v for w, v in zip(each, values, strict=True)) for each in (weights, slopes))
    turns = [_position(signal, joint, n, S[part], axis=1) for part in (at, after)]
    rates = [_position(signal, joint, n, S[part, 2 * n :], axis=1) for part in (at, after)] if skew != late else turns
    columns = (turns[0], rates[0], turns[1], rates[1])
    sensitivities = columns[0] if skew == late else sum(w * c for w, c in zip(weights, columns, strict=True))
    if signal == "torque":
        K = p["joint_stiffness"][joint]
        return K * (y - p["offset"][joint]), K * dy, K * sensitivities
    return y, dy, sensitivities


def _position(signal: str, joint: int, n: int, states: Array, axis: int = 1) -> Array:
    """Return the position, or deflection, of a joint from states (k, 2n or 4n, ...); of velocities, the velocity."""
    link, motor = states[:, joint], states[:, n + joint]
    if signal == "torque":
        return motor - link
    return link if signal == "q_l" else motor


def _own_columns(
    J: Array, coordinates: Coordinates, signal: str, joint: int, dy: Array, deflection: Array, p: Mapping[str, Array]
) -> None:
    """Add the derivatives of a signal by parameters of the measurement: skews, stiffness and offset of a torque."""
    own = {SKEWS.get(signal, ""): dy}
    if signal == "torque":
        own |= {"joint_stiffness": deflection, "offset": np.full(len(dy), -p["joint_stiffness"][joint])}
    for k, (name, i) in enumerate(coordinates.free):
        if i == joint and name in own:
            J[:, k] += own[name]


def _hermite(f: float, dt: float) -> tuple[Array, Array]:
    """Return the weights of (y_0, dy_0, y_1, dy_1) in cubic Hermite interpolation at f dt, and in its derivative."""
    weights = [(1 + 2 * f) * (1 - f) ** 2, dt * f * (1 - f) ** 2, f**2 * (3 - 2 * f), dt * f**2 * (f - 1)]
    slopes = [6 * f * (f - 1) / dt, (1 - f) * (1 - 3 * f), 6 * f * (1 - f) / dt, f * (3 * f - 2)]
    return np.array(weights), np.array(slopes)
