# SPDX-License-Identifier: Apache-2.0
"""Compute the residual torques of each possible fault in the link and motor equations, joint by joint.

Each hypothesis is a set of columns; the residual is their sum with unknown coefficients. A wrong stiffness, for
example, leaves opposite torques proportional to the deflection in the two equations of its joint.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from ...numerics.checks import Array
from .added_body import SECOND_MOMENTS, body_torques
from .torque_residuals import Residuals

LINK, MOTOR, JOINT = "link", "motor", "joint"
SMOOTHING = 0.01
"""Speed [rad/s] below which the sign of a velocity is uncertain."""
FREEPLAYS = np.geomspace(0.02, 2.0, 40)
"""Tested half-widths of backlash relative to the RMS deflection."""
LONGEST_ARM = 1.5
"""Largest considered distance [m] of a payload from its joint."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Possible fault: kind, joint (index), side, unit of its size, and the residual (b, 2n) that it causes.

    columns (b, 2n, p): residual per unknown. size: returns the size from the p fitted unknowns, None if the fault is
    impossible. nonlinear: fits dependent unknowns from (A, c) = (X'X, X'y); None: least squares.
    """

    kind: str
    joint: int
    side: str
    unit: str
    columns: Array
    size: Callable[[Array], float | None] = lambda fitted: float(fitted[0])
    nonlinear: Callable[[Array, Array], Array] | None = None


def hypotheses(seen: Residuals) -> Iterator[Hypothesis]:
    """Return all possible faults of all joints."""
    n = seen.robot.n
    for j in range(n):
        yield from _of_side(seen, j, LINK, j)
        yield from _of_side(seen, j, MOTOR, n + j)
        yield from _of_spring(seen, j)
        yield from _of_motor(seen, j)
        yield from _of_body(seen, j)


def _of_side(seen: Residuals, j: int, side: str, channel: int) -> Iterator[Hypothesis]:
    """Return constant torque, frictions and position offset of one side of a joint."""
    dq, robot = seen.dq[:, channel], seen.robot
    one, damping = _single(seen, channel), (robot.D_l if side == LINK else robot.D_m)[j, j]
    yield Hypothesis("constant torque", j, side, "N m", one(np.ones_like(dq)))
    yield Hypothesis("Coulomb friction", j, side, "N m", one(-np.tanh(dq / SMOOTHING)), _at_least(0.0))
    yield Hypothesis("viscous friction", j, side, "N m s/rad", one(-dq), _at_least(-damping))
    image = seen.of_offset(channel)[:, :, None]
    yield Hypothesis("position offset", j, side, "rad", image)


def _of_spring(seen: Residuals, j: int) -> Iterator[Hypothesis]:
    """Return stiffness and backlash: torques between link and motor."""
    n, K = seen.robot.n, seen.robot.K
    zeta = seen.q[:, n + j] - seen.q[:, j]
    pair = _pair(seen, j)
    yield Hypothesis("stiffness", j, JOINT, "%", pair(zeta), lambda fitted: 100 * float(fitted[0]) / K[j, j])
    for half in FREEPLAYS * np.sqrt(np.mean(zeta**2)):
        column = pair(-np.clip(zeta, -half, half) * K[j, j])
        yield Hypothesis("backlash", j, JOINT, "rad", column, _free_play(half), lambda A, c: np.ones(1))


def _of_motor(seen: Residuals, j: int) -> Iterator[Hypothesis]:
    """Return torque constant and inertia of the motor."""
    n, robot = seen.robot.n, seen.robot
    one = _single(seen, n + j)
    given = seen.u[:, j] * robot.B_m[j, j]
    yield Hypothesis("torque constant", j, MOTOR, "%", one(given), lambda fitted: 100 * float(fitted[0]))
    yield Hypothesis("inertia", j, MOTOR, "kg m^2", one(-seen.ddq[:, n + j]))


def _of_body(seen: Residuals, j: int) -> Iterator[Hypothesis]:
    """Return a point mass on a link and the inertia of a link about its joint."""
    n, links = seen.robot.n, seen.robot.links
    if links.end_effector is None:
        yield Hypothesis("inertia", j, LINK, "kg m^2", _single(seen, j)(-seen.ddq[:, j]))
        return
    torque = -seen.means(body_torques(links, j, seen.q[:, :n], seen.dq[:, :n], seen.ddq[:, :n]))
    columns = np.zeros((len(torque), 2 * n, torque.shape[2]))
    columns[:, :n] = torque
    still = np.zeros((len(seen.q), n))
    largest = _largest(body_torques(links, j, seen.q[:, :n], still, still)[:, j, :4])
    yield Hypothesis("gravity load", j, LINK, "N m", columns[:, :, :4], largest)
    yield Hypothesis("gravity load", j, LINK, "N m", columns, lambda fitted: largest(fitted[:4]), _point_mass)
    turning = columns[:, :, 4:7]
    yield Hypothesis("inertia", j, LINK, "kg m^2", turning, lambda fitted: float(fitted.sum()))


def _single(seen: Residuals, channel: int) -> Callable[[Array], Array]:
    """Return a function that places a signal (k,) in one equation."""
    return lambda signal: _placed(seen, {channel: signal})


def _pair(seen: Residuals, j: int) -> Callable[[Array], Array]:
    """Return a function that places a spring torque (k,) on the link and its reaction on the motor."""
    return lambda signal: _placed(seen, {j: signal, seen.robot.n + j: -signal})


def _placed(seen: Residuals, signals: dict[int, Array]) -> Array:
    columns = np.zeros((len(seen.r), 2 * seen.robot.n, 1))
    for channel, signal in signals.items():
        columns[:, channel, 0] = seen.means(signal)
    return columns


def _at_least(least: float) -> Callable[[Array], float | None]:
    """Return a function that gives the size of a friction; None if the friction would add energy."""
    return lambda fitted: float(fitted[0]) if fitted[0] > least else None


def _free_play(half: float) -> Callable[[Array], float | None]:
    return lambda fitted: 2 * float(half)


def _largest(own: Array) -> Callable[[Array], float]:
    """Return a function of fitted parameters: the largest weight torque at the joint, with its columns `own` (k, 4)."""
    return lambda fitted: float(np.abs(own @ fitted[:4]).max())


def _point_mass(A: Array, c: Array) -> Array:
    """Fit a point mass of either sign, at most LONGEST_ARM away; return its ten inertial parameters."""
    from scipy.optimize import least_squares  # loaded on use: see control/vdpbc/gains.py

    scale = np.sqrt(np.diag(A).max()) or 1.0
    values, vectors = np.linalg.eigh(A / scale**2)
    kept = values > 1e-12 * values.max()
    root = (vectors[:, kept] * np.sqrt(values[kept])).T
    target = (vectors[:, kept].T @ (c / scale)) / np.sqrt(values[kept]) / scale

    def parameters(x: Array) -> Array:
        m, r = x[0], x[1:]
        return np.array([m, *(m * r), *(m * r[i] * r[j] for i, j in SECOND_MOMENTS)])

    begins = ([m, *r] for m in (0.1, -0.1) for r in ((0.1, 0.0, 0.0), (0.0, 0.1, 0.1)))
    bounds = ([-np.inf, *(-LONGEST_ARM,) * 3], [np.inf, *(LONGEST_ARM,) * 3])
    tried = [
        least_squares(lambda x: root @ parameters(x) - target, begin, bounds=bounds, max_nfev=60) for begin in begins
    ]
    return parameters(min(tried, key=lambda each: each.cost).x)
