# SPDX-License-Identifier: Apache-2.0
"""The check of the wiring in NumPy, from the equations of runtime/wiring.c with full matrices."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fjr_core.model import springs
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array
from fjr_core.runtime.events import SENTENCES, Finding

Order = NDArray[np.intp]


@dataclass(frozen=True)
class Window:
    """m samples: t (m,) [s]; q, dq (m, 2n): links, then motors; u (m, n) [N m]: command for each sample."""

    t: Array
    q: Array
    dq: Array
    u: Array


class WiringFault(NamedTuple):
    """Kind, side and joints (indices) of a fault."""

    kind: str
    joints: tuple[int, ...]
    side: str

    def finding(self, names: Sequence[str]) -> Finding:
        """Return the fault as the product says it."""
        first, last, both = names[self.joints[0]], names[self.joints[-1]], " and ".join(names[j] for j in self.joints)
        sentence = SENTENCES[self.kind].format(joints=both, side=self.side, first=first, last=last)
        return Finding(self.kind, first if self.kind.startswith("velocity") else both, self.side, sentence=sentence)


Undone = Callable[[Window], Window]


def hypotheses(encoders: set[int], efforts: set[int], n: int) -> Iterator[tuple[WiringFault, Undone]]:
    """Return the possible faults of suspected joints, each with the correction that undoes it."""
    none, same, same_encoders = np.ones(2 * n), np.arange(n), np.arange(2 * n)
    for j in sorted(efforts):
        yield WiringFault("effort sign", (j,), "motor"), _effort(same, _signs(n, j))
    if len(efforts) > 1:
        signs = np.where(np.isin(same, sorted(efforts)), -1.0, 1.0)
        yield WiringFault("effort sign", tuple(sorted(efforts)), "motor"), _effort(same, signs)
    for i, j in combinations(sorted(efforts), 2):
        yield WiringFault("efforts exchanged", (i, j), "motor"), _effort(_order(n, i, j), none[:n])
    for side, name in ((0, "link"), (n, "motor")):
        for j in sorted(encoders):
            yield WiringFault("encoder sign", (j,), name), _encoders(same_encoders, _signs(2 * n, side + j))
        for i, j in combinations(sorted(encoders), 2):
            yield WiringFault("encoders exchanged", (i, j), name), _encoders(_order(2 * n, side + i, side + j), none)


def _effort(order: Order, signs: Array) -> Undone:
    return lambda w: Window(w.t, w.q, w.dq, (w.u * signs)[:, order])


def _encoders(order: Order, signs: Array) -> Undone:
    return lambda w: Window(w.t, (w.q * signs)[:, order], (w.dq * signs)[:, order], w.u)


def _signs(size: int, at: int) -> Array:
    return np.where(np.arange(size) == at, -1.0, 1.0)


def _order(size: int, one: int, other: int) -> Order:
    order = np.arange(size)
    order[[one, other]] = order[[other, one]]
    return order


Flags = NDArray[np.bool_]

TOLERANCE = 0.15
SCALE = 0.08
LAGS, LAG = 5, 0.5
LATE = 0.5
MOTION = 5
WEIGHT, OFFSET, SHIFT = 0.1, 1e-3, 1e-4
ROUNDING = 0.01
DOUBT = 1.5
FREEDOM, REST = 0.4, 0.7


@dataclass(frozen=True)
class Rows:
    """Both sides y, x (2n, k) of the rows of links, then of motors: torques or velocities.

    root (2n, k, k): inverse Cholesky factors of the covariances S. freedom: degrees of freedom of the noise.
    """

    y: Array
    x: Array
    root: Array
    freedom: float

    @classmethod
    def torques(cls, robot: Robot, window: Window, constant: Array) -> Rows:
        """Return the torques in the m - 1 intervals; constant (n,) [N m]: standard deviation of constant ones."""
        means = _Means.of(window)
        parts = _links(robot, window, means, constant), _motors(robot, window, means, constant)
        y, x = (np.concatenate([side.T for side in sides]) for sides in zip(*(part[:2] for part in parts), strict=True))
        S = np.concatenate([loose.transpose(2, 1, 0) @ loose.transpose(2, 0, 1) for _, _, loose, _, _ in parts])
        mean, change = (np.concatenate(noise) for noise in zip(*(part[3:] for part in parts), strict=True))
        rounding = ROUNDING**2 * ((y**2).mean(axis=1) + (x**2).mean(axis=1)) + 1e-18
        for variance, of in zip((mean, change, rounding), _correlations(y.shape[1]), strict=True):
            S += variance[:, None, None] * of
        return cls(y, x, np.linalg.inv(np.linalg.cholesky(S)), FREEDOM * (y.shape[1] - 3))

    @classmethod
    def velocities(cls, window: Window) -> Rows:
        """Return measured velocities and slopes as components along MOTION polynomials of time: slow motion.

        The noise is white, with the mean square of what the polynomials leave of their difference.
        """
        means, Q = _Means.of(window), slow(len(window.t) - 1)
        y, x, change = (values.T @ Q for values in (means.dq, means.slope, np.diff(window.dq, axis=0)))
        left = means.dq - means.slope
        noise = ((left - Q @ (Q.T @ left)) ** 2).sum(axis=0) / (len(Q) - MOTION) + 1e-18
        noise += ROUNDING**2 * ((means.dq**2).mean(axis=0) + (means.slope**2).mean(axis=0))
        S = SCALE**2 * x[:, :, None] * x[:, None] + LATE**2 * change[:, :, None] * change[:, None]
        S += noise[:, None, None] * np.eye(MOTION)
        return cls(y, x, np.linalg.inv(np.linalg.cholesky(S)), REST * (len(Q) - MOTION))

    def misfit(self, sign: float = 1.0) -> Array:
        """Return (y - x)' S^-1 (y - x) of the rows (2n,), with x multiplied by `sign`."""
        return distances(self.root, self.y - sign * self.x)

    @property
    def squares(self) -> Array:
        """Return the mean squares (4n,) of y - x."""
        return np.asarray(((self.y - self.x) ** 2).mean(axis=1))

    @property
    def deviance(self) -> float:
        """Return minus twice the log-likelihood of all rows, without its constant."""
        log_det = -2 * np.log(np.diagonal(self.root, axis1=1, axis2=2)).sum()
        return float(self.student(self.misfit()).sum() + log_det)

    def student(self, misfit: Array) -> Array:
        """Return minus twice the logarithm of Student's density of misfits: the noise is estimated."""
        return np.asarray((self.freedom + self.y.shape[1]) * np.log1p(misfit / self.freedom))


