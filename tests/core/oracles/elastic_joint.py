# SPDX-License-Identifier: Apache-2.0
"""Records of elastic joints made without fjr_core: by SciPy's DOP853, or exactly by the matrix exponential.

The effort is a zero-order hold that acts `delay` late; the link encoder is read `skew` later than the motor encoder.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.linalg import expm

Array = NDArray[Any]
TRUTH = {
    "joint_stiffness": "K",
    "motor_inertia": "B",
    "link_damping": "D_l",
    "motor_damping": "D_m",
    "link_coulomb_friction": "F_l",
    "motor_coulomb_friction": "F_m",
    "offset": "offset",
    "effort_delay": "delay",
    "link_skew": "skew",
}
"""Fields of the joint by the name of the identified parameter."""


@dataclass(frozen=True)
class ElasticJoint:
    """One joint: M dv_l = K (q_m - q_l - offset) - load sin q_l - D_l v_l - F_l tanh(v_l / 0.01), B dv_m = u - ..."""

    K: float = 31.0
    B: float = 0.004
    M: float = 0.031
    load: float = 0.8
    D_l: float = 0.05
    D_m: float = 0.007
    F_l: float = 0.05
    F_m: float = 0.04
    offset: float = 0.003
    skew: float = 1.5e-3
    delay: float = 2.6e-3
    cubic: float = 0.0

    def derivative(self, x: Array, u: float) -> Array:
        q_l, q_m, v_l, v_m = x
        zeta = q_m - q_l - self.offset
        tau = self.K * zeta + self.cubic * zeta**3
        on_link = tau - self.load * np.sin(q_l) - self.D_l * v_l - self.F_l * np.tanh(v_l / 0.01)
        on_motor = u - tau - self.D_m * v_m - self.F_m * np.tanh(v_m / 0.01)
        return np.array([v_l, v_m, on_link / self.M, on_motor / self.B])

    def linear(self) -> ElasticJoint:
        """Return the joint without gravity, friction and offset, whose motion is known exactly."""
        return replace(self, load=0.0, F_l=0.0, F_m=0.0, offset=0.0)


def multi_sine(t: Array, frequencies: Array, amplitude: float, seed: int) -> Array:
    phase = np.random.default_rng(seed).uniform(0, 2 * np.pi, len(frequencies))
    return np.asarray(amplitude * np.sin(2 * np.pi * frequencies * t[:, None] + phase).sum(axis=1))


Pieces = list[tuple[float, float, float]]


def _pieces(u: Array, dt: float, delay: float) -> Pieces:
    """Return (from, to, effort) of the intervals in which the effort is constant."""
    edges = np.concatenate([[0.0], np.arange(len(u)) * dt + delay, [len(u) * dt]])
    efforts = np.concatenate([[u[0]], u])
    return [(a, b, e) for a, b, e in zip(edges[:-1], np.minimum(edges[1:], edges[-1]), efforts, strict=True) if b > a]


def integrated(joint: ElasticJoint, u: Array, dt: float) -> tuple[Array, Array]:
    """Return link and motor positions (k,) as they are measured, by DOP853 from rest at 0."""
    k = np.arange(len(u)) * dt
    x, link, motor = np.array([0.0, joint.offset, 0.0, 0.0]), np.zeros(len(u)), np.zeros(len(u))
    for a, b, effort in _pieces(u, dt, joint.delay):
        step: Callable[[float, Array], Array] = lambda _, x, effort=effort: joint.derivative(x, effort)  # noqa: E731
        found = solve_ivp(step, (a, b), x, method="DOP853", rtol=1e-8, atol=1e-10, dense_output=True)
        for positions, at, row in ((link, k + joint.skew, 0), (motor, k, 1)):
            inside = (at >= a) & (at < b)
            if inside.any():
                positions[inside] = found.sol(at[inside])[row]
        x = found.y[:, -1]
    link[k + joint.skew >= len(u) * dt] = x[0]
    return link, motor


def exact(joint: ElasticJoint, u: Array, dt: float, grain: float) -> tuple[Array, Array]:
    """Return link and motor positions (k,) of a linear joint, exactly; skew and delay are multiples of grain [s]."""
    A = np.array([joint.derivative(e, 0.0) for e in np.eye(4)]).T
    block = np.zeros((5, 5))
    block[:4, :4], block[3, 4] = A, 1 / joint.B
    step = expm(block * grain)
    fine, late, skew = (round(each / grain) for each in (dt, joint.delay, joint.skew))
    x, states = np.zeros(4), [np.zeros(4)]
    for i in range(len(u) * fine):
        x = step[:4, :4] @ x + step[:4, 4] * u[max(0, (i - late) // fine)]
        states.append(x)
    at = np.arange(len(u)) * fine
    X = np.array(states)
    return X[np.clip(at + skew, 0, len(X) - 1), 0], X[at, 1]


@cache
def usual_record(
    seed: int = 0,
    seconds: float = 4.0,
    dt: float = 4e-3,
    joint: ElasticJoint = ElasticJoint(),
) -> tuple[Array, Array, Array]:
    """Return efforts, link and motor positions of a joint, the usual one, under a multi-sine, without noise."""
    u = multi_sine(np.arange(round(seconds / dt)) * dt, np.array([0.3, 0.8, 2.1, 5.3, 9.7]), 0.35, seed)
    return u, *integrated(joint, u, dt)
