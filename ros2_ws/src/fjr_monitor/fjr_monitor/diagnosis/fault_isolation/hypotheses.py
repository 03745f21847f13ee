# SPDX-License-Identifier: Apache-2.0
"""Compute the residual torques of each possible fault in the link and motor equations, joint by joint.

Each hypothesis is a set of columns; the residual is their sum with unknown coefficients. A wrong stiffness, for
example, leaves opposite torques proportional to the deflection in the two equations of its joint.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from fjr_core.numerics.checks import Array

from .added_body import SECOND_MOMENTS, body_torques
from .torque_residuals import Residuals

LINK, MOTOR, JOINT = "link", "motor", "joint"
SMOOTHING = 0.01
"""Speed [rad/s] below which the sign of a velocity is uncertain."""
FREEPLAYS = np.geomspace(0.02, 2.0, 40)
"""Tested half-widths of backlash relative to the RMS deflection."""
LONGEST_ARM = 1.5
"""Largest considered distance [m] of a payload from its joint."""
STEPS = 60
"""Of the fit of a payload."""


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
    scale = np.sqrt(np.diag(A).max()) or 1.0
    values, vectors = np.linalg.eigh(A / scale**2)
    kept = values > 1e-12 * values.max()
    root = (vectors[:, kept] * np.sqrt(values[kept])).T
    target = (vectors[:, kept].T @ (c / scale)) / np.sqrt(values[kept]) / scale
    begins = ([m, *r] for m in (0.1, -0.1) for r in ((0.1, 0.0, 0.0), (0.0, 0.1, 0.1)))
    tried = [_descended(root, target, np.array(begin)) for begin in begins]
    return min(tried, key=lambda each: each[0])[1]


def _descended(root: Array, target: Array, x: Array) -> tuple[float, Array]:
    """Minimise |root p - target| over the point masses x = (m, r) from x on, by the method of Levenberg and Marquardt.

    Return half its square and p (10,). SciPy does it, too, but loads for 0.3 s, which a running node does not have.
    """
    p, slopes = _of_point_mass(x)
    error, damping = root @ p - target, 1e-3
    for _ in range(STEPS):
        J = root @ slopes
        gradient, hessian = J.T @ error, J.T @ J
        free = np.append(True, ~((np.abs(x[1:]) >= LONGEST_ARM) & (gradient[1:] * x[1:] < 0)))
        hessian = hessian[np.ix_(free, free)]
        step = np.zeros(4)
        step[free] = np.linalg.solve(hessian + damping * np.diag(np.diag(hessian) + 1e-12), -gradient[free])
        trial = np.append(x[0] + step[0], np.clip(x[1:] + step[1:], -LONGEST_ARM, LONGEST_ARM))
        p_trial, slopes_trial = _of_point_mass(trial)
        found = root @ p_trial - target
        gain = error @ error - found @ found
        if gain > 0:
            x, p, slopes, error, damping = trial, p_trial, slopes_trial, found, max(damping / 10, 1e-9)
        else:
            damping *= 10
        if abs(gain) < 1e-10 * (error @ error):
            break
    return float(error @ error) / 2, p


def _of_point_mass(x: Array) -> tuple[Array, Array]:
    """Return the inertial parameters (10,) of x = (m, r) and their derivatives (10, 4)."""
    m, r, unit = x[0], x[1:], np.eye(3)
    unscaled = np.array([1.0, *r, *(r[i] * r[j] for i, j in SECOND_MOMENTS)])
    moments = [r[j] * unit[i] + r[i] * unit[j] for i, j in SECOND_MOMENTS]
    return m * unscaled, np.column_stack([unscaled, m * np.vstack([np.zeros(3), unit, *moments])])