def slow(m: int) -> Array:
    """Return MOTION orthonormal polynomials of time (m, MOTION)."""
    return np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, m), MOTION, increasing=True))[0]


def distances(root: Array, difference: Array) -> Array:
    """Return the squared norms (k,) of differences (k, m) in units of S, with inverse Cholesky factors (k, m, m)."""
    return np.asarray(((root @ difference[..., None])[..., 0] ** 2).sum(axis=1))


def torque_tolerance(robot: Robot, q: Array) -> Array:
    """Return the standard deviation (n,) [N m] of constant torques: friction, payload, offsets of encoders.

    The largest weight is that at the links' positions in q (2n,) or with one of them turned by pi / 2, of the revolute
    joints [N m], and of the prismatic ones [N].
    """
    slides = np.array(robot.prismatic or (False,) * robot.n)
    turned = q[: robot.n] + np.pi / 2 * np.eye(robot.n + 1, robot.n) * ~slides
    weight = np.abs([robot.grad_P_l(each) for each in turned]).max(axis=0)
    most = [max(weight[kind], default=0.0) for kind in (~slides, slides)]
    return np.where(slides, WEIGHT * most[1] + SHIFT * np.diag(robot.K), WEIGHT * most[0] + OFFSET * np.diag(robot.K))


@dataclass(frozen=True)
class _Means:
    """Means q, dq and slopes slope, ddq of positions and velocities over the intervals (m - 1, 2n).

    position, velocity (2n,): variances of the noise of the sensors. rate: 1 / h^2 of the mean interval h [1/s^2].
    """

    q: Array
    dq: Array
    slope: Array
    ddq: Array
    position: Array
    velocity: Array
    rate: float

    @classmethod
    def of(cls, window: Window) -> _Means:
        h, q, dq = np.diff(window.t)[:, None], window.q, window.dq
        slope, ddq = np.diff(q, axis=0) / h, np.diff(dq, axis=0) / h
        rate = float(1 / h.mean() ** 2)
        return cls((q[1:] + q[:-1]) / 2, (dq[1:] + dq[:-1]) / 2, slope, ddq, _noise(q), _noise(dq), rate)


