# SPDX-License-Identifier: Apache-2.0
"""Laws of friction and of springs, as functions of arrays of any shape, with at most one state each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
G = 9.81  # m/s^2


@dataclass(frozen=True)
class Friction:
    """torque [N m], dw/dt = law(v, level, w, load): of velocities [rad/s], levels, the state, and the load [N m].

    turning: the velocity v_0 [rad/s] of level tanh(v / v_0); None for other shapes. excess: by which the level near
    rest is higher; stribeck: the velocity [rad/s] over which it falls. share: of the load, by which the level grows.
    """

    law: Callable[[Array, Array, Array, Array], tuple[Array, Array]]
    has_state: bool = False
    turning: Any = None
    excess: float = 0.0
    stribeck: float = 0.0
    share: float = 0.0


def coulomb(turning: Any) -> Friction:
    """Return level tanh(v / turning); turning [rad/s]: a number, or one per draw and joint."""
    return Friction(lambda v, F, w, _: (F * np.tanh(v / turning), 0 * w), turning=turning)


def root(turning: float) -> Friction:
    """Return level v / sqrt(v^2 + turning^2), which reaches the level much later than the hyperbolic tangent."""
    return Friction(lambda v, F, w, _: (F * v / np.hypot(v, turning), 0 * w))


def stribeck(turning: float, excess: float = 0.5, velocity: float = 0.05) -> Friction:
    """Return friction whose level near rest is `excess` higher, over a Stribeck velocity [rad/s]."""
    return Friction(
        lambda v, F, w, _: (F * (1 + excess * np.exp(-((v / velocity) ** 2))) * np.tanh(v / turning), 0 * w),
        turning=turning,
        excess=excess,
        stribeck=velocity,
    )


def loaded(turning: float, share: float) -> Friction:
    """Return friction that grows with the torque of the spring by a share of it, as that of gears."""
    law = lambda v, F, w, load: ((F + share * np.abs(load)) * np.tanh(v / turning), 0 * w)  # noqa: E731
    return Friction(law, turning=turning, share=share)


def one_sided(turning: float, share: float) -> Friction:
    """Return friction that is larger by a share forwards and smaller backwards."""
    return Friction(lambda v, F, w, _: (F * (np.tanh(v / turning) + share * np.tanh(v / turning) ** 2), 0 * w))


def dahl(displacement: float) -> Friction:
    """Return P. Dahl's friction: bristles of a breakaway displacement [rad], w is their deflection."""
    return Friction(lambda v, F, w, _: (F * w / displacement, v - np.abs(v) * w / displacement), has_state=True)


def lugre(displacement: float, excess: float = 0.5, velocity: float = 0.05, damping: float = 1e-3) -> Friction:
    """Return LuGre friction: Dahl's bristles with a Stribeck level and damping [s] (C. Canudas de Wit and others)."""

    def law(v: Array, F: Array, w: Array, _: Array) -> tuple[Array, Array]:
        dw = v - np.abs(v) * w / (displacement * (1 + excess * np.exp(-((v / velocity) ** 2))))
        return F / displacement * (w + damping * dw), dw

    return Friction(law, has_state=True)


@dataclass(frozen=True)
class Spring:
    """tau, tau_m, dw/dt = law(K, q_l, q_m, v_l, v_m, w): torques on link and against the motor, rate of the state.

    torque(K, zeta): of a deflection without what has a state, whose stiffness is at most `stiffest` times as large.
    """

    law: Callable[..., tuple[Array, Array, Array]]
    has_state: bool = False
    torque: Callable[[Array, Array], Array] = lambda K, zeta: K * zeta
    stiffest: float = 1.0


def of_deflection(torque: Callable[[Array, Array], Array]) -> Spring:
    """Return the spring with the torque torque(K, q_m - q_l)."""

    def law(K: Array, q_l: Array, q_m: Array, v_l: Array, v_m: Array, w: Array) -> tuple[Array, Array, Array]:
        tau = torque(K, q_m - q_l)
        return tau, tau, 0 * w

    return Spring(law, torque=torque)


