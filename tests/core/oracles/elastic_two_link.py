# SPDX-License-Identifier: Apache-2.0
"""Records of a planar arm with two elastic joints in a vertical plane, made without fjr_core and SciPy.

The equations of motion are written out and integrated by Runge-Kutta 4 with steps of GRAIN. The effort is a zero-order
hold that acts `delay` late; the link encoders are read `skew` later than the motor encoders. q = 0 hangs down.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import cos, sin, tanh
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
State = tuple[float, ...]  # q_l, q_m, dq_l, dq_m of both joints
GRAIN = 2e-4  # s


@dataclass(frozen=True)
class ElasticTwoLink:
    """Masses, lengths, centres of mass and inertias of the links; springs, rotors and friction of the joints."""

    m: tuple[float, float] = (1.6, 1.1)
    l1: float = 0.35
    c: tuple[float, float] = (0.17, 0.14)
    inertia: tuple[float, float] = (0.02, 0.01)
    g: float = 9.81
    K: tuple[float, float] = (220.0, 110.0)
    B: tuple[float, float] = (0.06, 0.025)
    D_l: tuple[float, float] = (0.05, 0.03)
    D_m: tuple[float, float] = (0.15, 0.08)
    F_l: tuple[float, float] = (0.10, 0.06)
    F_m: tuple[float, float] = (0.15, 0.08)
    offset: tuple[float, float] = (0.002, -0.003)
    skew: float = 1.2e-3
    delay: float = 1.6e-3

    def derivative(self, x: State, u: tuple[float, float]) -> State:
        """Return dx/dt; M11 a1 + M12 a2 = r1, M12 a1 + M22 a2 = r2 by Cramer's rule."""
        q1, q2, p1, p2, v1, v2, w1, w2 = x
        (m1, m2), (c1, c2) = self.m, self.c
        h = m2 * self.l1 * c2
        M22 = self.inertia[1] + m2 * c2 * c2
        M12 = M22 + h * cos(q2)
        M11 = self.inertia[0] + m1 * c1 * c1 + m2 * self.l1 * self.l1 + M22 + 2 * h * cos(q2)
        outer = self.g * m2 * c2 * sin(q1 + q2)
        tau = self.K[0] * (p1 - q1 - self.offset[0]), self.K[1] * (p2 - q2 - self.offset[1])
        r1 = tau[0] + h * sin(q2) * (2 * v1 * v2 + v2 * v2) - self.g * (m1 * c1 + m2 * self.l1) * sin(q1) - outer
        r2 = tau[1] - h * sin(q2) * v1 * v1 - outer
        r1 -= self.D_l[0] * v1 + self.F_l[0] * tanh(v1 / 0.01)
        r2 -= self.D_l[1] * v2 + self.F_l[1] * tanh(v2 / 0.01)
        det = M11 * M22 - M12 * M12
        b1 = (u[0] - tau[0] - self.D_m[0] * w1 - self.F_m[0] * tanh(w1 / 0.01)) / self.B[0]
        b2 = (u[1] - tau[1] - self.D_m[1] * w2 - self.F_m[1] * tanh(w2 / 0.01)) / self.B[1]
        return v1, v2, w1, w2, (M22 * r1 - M12 * r2) / det, (M11 * r2 - M12 * r1) / det, b1, b2

    def step(self, x: State, u: tuple[float, float]) -> State:
        """Return the state GRAIN later."""
        h = GRAIN
        a = self.derivative(x, u)
        b = self.derivative(tuple(s + h / 2 * d for s, d in zip(x, a, strict=True)), u)
        c = self.derivative(tuple(s + h / 2 * d for s, d in zip(x, b, strict=True)), u)
        d = self.derivative(tuple(s + h * e for s, e in zip(x, c, strict=True)), u)
        slopes = zip(x, a, b, c, d, strict=True)
        return tuple(s + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4) for s, k1, k2, k3, k4 in slopes)


@dataclass(frozen=True, eq=False)
class Recorded:
    """Samples dt [s] apart without noise: u, link and motor positions, spring torque, each (k, 2)."""

    dt: float
    u: Array
    link: Array
    motor: Array
    torque: Array


@cache
def recorded(seconds: float = 5.0, size: tuple[float, float] = (1.0, 1.0)) -> Recorded:
    """Return a record of motors that follow a multi-sine of some size by PD control, from rest at 0."""
    arm, dt = ElasticTwoLink(), 4e-3
    t = np.arange(round(seconds / dt)) * dt
    phase = np.random.default_rng(4).uniform(0, 2 * np.pi, (2, 4))
    waves = np.sin(2 * np.pi * np.array([0.23, 0.7, 1.9, 6.1]) * t[:, None, None] + phase) @ [0.5, 0.25, 0.08, 0.01]
    q_d = (waves - waves[0]) * size
    x: State = (0.0, 0.0, *arm.offset, 0.0, 0.0, 0.0, 0.0)
    fine, late, skew = (round(each / GRAIN) for each in (dt, arm.delay, arm.skew))
    states, held = [x], []
    for k in range(len(t)):
        held.append((90.0 * (q_d[k, 0] - x[2]) - 2.5 * x[6], 40.0 * (q_d[k, 1] - x[3]) - 1.0 * x[7]))
        for i in range(k * fine, (k + 1) * fine):
            x = arm.step(x, held[max(0, (i - late) // fine)])
            states.append(x)
    X, at = np.array(states), np.arange(len(t)) * fine
    link = X[np.clip(at + skew, 0, len(X) - 1), :2]
    torque = np.array(arm.K) * (X[at, 2:4] - X[at, :2] - np.array(arm.offset))
    return Recorded(dt, np.array(held), link, X[at, 2:4], torque)
