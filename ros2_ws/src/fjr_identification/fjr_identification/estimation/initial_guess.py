# SPDX-License-Identifier: Apache-2.0
"""Start values by filtered least squares on the exact equations of both sides, joint by joint.

    link side    q_m - q_l = offset + (tau_rigid + D_l v_l + F_l tanh(v_l / v_0)) / K
    motor side   u(t - delay) - tau = B a_m + D_m v_m + F_m tanh(v_m / v_0)

The deflection is the output of the link side, so that its noise does not bias K. Link damping and a skew have nearly
one effect on the deflection, so D_l keeps its prior here. All signals pass the same filter (A. Savitzky, M. Golay,
Analytical Chemistry 36(8), 1964).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.signal import resample_poly, savgol_filter

from fjr_core.numerics.checks import Array

from .coordinates import packed
from .elastic_arm import ElasticArm
from .motion_record import MotionRecord
from .parameters import Prior

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
    no_link, no_motor = (np.all(np.isnan(each), axis=0) for each in (record.q_l, record.q_m))
    q_l[:, no_link], q_m[:, no_motor] = q_m[:, no_link], q_l[:, no_motor]
    rigid = rigid_torque(arm, values, *(_derivative(q_l, record.dt, order) for order in range(3)))
    sensed = np.isfinite(record.torque).any(axis=0)
    torque = np.where(sensed, _filled(record.torque), rigid)
    deflection = _derivative(torque / values["joint_stiffness"] + values["offset"], record.dt, 0)
    q_l[:, no_link] = (q_m - deflection)[:, no_link]
    q_m[:, no_motor] = (q_l + deflection)[:, no_motor]
    (q_l, v_l, a_l), (q_m, v_m, a_m) = ([_derivative(q, record.dt, order) for order in range(3)] for q in (q_l, q_m))
    return FilteredMotion(record.dt, q_l, v_l, a_l, q_m, v_m, a_m, _derivative(record.u, record.dt, 0), rigid)


def start_values(
    records: list[MotionRecord], motions: list[FilteredMotion], robot_input: Array, prior: Prior, smoothing: Array
) -> dict[str, Array]:
    """Return parameters by name from all records; what the equations do not determine keeps its prior."""
    found = {name: value.copy() for name, value in prior.values.items()}
    for j in range(len(records[0].joints)):
        chosen = [m for r, m in zip(records, motions, strict=True) if both_sides(r, j)]
        if chosen:
            _link_side(found, chosen, j, smoothing[j])
        _motor_side(found, motions, j, smoothing[j], robot_input)
    return found


def shared(found: Mapping[str, Array], with_skew: Collection[int]) -> dict[str, Array]:
    """Return start values with damping and Coulomb friction divided evenly between the sides of each joint.

    Only their sums are known well. A descent that starts with all friction on one side may end in a local minimum.
    with_skew: joints whose skew is free; there link damping D_l acts like a skew and a delay of D_l / K.
    """
    halves: dict[str, Array] = {}
    for kind in ("damping", "coulomb_friction"):
        half = (found[f"link_{kind}"] + found[f"motor_{kind}"]) / 2
        halves |= {f"link_{kind}": half, f"motor_{kind}": half}
    chosen = np.isin(np.arange(len(found["joint_stiffness"])), list(with_skew))
    late = np.where(chosen, (halves["link_damping"] - found["link_damping"]) / found["joint_stiffness"], 0.0)
    timing = {name: found[name] + late for name in ("link_skew", "effort_delay")}
    return {**found, **halves, **timing}


def _link_side(found: dict[str, Array], motions: list[FilteredMotion], j: int, smoothing: float) -> None:
    """Choose the skew with the least residual of the deflection, and set K, F_l and the offset.

    K keeps its prior at a skew that gives a value of another order.
    """
    best, D_l, prior = np.inf, found["link_damping"][j], found["joint_stiffness"][j]
    for skew in TRIED:
        rows = [_link_rows(m, j, skew, D_l, smoothing) for m in motions]
        A, y = np.vstack([a for a, _ in rows]), np.concatenate([b for _, b in rows])
        solution, squares = _solved(A, y)
        if not 1 / OTHER_ORDER < prior * solution[0] < OTHER_ORDER:
            others, squares = _solved(A[:, 1:], y - A[:, 0] / prior)
            solution = np.array([1 / prior, *others])
        if squares < best:
            best = squares
            found["link_skew"][j], found["offset"][j] = skew, solution[2]
            found["joint_stiffness"][j] = 1 / solution[0]
            found["link_coulomb_friction"][j] = max(0.0, solution[1] / solution[0])


def _link_rows(m: FilteredMotion, j: int, skew: float, D_l: float, smoothing: float) -> tuple[Array, Array]:
    """Return regressors (k, 3) of (1 / K, F_l / K, offset) and the deflection (k,) of joint j at a skew [s]."""
    q_l, v_l, rigid = (shifted(each[:, j], m.dt, skew) for each in (m.q_l, m.v_l, m.rigid))
    A = np.column_stack([rigid + D_l * v_l, np.tanh(v_l / smoothing), np.ones(len(q_l))])
    return inner(A, m.dt), inner(m.q_m[:, j] - q_l, m.dt)


def _motor_side(
    found: dict[str, Array], motions: list[FilteredMotion], j: int, smoothing: float, robot_input: Array
) -> None:
    """Choose the delay with the least residual of the motor's equation, and set B, D_m and F_m."""
    best, prior = np.inf, found["motor_inertia"][j]
    for delay in TRIED[TRIED >= 0]:
        rows = [_motor_rows(found, m, j, delay, smoothing, robot_input) for m in motions]
        A, y = np.vstack([a for a, _ in rows]), np.concatenate([b for _, b in rows])
        solution, squares = _solved(A, y)
        if squares < best:
            best, found["effort_delay"][j] = squares, delay
            B, D_m, F_m = solution
    found["motor_inertia"][j] = B if prior / OTHER_ORDER < B < OTHER_ORDER * prior else prior
    found["motor_damping"][j] = max(0.0, D_m)
    found["motor_coulomb_friction"][j] = max(0.0, F_m)


