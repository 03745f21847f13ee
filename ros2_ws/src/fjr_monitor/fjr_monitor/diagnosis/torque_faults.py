# SPDX-License-Identifier: Apache-2.0
"""Find the single fault that explains the residual torques of the link and motor equations on a record.

    link    M_l ddq_l + C dq_l + D_l dq_l + grad P_l - K zeta = r_l
    motor   M_m ddq_m + D_m dq_m + K zeta - B_m u = r_m

Each residual is the error of the one-step-ahead prediction of a velocity times the inertia, divided by the step: the
generalised momentum residual of A. De Luca, R. Mattone, Actuator failure detection and isolation using generalized
momenta, ICRA 2003. Means over blocks of intervals suppress the noise of velocity sensors, which telescopes.

Each hypothesis is a set of columns; the residual is their sum with unknown coefficients. A wrong stiffness, for
example, leaves opposite torques proportional to the deflection in the two equations of its joint. A payload is a body
fixed to a link: its joint torques are linear in its ten inertial parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from fjr_core.errors import RobotError
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.model import springs
from fjr_core.model.rigid_arm import ArmDynamics
from fjr_core.model.robot import Robot
from fjr_core.monitoring.certificate import Prediction
from fjr_core.numerics.checks import Array

from .record import Innovations
from .thresholds import BLOCK
from .verdict import EXTERNAL, Finding

FEWEST_BLOCKS = 20
"""Smallest number of blocks of a regression."""
FLOOR = 1e-3
"""Residual relative to the torques of its equation that is attributed to rounding and discretisation."""
UNKNOWN = "unknown"
EXPLAINED = 0.8
"""Share of a residual (R^2 without noise) that a fault must explain to be reported."""
SIGNIFICANT = 4.0
"""Smallest residual torque of a fault, in standard deviations of noise and rounding."""
ADVANTAGE = 0.7
"""Report a fault only if it leaves less than this fraction of what the next best kind or joint leaves."""
NEAREST = 0.1
"""Smallest share of the residual that the nearest kind must explain to be named where no fault is reported."""
EPISODE = 0.5
"""Largest share of the blocks in which an external torque acts."""
QUIET = 0.1
"""Torque of a joint relative to its largest up to which it does not act."""
NEGLIGIBLE = 0.05
"""External torque relative to that of the joint with the largest up to which a joint is not named."""
DRIVEN = 0.1
"""Share of the energy by a torque that drives a joint, above which it is no friction."""
REACTION = 0.2
"""Largest torque on a motor, relative to the largest on a link, that is attributed to the prediction of the spring."""
SECOND_MOMENTS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
PARAMETERS = 4 + len(SECOND_MOMENTS)
LINK, MOTOR, JOINT = "link", "motor", "joint"
SMOOTHING = 0.01
"""Speed [rad/s] below which the sign of a velocity is uncertain."""
FREEPLAYS = np.geomspace(0.02, 2.0, 40)
"""Tested half-widths of backlash relative to the RMS deflection."""
LONGEST_ARM = 1.5
"""Largest considered distance [m] of a payload from its joint."""
STEPS = 60
"""Of the fit of a payload."""


def fits(seen: Residuals) -> list[tuple[float, float, Hypothesis]]:
    """Return the weighted residual sum of squares, the fitted size and the fault of all hypotheses, best first."""
    y = (seen.r / seen.sigma).ravel()
    found = []
    for fault in hypotheses(seen):
        X = (fault.columns / seen.sigma[:, None]).reshape(len(y), -1)
        if not np.isfinite(X).all() or not X.any():
            continue
        if fault.nonlinear is None:
            theta = np.asarray(np.linalg.lstsq(X, y, rcond=1e-8)[0], dtype=float)
        else:
            theta = fault.nonlinear(X.T @ X, X.T @ y)
        size = fault.size(theta)
        if size is not None:
            found.append((float(((y - X @ theta) ** 2).sum()), size, fault))
    return sorted(found, key=lambda fit: fit[0])


def torque_fault(seen: Residuals, names: Sequence[str]) -> tuple[Finding, ...]:
    """Return the single fault that explains the residual torques, or "unknown" if none does; nothing if they are small.

    A fault is reported if it explains enough and clearly more than the best one of another kind or joint. Without one,
    torques that act on the links only, and not all the time, are external.
    """
    power = ((seen.r / seen.sigma) ** 2).mean(axis=0)
    if not np.isfinite(power).all() or power.max() < SIGNIFICANT**2:
        return ()
    total, noise = float(power.sum() * len(seen.r)), float(((seen.noise / seen.sigma) ** 2).sum() * len(seen.r))
    (left, size, fault), *others = fits(seen)
    next_best = next(each for each, _, other in others if (other.kind, other.joint) != (fault.kind, fault.joint))
    share = float(np.clip(1 - max(left - noise, 0.0) / max(total - noise, 1e-300), 0.0, 1.0))
    if share < EXPLAINED or max(left - noise, 0.0) > ADVANTAGE * max(next_best - noise, 0.0):
        return (external_torque(seen, names) or unexplained(fault, share, names),)
    what = f"{fault.kind} of {size:.3g} {fault.unit} explains {100 * share:.0f} % of the residual torque"
    return (
        Finding(fault.kind, names[fault.joint], fault.side, size, fault.unit, share, f"{fault.place(names)}: {what}"),
    )


def external_torque(seen: Residuals, names: Sequence[str]) -> Finding | None:
    """Return the finding that torques act on links for part of the time; None if they do not, or motors need some, too.

    It names the joints whose torque is not NEGLIGIBLE; how large they were, report.contact says. A fault of the robot
    acts all the time while it moves, and friction, which may act at low speed only, never drives a joint.
    """
    size, n = np.abs(seen.r), seen.robot.n
    largest = size.max(axis=0)
    on_l = largest[:n]
    felt = on_l > np.maximum(SIGNIFICANT * seen.sigma[:n], NEGLIGIBLE * on_l.max())
    acting = size[:, :n] > np.maximum(SIGNIFICANT * seen.sigma[:n], QUIET * on_l)
    often = float((acting & felt).any(axis=1).mean())
    power = (seen.r * seen.means(seen.dq))[:, :n]
    driven = np.maximum(power, 0.0).sum(axis=0) > DRIVEN * np.abs(power).sum(axis=0)
    if not (felt & driven).any() or often > EPISODE or largest[n:].max() > REACTION * on_l.max():
        return None
    concerned = ", ".join(names[j] for j in np.flatnonzero(felt))
    share = float((size[:, :n] ** 2).sum() / (size**2).sum())
    return Finding(EXTERNAL, concerned, LINK, np.nan, "", share, f"{EXTERNAL} on {concerned}")


def unexplained(nearest: Hypothesis, share: float, names: Sequence[str]) -> Finding:
    """Return the finding that no fault explains the residual torque, of which the nearest one explains a share."""
    sentence = "no single fault explains the residual torque"
    if share >= NEAREST:
        sentence += f"; the nearest, {nearest.kind} ({nearest.place(names)}), explains {100 * share:.0f} %"
    return Finding(UNKNOWN, "", "", np.nan, "", share, sentence)


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residual torques over b blocks of intervals, and the regressors.

    r (b, 2n) [N m]: of the link equations, then of the motor equations. sigma (2n,) [N m]: standard deviation of r due
    to noise and rounding. noise (2n,) [N m]: due to noise alone. q, dq, ddq (k, 2n): midpoint position, velocity and
    acceleration of each interval. u (k, n) [N m]: acting effort.
    """

    found: Innovations
    robot: Robot
    prediction: Prediction
    block: int
    r: Array
    sigma: Array
    noise: Array
    q: Array
    dq: Array
    ddq: Array
    u: Array

    def means(self, values: Array) -> Array:
        """Return the block means (b, ...) of values (k, ...) of the intervals."""
        return block_means(values, self.block)

    def placed(self, signals: dict[int, Array]) -> Array:
        """Return the block means (b, 2n, 1) of signals (k,), each in the equation of its number, zero elsewhere."""
        columns = np.zeros((len(self.r), 2 * self.robot.n, 1))
        for channel, signal in signals.items():
            columns[:, channel, 0] = self.means(signal)
        return columns

    def of_offset(self, channel: int, offset: float = 1e-4) -> Array:
        """Return the residual (b, 2n) [N m/rad] due to an offset of one position sensor, per radian.

        The model predicts from q + offset, the robot moves from q.
        """
        shift = np.zeros(2 * self.robot.n)
        shift[channel] = offset
        (q, dq), dt = np.split(self.found.states[:, 0], 2, axis=1), self.found.dt
        ahead = [self.prediction.along(q - sign * shift, dq, self.found.sent, dt)[1] for sign in (0.5, -0.5)]
        return self.means(torques(self.robot, q, (ahead[0] - ahead[1]) / offset, dt))


