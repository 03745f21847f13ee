# SPDX-License-Identifier: Apache-2.0
"""The filtered motion of a record: positions, velocities and accelerations of both sides.

All signals pass the same filter (A. Savitzky, M. Golay, Analytical Chemistry 36(8), 1964).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.signal import resample_poly, savgol_filter

from fjr_core.model import springs
from fjr_core.numerics.checks import Array

from .elastic_arm import ElasticArm, packed
from .motion_record import MotionRecord
from .parameters import HARDENING

WINDOW = 0.03  # s
ORDER = 4
BAND, MARGIN = 0.99, 4.0  # share of the power of velocities below a frequency, and the cutoff relative to it
CUTOFF = (8.0, 40.0)  # Hz; least and largest cutoff


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
    motion = (smoothed(q_l, record.dt, order).T for order in range(3))
    rigid = np.asarray(arm.link_torque(*motion, packed(arm, values)).full().T)
    sensed = np.isfinite(record.torque).any(axis=0)
    torque = np.where(sensed, _filled(record.torque), rigid)
    stiffness = zip(values["joint_stiffness"], values[HARDENING], torque.T, strict=True)
    zeta = [springs.root(K, cubic, tau, np) for K, cubic, tau in stiffness]
    deflection = smoothed(np.transpose(zeta) + values["offset"], record.dt)
    q_l[:, no_link] = (q_m - deflection)[:, no_link]
    q_m[:, no_motor] = (q_l + deflection)[:, no_motor]
    (q_l, v_l, a_l), (q_m, v_m, a_m) = ([smoothed(q, record.dt, order) for order in range(3)] for q in (q_l, q_m))
    return FilteredMotion(record.dt, q_l, v_l, a_l, q_m, v_m, a_m, smoothed(record.u, record.dt), rigid)


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
    """Return the signal (k,) `time` [s] later, by Lagrange's cubic through four samples; its ends are held."""
    first = int(np.floor(-time / dt))
    f, k = -time / dt - first, np.arange(first - 1, first - 1 + len(signal))
    weights = -f * (f - 1) * (f - 2) / 6, (f * f - 1) * (f - 2) / 2, -(f + 1) * f * (f - 2) / 2, (f**3 - f) / 6
    return np.asarray(sum(w * signal[np.clip(k + i, 0, len(signal) - 1)] for i, w in enumerate(weights)))


def decimated(signals: Array, stride: int) -> Array:
    """Return every `stride`-th sample of the signals (k, ...) behind a low-pass filter."""
    return np.asarray(resample_poly(signals, 1, stride)) if stride > 1 else signals


def inner(rows: Array, dt: float) -> Array:
    """Return the rows (k, ...) without those near the ends, which filters and shifts falsify."""
    edge = round(2 * WINDOW / dt) + 2
    return rows[edge:-edge] if len(rows) > 4 * edge else rows
