# SPDX-License-Identifier: Apache-2.0
"""The closed loop in one function, without ROS: in continuous time, or sampled with a zero-order hold."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from . import checks
from .checks import Array
from .errors import StateError
from .integrators import rk4_expression
from .numeric import NumericFunction
from .plant import Plant
from .reference import JETS, Reference
from .vdpbc.law import TrackingLaw

CONTINUOUS_STEP = 1e-4  # s; output step of a continuous-time run
INNER_STEP = 2.5e-4  # s; integrator step under a hold


@dataclass(frozen=True)
class Trajectory:
    """A closed-loop run at k instants: t (k,), x (k, 4n), u (k, n), jets (k, 5, n), V (k,); SI units."""

    t: Array
    x: Array
    u: Array
    jets: Array
    V: Array


def simulate(
    plant: Plant,
    law: TrackingLaw,
    reference: Reference,
    x0: ArrayLike,
    duration: float,
    sample_period: float | None = None,
    inner_step: float | None = None,
) -> Trajectory:
    """Run u(x, x, t) on the plant from x0 (4n,) for `duration` seconds.

    sample_period [s]: the law is evaluated once a sample and held (plant.step inside, at most inner_step
    each); None: continuous time, the law in every stage of a Runge-Kutta step of inner_step. Times are
    multiples of the sample period (of inner_step in continuous time) up to the duration.
    The plant's robot and the law's may differ (model mismatch). Raises StateError for shapes or numbers
    that do not fit, and when the loop diverges to non-finite numbers.
    """
    x0 = checks.vector("x0", x0, 4 * plant.robot.n, StateError)
    n = {plant.robot.n, law.robot.n, reference.n}
    if len(n) != 1:
        raise StateError(
            f"plant, law and reference have {plant.robot.n}, {law.robot.n} and {reference.n} joints; expected equal"
        )
    if inner_step is not None:
        _positive("inner_step", inner_step)
    period = sample_period if sample_period is not None else inner_step or CONTINUOUS_STEP
    t = _times(duration, period)
    if sample_period is None:
        states = _continuous(plant, law, reference, x0, t, period)
    else:
        states = _sampled(plant, law, reference, x0, t, period, inner_step or INNER_STEP)
    return _trajectory(law, t, states, reference.jets(t))


def _times(duration: float, period: float) -> Array:
    _positive("duration", duration)
    _positive("period", period)
    return np.asarray(period * np.arange(int(duration / period + 1e-9) + 1), dtype=float)


def _positive(name: str, value: float) -> None:
    if not (np.isfinite(value) and value > 0):
        raise StateError(f"{name} is {value} s; expected a positive finite number")


def _sampled(
    plant: Plant, law: TrackingLaw, reference: Reference, x0: Array, t: Array, period: float, inner_step: float
) -> list[Array]:
    steps = int(np.ceil(period / inner_step - 1e-9))
    states = [x0]
    for jets in reference.jets(t[:-1]):
        x = states[-1]
        u = law.effort(x, x, jets)
        for _ in range(steps):
            x = plant.step(x, u, period / steps)
        states.append(_finite(x, len(states) * period))
    return states


def _continuous(plant: Plant, law: TrackingLaw, reference: Reference, x0: Array, t: Array, dt: float) -> list[Array]:
    step = _closed_loop_step(plant, law)
    states = [x0]
    instants = (t[:-1], t[:-1] + dt / 2, t[1:])
    for stages in zip(*(reference.jets(instant) for instant in instants), strict=True):
        states.append(_finite(step(states[-1], *stages, dt)[0], len(states) * dt))
    return states


def _closed_loop_step(plant: Plant, law: TrackingLaw) -> NumericFunction:
    """One Runge-Kutta step of dx = f(x) + G u(x, x, t), the reference given at its three instants."""
    n = plant.robot.n
    x, dt = ca.MX.sym("x", 4 * n), ca.MX.sym("dt")
    start, middle, end = (ca.MX.sym(name, n, JETS) for name in ("start", "middle", "end"))

    def f(x: ca.MX, jets: ca.MX) -> ca.MX:
        return plant.dynamics(x, law.function(x, x, jets, ca.DM.zeros(n)))

    x_next = rk4_expression(f, x, (start, middle, end), dt)
    function = ca.Function("closed_loop_step", [x, start, middle, end, dt], [x_next])
    return NumericFunction(function, ((4 * n,), (JETS, n), (JETS, n), (JETS, n), ()))


def _finite(x: Array, t: float) -> Array:
    if not np.all(np.isfinite(x)):
        raise StateError(f"the closed loop diverged: the state is not finite at t = {t:.6g} s")
    return x


def _trajectory(law: TrackingLaw, t: Array, states: list[Array], jets: Array) -> Trajectory:
    evaluations = [law.evaluate(x, x, j) for x, j in zip(states, jets, strict=True)]
    return Trajectory(
        t, np.array(states), np.array([e.u for e in evaluations]), jets, np.array([e.V for e in evaluations])
    )
