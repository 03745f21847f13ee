# SPDX-License-Identifier: Apache-2.0
"""The filtered motion of a record, and start values by least squares on the exact equations of both sides.

    link side    q_m - q_l = offset + (tau_rigid + D_l v_l + F_l tanh(v_l / v_0)) / K
    motor side   u(t - delay) - tau = B a_m + D_m v_m + F_m tanh(v_m / v_0)

The deflection is the output of the link side, so that its noise does not bias K. Link damping and a skew have nearly
one effect on the deflection, so D_l keeps its prior here. All signals pass the same filter (A. Savitzky, M. Golay,
Analytical Chemistry 36(8), 1964).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.signal import resample_poly, savgol_filter

from fjr_core.numerics.checks import Array

from .elastic_arm import ElasticArm, coulomb, packed
from .motion_record import MotionRecord
from .parameters import SMOOTHING, Prior

WINDOW = 0.03  # s
ORDER = 4
BAND, MARGIN = 0.99, 4.0  # share of the power of velocities below a frequency, and the cutoff relative to it
CUTOFF = (8.0, 40.0)  # Hz; least and largest cutoff
OTHER_ORDER = 8.0  # ratio of a value to its prior that is not believed
TRIED = np.arange(-6, 6.5, 0.5) * 1e-3  # s; skews and delays


@dataclass(frozen=True, eq=False)
class FilteredMotion:
    """Smoothed positions, velocities and accelerations of links and motors, and efforts, each (k, n).

    A side without encoders follows from the other one by the torque sensor, or by the rigid arm and the prior's K.
    rigid: torque of the rigid links.
    """

    dt: float
    q_l: Array
    v_l: Array
    a_l: Array
    q_m: Array
    v_m: Array
    a_m: Array
    u: Array
    rigid: Array

    @cached_property
    def stride(self) -> int:
        """Return the number of samples from one independent sample to the next, by the bandwidth of the motion."""
        power = np.abs(np.fft.rfft(np.nan_to_num(self.v_m), axis=0)) ** 2
        share = np.cumsum(power, axis=0) / np.maximum(np.sum(power, axis=0), 1e-300)
        highest = np.max(np.argmax(share >= BAND, axis=0)) / (len(self.v_m) * self.dt)
        cutoff = np.clip(MARGIN * highest, *CUTOFF)
        return max(1, int(0.4 / (cutoff * self.dt)))

    def state(self, sample: int) -> Array:
        """Return (q_l, q_m, v_l, v_m) (4n,) at a sample."""
        return np.concatenate([self.q_l[sample], self.q_m[sample], self.v_l[sample], self.v_m[sample]])


def filtered(record: MotionRecord, arm: ElasticArm, values: Mapping[str, Array]) -> FilteredMotion:
    """Return the filtered motion of a record; values: of all parameters, by name."""
    q_l, q_m = _filled(record.q_l), _filled(record.q_m)
    no_link, no_motor = (np.all(np.isnan(q), axis=0) for q in (record.q_l, record.q_m))
    q_l[:, no_link], q_m[:, no_motor] = q_m[:, no_link], q_l[:, no_motor]
    rigid = rigid_torque(arm, values, *(smoothed(q_l, record.dt, order) for order in range(3)))
    sensed = np.isfinite(record.torque).any(axis=0)
    torque = np.where(sensed, _filled(record.torque), rigid)
    deflection = smoothed(torque / values["joint_stiffness"] + values["offset"], record.dt)
    q_l[:, no_link] = (q_m - deflection)[:, no_link]
    q_m[:, no_motor] = (q_l + deflection)[:, no_motor]
    (q_l, v_l, a_l), (q_m, v_m, a_m) = ([smoothed(q, record.dt, order) for order in range(3)] for q in (q_l, q_m))
    return FilteredMotion(record.dt, q_l, v_l, a_l, q_m, v_m, a_m, smoothed(record.u, record.dt), rigid)


def rigid_torque(arm: ElasticArm, values: Mapping[str, Array], q: Array, v: Array, a: Array) -> Array:
    """Return M_l a + C v + grad P_l (k, n) [N m] along a motion."""
    return np.asarray(arm.link_torque(q.T, v.T, a.T, packed(arm, values)).full().T)


def _filled(signal: Array) -> Array:
    """Return a signal with missing samples interpolated; columns without any stay NaN."""
    filled, k = signal.copy(), np.arange(len(signal))
    for j in range(signal.shape[1]):
        measured = np.isfinite(signal[:, j])
        if measured.any() and not measured.all():
            filled[:, j] = np.interp(k, k[measured], signal[measured, j])
    return filled


def smoothed(signal: Array, dt: float, order: int = 0) -> Array:
    """Return the derivative of this order of a signal (k, ...) behind the filter of all signals."""
    window = max(7, 2 * round(WINDOW / dt / 2) + 1)
    if len(signal) <= window:
        window = 7
    return np.asarray(savgol_filter(signal, window, ORDER, deriv=order, delta=dt, axis=0))


def shifted(signal: Array, dt: float, time: float) -> Array:
    """Return the signal (k,) `time` [s] later."""
    k = np.arange(len(signal))
    return np.interp(k - time / dt, k, signal)


def decimated(signals: Array, stride: int) -> Array:
    """Return every `stride`-th sample of the signals (k, ...) behind a low-pass filter."""
    return np.asarray(resample_poly(signals, 1, stride)) if stride > 1 else signals


def inner(rows: Array, dt: float) -> Array:
    """Return the rows (k, ...) without those near the ends, which filters and shifts falsify."""
    edge = round(2 * WINDOW / dt) + 2
    return rows[edge:-edge] if len(rows) > 4 * edge else rows


def start_values(
    records: Sequence[MotionRecord],
    motions: Sequence[FilteredMotion],
    robot_input: Array,
    prior: Prior,
) -> dict[str, Array]:
    """Return parameters by name from all records; what the equations do not determine keeps its prior."""
    values = {name: value.copy() for name, value in prior.values.items()}
    smoothing = values[SMOOTHING]
    for j in range(len(records[0].joints)):
        two_sided = [motion for record, motion in zip(records, motions, strict=True) if record.both_sides(j)]
        if two_sided:
            _start_of_link(values, two_sided, j, smoothing[j])
        _start_of_motor(values, motions, j, smoothing[j], robot_input)
    return values


def _start_of_link(values: dict[str, Array], motions: Sequence[FilteredMotion], j: int, smoothing: float) -> None:
    """Choose the skew with the least residual of the deflection, and set K, F_l and the offset.

    K keeps its prior at a skew that gives a value of another order.
    """
    least, D_l, prior = np.inf, values["link_damping"][j], values["joint_stiffness"][j]
    for skew in TRIED:
        columns, outputs = [], []
        for m in motions:
            q_l, v_l, rigid = (shifted(signal[:, j], m.dt, skew) for signal in (m.q_l, m.v_l, m.rigid))
            A = np.column_stack([rigid + D_l * v_l, coulomb(v_l, smoothing), np.ones(len(q_l))])
            columns.append(inner(A, m.dt))
            outputs.append(inner(m.q_m[:, j] - q_l, m.dt))
        A, deflection = np.vstack(columns), np.concatenate(outputs)
        (compliance, friction, offset), squares = _solved(A, deflection)
        if not 1 / OTHER_ORDER < prior * compliance < OTHER_ORDER:
            compliance = 1 / prior
            (friction, offset), squares = _solved(A[:, 1:], deflection - A[:, 0] / prior)
        if squares < least:
            least = squares
            values["link_skew"][j], values["offset"][j] = skew, offset
            values["joint_stiffness"][j] = 1 / compliance
            values["link_coulomb_friction"][j] = max(0.0, friction / compliance)


def _start_of_motor(
    values: dict[str, Array], motions: Sequence[FilteredMotion], j: int, smoothing: float, robot_input: Array
) -> None:
    """Choose the delay with the least residual of the motor's equation, and set B, D_m and F_m.

    values: parameters of the link side, by name.
    """
    least, prior = np.inf, values["motor_inertia"][j]
    for delay in TRIED[TRIED >= 0]:
        columns, outputs = [], []
        for m in motions:
            v_l, rigid = (shifted(signal[:, j], m.dt, values["link_skew"][j]) for signal in (m.v_l, m.rigid))
            tau = rigid + values["link_damping"][j] * v_l
            tau += values["link_coulomb_friction"][j] * coulomb(v_l, smoothing)
            u = shifted((m.u @ robot_input.T)[:, j], m.dt, delay + m.dt / 2)
            A = np.column_stack([m.a_m[:, j], m.v_m[:, j], coulomb(m.v_m[:, j], smoothing)])
            columns.append(inner(A, m.dt))
            outputs.append(inner(u - tau, m.dt))
        solution, squares = _solved(np.vstack(columns), np.concatenate(outputs))
        if squares < least:
            least, values["effort_delay"][j] = squares, delay
            B, D_m, F_m = solution
    values["motor_inertia"][j] = B if prior / OTHER_ORDER < B < OTHER_ORDER * prior else prior
    values["motor_damping"][j] = max(0.0, D_m)
    values["motor_coulomb_friction"][j] = max(0.0, F_m)


def _solved(A: Array, y: Array) -> tuple[Array, float]:
    solution = np.linalg.lstsq(A, y, rcond=1e-10)[0]
    return np.asarray(solution, dtype=float), float(np.sum((y - A @ solution) ** 2))