def linear() -> Spring:
    """Return K zeta."""
    return of_deflection(lambda K, zeta: K * zeta)


def cubic(growth: float, at: float) -> Spring:
    """Return a spring whose secant stiffness is larger by a factor 1 + growth at a deflection `at` [rad]."""
    return of_deflection(lambda K, zeta: K * zeta * (1 + growth * (zeta / at) ** 2))


def backlash(width: float) -> Spring:
    """Return a spring with a dead zone of this width [rad]."""
    return of_deflection(lambda K, zeta: K * (zeta - np.clip(zeta, -width / 2, width / 2)))


def play_and_hardening(width: float, growth: float, at: float) -> Spring:
    """Return a cubic spring behind a dead zone of this width [rad]."""
    loose = lambda zeta: zeta - np.clip(zeta, -width / 2, width / 2)  # noqa: E731
    return of_deflection(lambda K, zeta: K * loose(zeta) * (1 + growth * (loose(zeta) / at) ** 2))


def hysteresis(share: float, slip: float) -> Spring:
    """Return a spring with a Maxwell element beside it: stiffness share K up to a deflection slip [rad]."""

    def law(K: Array, q_l: Array, q_m: Array, v_l: Array, v_m: Array, w: Array) -> tuple[Array, Array, Array]:
        rate, near = v_m - v_l, np.abs(w / (share * K * slip)) ** 4
        tau = K * (q_m - q_l) + w
        return tau, tau, share * K * rate * (1 - near * (rate * w > 0))

    return Spring(law, has_state=True, stiffest=1 + share)


def ripple(arm: Any, q_l: Array, q_m: Array, *_: Array) -> tuple[float, Array]:
    """Return a torque of 2 % of the weight six times in a turn of a motor behind a ratio of 50."""
    return 0.0, 0.02 * G * arm.arms[1] * np.sin(6 * 50 * q_m)


def warming(arm: Any, q_l: Array, q_m: Array, v_l: Array, v_m: Array, u: Array, t: Array) -> tuple[Array, Array]:
    """Return what viscous friction that falls by 20 % in 6 s, from 10 % above its mean, adds."""
    more = 0.1 - 0.2 * t / 6.0
    return -more * arm.link_damping * v_l, -more * arm.motor_damping * v_m


def weak_at_speed(arm: Any, q_l: Array, q_m: Array, v_l: Array, v_m: Array, u: Array, t: Array) -> tuple[float, Array]:
    """Return what a current loop lacks whose gain is 2 % lower at 3 rad/s."""
    return 0.0, -0.02 * u * (v_m / 3.0) ** 2


def stiffening_cable(arm: Any, q_l: Array, *_: Array) -> tuple[Array, float]:
    """Return the torque of a cable of 0.1 N m/rad at rest and twice as much at 1 rad."""
    return -0.1 * (q_l + q_l**3 / 3), 0.0


def of_neighbours(arm: Any, q_l: Array, q_m: Array, v_l: Array, v_m: Array, *_: Array) -> tuple[float, Array]:
    """Return friction of motors that drag each other: 20 % of the damping, by the speed of the one before."""
    return 0.0, -0.2 * arm.motor_damping * np.roll(v_m, 1, axis=-1) * (v_m.shape[-1] > 1)


def kinematic_error(amplitude: float, periods: float = 200.0) -> Spring:
    """Return a gear whose link is led amplitude sin(periods q_m) [rad] astray: 2 per turn behind a ratio of 100."""

    def law(K: Array, q_l: Array, q_m: Array, v_l: Array, v_m: Array, w: Array) -> tuple[Array, Array, Array]:
        tau = K * (q_m - q_l - amplitude * np.sin(periods * q_m))
        return tau, tau * (1 - amplitude * periods * np.cos(periods * q_m)), 0 * w

    return Spring(law)