def _motor_rows(
    found: Mapping[str, Array], m: FilteredMotion, j: int, delay: float, smoothing: float, robot_input: Array
) -> tuple[Array, Array]:
    """Return regressors (k, 3) of (B, D_m, F_m) and the torque (k,) on the motor of joint j at a delay [s].

    found: parameters of the link side, by name.
    """
    v_l = shifted(m.v_l[:, j], m.dt, found["link_skew"][j])
    tau = shifted(m.rigid[:, j], m.dt, found["link_skew"][j]) + found["link_damping"][j] * v_l
    tau += found["link_coulomb_friction"][j] * np.tanh(v_l / smoothing)
    u = shifted((m.u @ robot_input.T)[:, j], m.dt, delay + m.dt / 2)
    A = np.column_stack([m.a_m[:, j], m.v_m[:, j], np.tanh(m.v_m[:, j] / smoothing)])
    return inner(A, m.dt), inner(u - tau, m.dt)


def rigid_torque(arm: ElasticArm, values: Mapping[str, Array], q: Array, v: Array, a: Array) -> Array:
    """Return M_l a + C v + grad P_l (k, n) [N m] along a motion."""
    return np.asarray(arm.link_torque(q.T, v.T, a.T, packed(arm, values)).full().T)


def both_sides(record: MotionRecord, j: int) -> bool:
    """Return whether link and motor of joint j are measured."""
    return bool(np.isfinite(record.q_l[:, j]).any() and np.isfinite(record.q_m[:, j]).any())


def _filled(signal: Array) -> Array:
    """Return a signal with missing samples interpolated; columns without any stay NaN."""
    filled, k = signal.copy(), np.arange(len(signal))
    for j in range(signal.shape[1]):
        known = np.isfinite(signal[:, j])
        if known.any() and not known.all():
            filled[:, j] = np.interp(k, k[known], signal[known, j])
    return filled


def smoothed(signal: Array, dt: float) -> Array:
    """Return the signal behind the filter of all signals."""
    return _derivative(signal, dt, 0)


def _derivative(signal: Array, dt: float, order: int) -> Array:
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


def _solved(A: Array, y: Array) -> tuple[Array, float]:
    solution = np.linalg.lstsq(A, y, rcond=1e-10)[0]
    return np.asarray(solution, dtype=float), float(np.sum((y - A @ solution) ** 2))