def residuals(found: Innovations, late: Array, law: TrackingLaw) -> Residuals | None:
    """Return the residuals of intervals in which no motor was saturated; None if they are too few.

    late (k, n) [N m]: acting minus sent effort.
    """
    block = int(np.clip(len(found) // (2 * FEWEST_BLOCKS), 1, BLOCK))
    if len(found) < FEWEST_BLOCKS * block:
        return None
    robot, n = law.robot, law.robot.n
    first, second = found.states.transpose(1, 0, 2)
    (q, dq), ddq = np.split((first + second) / 2, 2, axis=1), (second - first)[:, 2 * n :] / found.dt[:, None]
    raw = torques(robot, first[:, : 2 * n], found.error[:, 2 * n :], found.dt)
    raw[:, n:] -= late @ robot.B_m.T
    u, r = found.sent + late, block_means(raw, block)
    spring = np.abs(springs.torques(robot, q[:, n:] - q[:, :n]))
    scale = np.hstack([spring, spring + np.abs(u @ robot.B_m.T)])
    noise = deviation(r)
    sigma = np.hypot(noise, FLOOR * np.sqrt(np.mean(scale**2, axis=0)) + 1e-12)
    return Residuals(found, robot, Prediction(law), block, r, sigma, noise, q, dq, ddq, u)


def torques(robot: Robot, q: Array, change: Array, dt: Array) -> Array:
    """Return the torques (k, 2n) [N m] that change the velocities by `change` (k, 2n) [rad/s] within dt (k,) [s]."""
    n, rate = robot.n, change / dt[:, None]
    M_l = over_rows(lambda q_l: robot.links.M_l(q_l).full(), q[:, :n], n)
    return np.hstack([np.einsum("kij,kj->ki", M_l, rate[:, :n]), rate[:, n:] @ robot.M_m.T])


def over_rows(function: Callable[[Array], Array], rows: Array, columns: int) -> Array:
    """Return the (k, m, columns) values of a CasADi function mapped over k arguments as columns."""
    values = function(rows.T)
    return values.reshape(len(values), len(rows), columns).transpose(1, 0, 2)


def block_means(values: Array, block: int) -> Array:
    """Return the means of `block` consecutive rows; a remainder is ignored."""
    count = len(values) // block
    means: Array = values[: count * block].reshape(count, block, *values.shape[1:]).mean(axis=1)
    return means


def deviation(r: Array) -> Array:
    """Estimate the standard deviation (m,) of white noise on r (b, m) from the median of its second differences."""
    second = np.diff(r, 2, axis=0) ** 2 / 6
    return np.sqrt(np.median(second, axis=0) / 0.455)


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

    def place(self, names: Sequence[str]) -> str:
        """Return where the fault is, with the names of the joints."""
        return names[self.joint] if self.side == JOINT else f"{self.side} of {names[self.joint]}"


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
    dq, damping = seen.dq[:, channel], (seen.robot.D_l if side == LINK else seen.robot.D_m)[j, j]

    def at_least(least: float) -> Callable[[Array], float | None]:
        return lambda fitted: float(fitted[0]) if fitted[0] > least else None  # else friction would add energy

    yield Hypothesis("constant torque", j, side, "N m", seen.placed({channel: np.ones_like(dq)}))
    coulomb = seen.placed({channel: -np.tanh(dq / SMOOTHING)})
    yield Hypothesis("Coulomb friction", j, side, "N m", coulomb, at_least(0.0))
    yield Hypothesis("viscous friction", j, side, "N m s/rad", seen.placed({channel: -dq}), at_least(-damping))
    yield Hypothesis("position offset", j, side, "rad", seen.of_offset(channel)[:, :, None])


def _of_spring(seen: Residuals, j: int) -> Iterator[Hypothesis]:
    """Return stiffness and backlash: torques on the link with their reactions on the motor."""
    n, k = seen.robot.n, seen.robot.K[j, j]
    zeta = seen.q[:, n + j] - seen.q[:, j]
    bent = springs.torques(seen.robot, seen.q[:, n:] - seen.q[:, :n])[:, j] / k if seen.robot.curve else zeta
    linear = seen.placed({j: bent, n + j: -bent})
    yield Hypothesis("stiffness", j, JOINT, "%", linear, lambda fitted: 100 * float(fitted[0]) / k)
    for half in FREEPLAYS * np.sqrt(np.mean(zeta**2)):
        torque = -np.clip(zeta, -half, half) * k
        columns, play = seen.placed({j: torque, n + j: -torque}), 2 * float(half)
        yield Hypothesis("backlash", j, JOINT, "rad", columns, lambda _, play=play: play, lambda A, c: np.ones(1))  # type: ignore[misc]


def _of_motor(seen: Residuals, j: int) -> Iterator[Hypothesis]:
    """Return torque constant and inertia of the motor."""
    channel, given = seen.robot.n + j, seen.u[:, j] * seen.robot.B_m[j, j]
    gain = seen.placed({channel: given})
    yield Hypothesis("torque constant", j, MOTOR, "%", gain, lambda fitted: 100 * float(fitted[0]))
    yield Hypothesis("inertia", j, MOTOR, "kg m^2", seen.placed({channel: -seen.ddq[:, channel]}))


def _of_body(seen: Residuals, j: int) -> Iterator[Hypothesis]:
    """Return a point mass on a link and the inertia of a link about its joint."""
    n, links = seen.robot.n, seen.robot.links
    if links.end_effector is None:
        yield Hypothesis("inertia", j, LINK, "kg m^2", seen.placed({j: -seen.ddq[:, j]}))
        return
    torque = -seen.means(body_torques(links, j, seen.q[:, :n], seen.dq[:, :n], seen.ddq[:, :n]))
    columns = np.zeros((len(torque), 2 * n, torque.shape[2]))
    columns[:, :n] = torque
    still = np.zeros((len(seen.q), n))
    weights = body_torques(links, j, seen.q[:, :n], still, still)[:, j, :4]

    def largest(fitted: Array) -> float:
        return float(np.abs(weights @ fitted[:4]).max())  # weight torque at the joint

    yield Hypothesis("gravity load", j, LINK, "N m", columns[:, :, :4], largest)
    yield Hypothesis("gravity load", j, LINK, "N m", columns, largest, _point_mass)
    yield Hypothesis("inertia", j, LINK, "kg m^2", columns[:, :, 4:7], lambda fitted: float(fitted.sum()))


def _point_mass(A: Array, c: Array) -> Array:
    """Fit a point mass of either sign, at most LONGEST_ARM away; return its ten inertial parameters."""
    from scipy.optimize import least_squares  # 0.3 s of imports, which the running nodes do not need

    scale = np.sqrt(np.diag(A).max()) or 1.0
    values, vectors = np.linalg.eigh(A / scale**2)
    kept = values > 1e-12 * values.max()
    root = (vectors[:, kept] * np.sqrt(values[kept])).T
    target = (vectors[:, kept].T @ (c / scale)) / np.sqrt(values[kept]) / scale
    begins = ([m, *r] for m in (0.1, -0.1) for r in ((0.1, 0.0, 0.0), (0.0, 0.1, 0.1)))
    bounds = [-np.inf, *[-LONGEST_ARM] * 3], [np.inf, *[LONGEST_ARM] * 3]
    tried = [
        least_squares(
            lambda x: root @ _of_point_mass(x)[0] - target,
            begin,
            lambda x: root @ _of_point_mass(x)[1],
            bounds,
            x_scale="jac",
            max_nfev=STEPS,
        )
        for begin in begins
    ]
    return _of_point_mass(min(tried, key=lambda each: float(each.cost)).x)[0]


def _of_point_mass(x: Array) -> tuple[Array, Array]:
    """Return the inertial parameters (10,) of x = (m, r) and their derivatives (10, 4)."""
    m, r, unit = x[0], x[1:], np.eye(3)
    unscaled = np.array([1.0, *r, *(r[i] * r[j] for i, j in SECOND_MOMENTS)])
    moments = [r[j] * unit[i] + r[i] * unit[j] for i, j in SECOND_MOMENTS]
    return m * unscaled, np.column_stack([unscaled, m * np.vstack([np.zeros(3), unit, *moments])])


def body_torques(links: ArmDynamics, link: int, q_l: Array, dq_l: Array, ddq_l: Array) -> Array:
    """Return the torques (k, n, 10) per inertial parameter of a body fixed to `link`, at k states (k, n).

    Parameters: m [kg]; m r [kg m] (3); sum m r r' [kg m^2] (6, in the order of SECOND_MOMENTS), r in the frame of
    the last link with the joints after `link` held at 0. d/dt dL/d(dq_l) - dL/dq_l with the Lagrangian
    L = sum m (|dp|^2 / 2 + g'p), p = p_0 + R r. Raises RobotError for links without an end-effector frame.
    """
    function, n = _function(links, link), links.n
    return over_rows(lambda rows: function(rows).full(), np.hstack([q_l, dq_l, ddq_l]), PARAMETERS).reshape(-1, n, 10)


def _function(links: ArmDynamics, link: int) -> ca.Function:
    """Build the function (q_l, dq_l, ddq_l) stacked -> (n, 10)."""
    if links.end_effector is None:
        raise RobotError("the links have no end-effector frame; expected links with one")
    n = links.n
    state, theta = ca.SX.sym("state", 3 * n), ca.SX.sym("theta", PARAMETERS)
    q_l, dq_l, ddq_l = ca.vertsplit(state, n)
    held = ca.vertcat(q_l[: link + 1], ca.SX.zeros(n - link - 1))
    p_0 = links.end_effector.position(held, ca.SX.zeros(3))
    R = ca.horzcat(*(links.end_effector.position(held, ca.SX.eye(3)[:, i]) - p_0 for i in range(3)))
    dp_0, dR = ca.jtimes(p_0, q_l, dq_l), ca.reshape(ca.jtimes(ca.vec(R), q_l, dq_l), 3, 3)
    m, mr, moments = theta[0], theta[1:4], theta[4:]
    S = ca.SX(3, 3)
    for value, (i, j) in zip(ca.vertsplit(moments), SECOND_MOMENTS, strict=True):
        S[i, j] = S[j, i] = value
    kinetic = m * ca.dot(dp_0, dp_0) / 2 + ca.dot(dp_0, dR @ mr) + ca.trace(dR @ S @ dR.T) / 2
    L = kinetic + ca.dot(ca.DM(links.end_effector.gravity), m * p_0 + R @ mr)
    momentum = ca.gradient(L, dq_l)
    rate = ca.jtimes(momentum, ca.vertcat(q_l, dq_l), ca.vertcat(dq_l, ddq_l))
    torque = rate - ca.gradient(L, q_l)
    return ca.Function("body_torques", [state], [ca.densify(ca.jacobian(torque, theta))], {"cse": True})