_Part = tuple[Array, Array, Array, Array, Array]


def _links(robot: Robot, window: Window, means: _Means, constant: Array) -> _Part:
    n, middle = robot.n, len(means.q) // 2
    q_l, dq_l, ddq_l = means.q[middle, :n], means.dq[middle, :n], means.ddq[:, :n]
    M_l, spring, weight = robot.M_l(q_l), _spring(robot, means), _weights(robot, window.q[:, :n])
    y = ddq_l @ M_l + means.dq[:, :n] @ robot.D_l + robot.coriolis(q_l, dq_l, dq_l) + weight
    size = np.sqrt(np.diag(M_l))
    coupled = size * (ddq_l * size).T[..., None]  # torques of the motion of each joint, as large as full coupling
    loose = np.stack([np.broadcast_to(constant, y.shape), *TOLERANCE * np.stack([spring, weight, *coupled])])
    return y, spring, loose, _spring_noise(robot, means), means.rate * M_l**2 @ means.velocity[:n]


def _motors(robot: Robot, window: Window, means: _Means, constant: Array) -> _Part:
    n, spring, effort = robot.n, _spring(robot, means), _late_efforts(robot, window)
    motion = means.ddq[:, n:] @ robot.M_m
    y = motion + spring + means.dq[:, n:] @ robot.D_m
    wrong = TOLERANCE * np.stack([spring, motion, effort[0]])
    loose = np.concatenate([np.broadcast_to(constant, y.shape)[None], wrong, LAG * (effort[1:] - effort[0])])
    return y, effort[0], loose, _spring_noise(robot, means), means.rate * robot.M_m**2 @ means.velocity[n:]


def _spring(robot: Robot, means: _Means) -> Array:
    """Return the torque of the springs in the intervals (m - 1, n) [N m]."""
    return springs.torques(robot, means.q[:, robot.n :] - means.q[:, : robot.n])


def _spring_noise(robot: Robot, means: _Means) -> Array:
    """Return the variance (n,) of the noise of the springs' torque [N^2 m^2]."""
    middle = means.q[len(means.q) // 2]
    (harder,) = springs.hardening(robot, (middle[robot.n :] - middle[: robot.n])[None])
    return np.asarray((robot.K * harder[:, None]) ** 2 @ (means.position[: robot.n] + means.position[robot.n :]))


def _weights(robot: Robot, q_l: Array) -> Array:
    """Return grad P_l of the intervals (m - 1, n) [N m], interpolated between the ends of the window."""
    first, last = robot.grad_P_l(q_l[0]), robot.grad_P_l(q_l[-1])
    return np.asarray(first + np.linspace(0.0, 1.0, len(q_l) - 1)[:, None] * (last - first))


def _late_efforts(robot: Robot, window: Window) -> Array:
    """Return B_m u (LAGS + 1, m - 1, n) [N m], delayed by 0 to LAGS samples; zero before the window."""
    return delayed(window.u[:-1] @ robot.B_m.T, np.zeros(robot.n))


def delayed(values: Array, before: Array | float) -> Array:
    """Return values (m, ...) delayed by 0 to LAGS samples (LAGS + 1, m, ...); before: value before the first one."""
    given = np.concatenate([np.broadcast_to(before, (LAGS, *values.shape[1:])), values])
    return np.stack([given[LAGS - late : len(given) - late] for late in range(LAGS + 1)])


def filtered(values: Array, before: float) -> Array:
    """Return values (m,) through low-passes (LAGS, m) with time constants of 1, 4, 9, .. intervals; before: first."""
    found = np.zeros((LAGS, len(values)))
    age = np.subtract.outer(np.arange(len(values)), np.arange(len(values)))
    for row, constant in zip(found, np.arange(1, LAGS + 1) ** 2, strict=True):
        left = constant / (1 + constant)
        row[:] = before * left ** np.arange(1, len(values) + 1) + np.tril(left**age) @ values * (1 - left)
    return found


def _noise(values: Array) -> Array:
    """Return the variance of the noise of smooth signals (m, k), from their differences of fourth order."""
    return np.asarray(DOUBT * (np.diff(values, 4, axis=0) ** 2).mean(axis=0) / 70)


def _correlations(m: int) -> tuple[Array, Array, Array]:
    """Return correlations (m, m) of means and of differences of white noise over intervals, and of white noise."""
    one, next_to = np.eye(m), np.eye(m, k=1) + np.eye(m, k=-1)
    return one / 2 + next_to / 4, 2 * one - next_to, one


WINDOW, FEWEST = 21, 9
FULL = WINDOW - 2
EVIDENCE = 2 * math.log(1e5)
CLEARER = 2 * math.log(1e2)
FILTERED = 2 * math.log(1e6)
FAILS = 1.25
FITS, FOLLOWS = 1.6, 3.0
CLOSER = 2.0
COARSE = 0.5
CONFIRMED = 2
EARLY, RARER = 2, 1.1
LOADED = 100.0


class NumericCheck:
    """Check of the wiring with samples and efforts from the start until every joint is right or a fault is found.

    last: fault of the last comparison, of which CONFIRMED in a row are needed; right, misfit (4n,): of its rows.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self.right = np.zeros(4 * robot.n, dtype=bool)
        self.misfit = np.zeros(4 * robot.n)
        self._rows: deque[tuple[float, Array, Array, Array]] = deque(maxlen=WINDOW)
        self._count, self._agreed, self._due = 0, 0, FEWEST
        self.last: WiringFault | None = None
        self._constant: Array | None = None

    def see(self, t: float, q: Array, dq: Array) -> WiringFault | None:
        """Take the state q, dq (2n,) at time t [s]; return the fault if CONFIRMED comparisons in a row find one."""
        self._rows.append((t, q.copy(), dq.copy(), np.zeros(self._robot.n)))
        self._count += 1
        if self._count < self._due:
            return None
        early = EARLY if self._count < FULL else 1
        self._due = self._count + early if self._count < WINDOW else math.ceil(RARER * self._count)
        return self._compared()

    def sent(self, u: Array) -> None:
        """Take the command u (n,) [N m] for the last state."""
        self._rows[-1][3][...] = u

    def _compared(self) -> WiringFault | None:
        window = Window(*(np.array(values) for values in zip(*self._rows, strict=True)))
        if self._constant is None:
            self._constant = torque_tolerance(self._robot, window.q[0])
        constant = self._constant * (1.0 if self._count <= WINDOW else LOADED)
        fault, right, self.misfit = wiring_fault(self._robot, window, self.right, constant)
        self.right |= right
        same = fault is not None and self.last is not None and fault.joints[0] == self.last.joints[0]
        self._agreed = self._agreed + 1 if same else int(fault is not None)
        self.last = fault
        return fault if self._agreed >= CONFIRMED else None


def wiring_fault(
    robot: Robot, window: Window, known: Flags, constant: Array
) -> tuple[WiringFault | None, Flags, Array]:
    """Return the fault that explains a window of samples, or None, flags of the rows that are right (4n,), and misfits.

    A row is right if it agrees and the evidence against a changed sign of one side suffices. known (4n,): flags so
    far. constant (n,) [N m]: standard deviation of constant torques.
    """
    n, count, full = robot.n, len(window.t) - 1, len(window.t) >= FULL
    rows, speeds = Rows.torques(robot, window, constant), Rows.velocities(window)
    sizes = np.repeat([count, MOTION], 2 * n)
    misfit, reversed_ = (np.concatenate([rows.misfit(sign), speeds.misfit(sign)]) for sign in (1.0, -1.0))
    right = (reversed_ - misfit > EVIDENCE) & (misfit < FITS * sizes) & full
    failing = (misfit > FAILS * sizes) & ~known
    velocity = _wrong_velocity(speeds, window, failing[2 * n :], full)
    if velocity is not None:
        return velocity, right, misfit
    links, motors = (set(np.flatnonzero(part).tolist()) for part in failing[: 2 * n].reshape(2, n))
    encoders = (links | motors) - set(np.flatnonzero(known[:n]).tolist())  # the spring is in both equations
    drives = robot.B_m != 0
    efforts = set(np.flatnonzero(drives[sorted(motors)].any(axis=0)).tolist())
    found: list[tuple[float, WiringFault]] = []
    for fault, undone in hypotheses(encoders, efforts, n):
        joints = np.isin(np.arange(n), fault.joints)
        concerned = drives[:, joints].any(axis=1) if fault.kind.startswith("effort") else joints
        left, own = Rows.torques(robot, undone(window), constant), np.tile(concerned, 2)
        closer = CLOSER * left.squares[own].sum() < rows.squares[own].sum()
        if closer and left.misfit()[own].max() < FITS * count:
            found.append((rows.deviance - left.deviance, fault))
    return _decided([each for each in found if each[0] > EVIDENCE], full), right, misfit


def _decided(found: list[tuple[float, WiringFault]], full: bool) -> WiringFault | None:
    """Return the fault with the largest evidence, or an effort's of nearly equal ones; None while they are open.

    Link and motor encoder of a joint cannot be told apart at rest: either stops the robot at once.
    """
    near = [each for each in found if each[0] > max(found)[0] - CLEARER]
    if not near or (not full and len({(fault.kind, fault.joints) for _, fault in near}) > 1):
        return None
    return max([each for each in near if each[1].kind.startswith("effort")] or near)[1]


def _wrong_velocity(rows: Rows, window: Window, failing: Flags, full: bool) -> WiringFault | None:
    """Return the fault of a velocity that follows the slope of another position, or of its own with changed sign.

    A velocity that follows its own slope late, such as a filter's, is right. It is assumed to be 100 times rarer.
    """
    n, means, Q = len(failing) // 2, _Means.of(window), slow(len(window.t) - 1)
    coarse = (means.slope == 0.0).mean(axis=0) > COARSE
    for row in np.flatnonzero(failing & ~coarse):
        side, j, first = ("link", "motor")[row // n], int(row % n), row - row % n
        slopes = rows.x[first : first + n].copy()
        slopes[j] *= -1.0
        left = np.where(coarse[first : first + n], np.inf, distances(rows.root[row], rows.y[row] - slopes))
        k = int(np.argmin(left))
        clear = full or bool((np.delete(left, k) > left[k] + CLEARER).all())
        own = means.slope[:, row], means.dq[0, row]
        late, low_passed = (
            rows.student(distances(rows.root[row], rows.y[row] - x @ Q)) for x in (delayed(*own), filtered(*own))
        )
        noise = rows.student(distances(rows.root[row : row + 1], rows.y[row : row + 1]))[0]  # velocity and slopes
        others = late[0], late[1:].min() + CLEARER, low_passed.min() + FILTERED, noise + CLEARER
        evidence = min(others) - float(rows.student(left[k]))
        if clear and left[k] < FOLLOWS * MOTION and evidence > EVIDENCE:
            kind, joints = ("velocity sign", (j,)) if k == j else ("velocity of another joint", (j, k))
            return WiringFault(kind, joints, side)
    return None
