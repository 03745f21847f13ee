# SPDX-License-Identifier: Apache-2.0
"""Find exchanged joints and wrong signs of efforts and encoders in the first samples of a run.

    motor   y_m = M_m ddq_m + K zeta + D_m dq_m   must follow   B_m u
    link    y_l = M_l ddq_l + D_l dq_l            must follow   K zeta
    speed   dq                                    must follow   the slope of q

Each pair is compared without its mean (offsets, weight), with a free factor from 0.5 to 2 (wrong inertia, stiffness,
torque constant), the effort up to OLDEST samples late. A joint whose rows do not follow is suspected; then every
hypothesis on the wiring is undone in the data, and one that makes the rows follow is the fault.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .checks import Array
from .robot import Robot
from .wiring_hypotheses import Window, WiringFault, hypotheses

Flags = NDArray[np.bool_]

WINDOW = 20
"""Samples that are compared."""
FULL = WINDOW - 4
"""Samples from which on a decision is taken between explanations that are about equal."""
FEWEST = 8
"""Intervals that a comparison needs."""
OLDEST = 5
"""Samples by which an effort may act late."""
FACTORS = (0.5, 2.0)
"""Factor between the two sides of an equation that wrong parameters may make."""
SPEED_FACTORS = (0.7, 1.4)
"""Factor between a velocity and the slope of its position that a wrong scale may make."""
OVERLOAD = 10.0
"""Torque of a spring at rest over the largest weight, above which its encoders are suspected."""
CLEARER = 3.0
"""Factor in the unexplained share by which a later hypothesis must be better than one before it."""
FOLLOWS = 0.1
"""Unexplained share of a row, up to which it follows."""
FAILS = 0.3
"""Unexplained share of a row, from which on it does not follow."""
AGAINST = 1.0
"""Unexplained share that a row of a wrong sign or another joint has: more than where nothing is assumed."""
ROUGH = 0.5
"""Squares of the changes from interval to interval over those of the signal, above which the signal is noise."""
CONFIRMED = 3
"""Comparisons in a row that must agree on a fault."""
SOUND = 0.003
"""Unexplained share of a link's row, up to which the encoders of its joint are right: coupling hides wrong signs."""
EARLY, STRIDE, LATER = 2, 10, 100
"""Samples between comparisons: in the first window, in the STRIDE windows after it, and then."""
CERTAIN = 0.02
"""Unexplained share up to which a fault is believed before the window is full."""


class WiringCheck:
    """Takes samples and efforts from the start on until every joint was seen to follow, or a fault is found."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self.start()

    def start(self) -> None:
        """Begin again: nothing is known of any joint."""
        self._cleared = np.zeros(2 * self._robot.n, dtype=bool)
        self.skip()

    def skip(self) -> None:
        """Forget the samples so far: the next one does not follow them."""
        self._rows: deque[tuple[float, Array, Array, Array]] = deque(maxlen=WINDOW)
        self._count, self._agreed = 0, 0
        self._last: WiringFault | None = None

    @property
    def done(self) -> bool:
        """Return whether every joint was seen to follow."""
        return bool(self._cleared[self._robot.n :].all())

    def see(self, t: float, q: Array, dq: Array) -> WiringFault | None:
        """Take the state q, dq (2n,) at time t [s]; return a fault that CONFIRMED comparisons in a row agree on."""
        self._rows.append((t, q.copy(), dq.copy(), np.zeros(self._robot.n)))
        self._count += 1
        stride = EARLY if self._count <= WINDOW else STRIDE if self._count <= STRIDE * WINDOW else LATER
        due = self._count > FEWEST and self._count % stride == 0
        return self._compared() if due else None

    def sent(self, u: Array) -> None:
        """Take the effort u (n,) [N m] that answered the last state."""
        if self._rows:
            self._rows[-1][3][...] = u

    def _compared(self) -> WiringFault | None:
        window = Window(*(np.array(values) for values in zip(*self._rows, strict=True)))
        with np.errstate(all="ignore"):
            fault, cleared = wiring_fault(self._robot, window, self._cleared)
        self._cleared |= cleared
        self._agreed = self._agreed + 1 if fault is not None and fault == self._last else int(fault is not None)
        self._last = fault
        return fault if self._agreed >= CONFIRMED else None


def wiring_fault(robot: Robot, window: Window, cleared: Flags) -> tuple[WiringFault | None, Flags]:
    """Return the fault that explains a window of samples, or None, and what follows (2n,).

    Of these the first n say that a link follows its spring, so that the joint's encoders are right; the others that
    both equations and both velocities of a joint follow. cleared (2n,): what was seen to follow before.
    """
    n, speeds = robot.n, _speeds(window)
    rows = _Rows.of(robot, window)
    sound = cleared[:n] | ((rows.unexplained[:n] < SOUND) & rows.smooth[:n])
    right = sound & (np.concatenate([rows.unexplained, speeds.unexplained]).reshape(4, n).max(axis=0) < FOLLOWS)
    follows = np.concatenate([sound, right]) & (len(window.t) >= FULL)
    suspected = ~np.tile(cleared[n:], 2)
    velocity = _wrong_velocity(window, (speeds.unexplained > FAILS) & speeds.smooth & _differs(window) & suspected)
    if velocity is not None or right.all():
        return velocity, follows
    unlikely = _static(robot, window)
    failing = (((rows.unexplained > FAILS) & rows.smooth) | np.tile(unlikely, 2)) & suspected
    return _explained(robot, window, rows, failing, unlikely, sound), follows


@dataclass(frozen=True)
class _Rows:
    """Unexplained share of signals (k,), and whether each is smooth (k,): noise says nothing."""

    unexplained: Array
    smooth: Flags

    @classmethod
    def of(cls, robot: Robot, window: Window) -> _Rows:
        """Of the 2n equations, links then motors."""
        n, dt = robot.n, np.diff(window.t)[:, None]
        ddq, dq = np.diff(window.dq, axis=0) / dt, (window.dq[1:] + window.dq[:-1]) / 2
        q = (window.q[1:] + window.q[:-1]) / 2
        spring = (q[:, n:] - q[:, :n]) @ robot.K
        link = ddq[:, :n] @ robot.M_l(q[len(q) // 2, :n]) + dq[:, :n] @ robot.D_l
        motor = ddq[:, n:] @ robot.M_m + spring + dq[:, n:] @ robot.D_m
        given = window.u[:-1] @ robot.B_m.T
        late = [_shifted(motor, given, d) for d in range(OLDEST + 1) if len(motor) - d >= FEWEST]
        links, motors = _shifted(link, spring, 0), np.min(late, axis=0)
        return cls(np.concatenate([links, motors]), np.concatenate([_smooth(link), _smooth(motor)]))


def _speeds(window: Window) -> _Rows:
    """Return how well each velocity (2n,) follows the slope of its position."""
    slope, mean = _slopes(window)
    return _Rows(_unfollowed(mean, slope, SPEED_FACTORS), _smooth(mean))


def _differs(window: Window) -> Flags:
    """Return which velocities (2n,) differ from the slope of their position by more than the noise of that."""
    slope, mean = _slopes(window)
    noise = (np.diff(slope, axis=0) ** 2).sum(axis=0)
    return np.asarray(noise < ROUGH * ((mean - slope) ** 2).sum(axis=0))


def _slopes(window: Window) -> tuple[Array, Array]:
    """Return slopes of the positions and mean velocities of the intervals (m - 1, 2n) [rad/s]."""
    slope = np.diff(window.q, axis=0) / np.diff(window.t)[:, None]
    return slope, (window.dq[1:] + window.dq[:-1]) / 2


def _wrong_velocity(window: Window, failing: Flags) -> WiringFault | None:
    """Return the velocity that follows the slope of another position, or of its own with the sign changed."""
    (slope, mean), n = _slopes(window), window.u.shape[1]
    for channel in np.flatnonzero(failing):
        side, j, own = ("link", "motor")[channel // n], int(channel % n), mean[:, [channel]]
        first = n * (channel // n)
        left = _unfollowed(own, slope[:, first : first + n], SPEED_FACTORS)
        left[j] = _unfollowed(own, -slope[:, [channel]], SPEED_FACTORS)[0]
        k = int(np.argmin(left))
        if left[k] < FOLLOWS / 4:
            kind, joints = ("velocity sign", (j,)) if k == j else ("velocity of another joint", (j, k))
            return WiringFault(kind, joints, side)
    return None


def _static(robot: Robot, window: Window) -> Flags:
    """Return which joints (n,) have springs loaded far beyond the weight that they bear, throughout the window."""
    return np.asarray(_load(robot, window) > OVERLOAD * np.abs(robot.grad_P_l(window.q[0, : robot.n])).max() + 1e-3)


def _load(robot: Robot, window: Window) -> Array:
    """Return the least torque (n,) [N m] by which the springs differ from the weight, over the window."""
    n = robot.n
    spring = (window.q[:, n:] - window.q[:, :n]) @ robot.K
    return np.asarray(np.abs(spring - robot.grad_P_l(window.q[0, :n])).min(axis=0))


def _shifted(y: Array, x: Array, d: int) -> Array:
    """Return the unexplained share of y by x of d samples before, both without their means."""
    y, x = y[d:], x[: len(x) - d]
    return _unfollowed(y - y.mean(axis=0), x - x.mean(axis=0), FACTORS)


def _unfollowed(y: Array, x: Array, factors: tuple[float, float]) -> Array:
    """Return the share of y (m, k) that no factor within `factors` times x (m, k) explains; 1 where nothing moves."""
    power = (y * y).sum(axis=0)
    factor = np.clip(np.nan_to_num((x * y).sum(axis=0) / (x * x).sum(axis=0)), *factors)
    left = ((y - factor * x) ** 2).sum(axis=0)
    return np.where(power > 0, left / np.maximum(power, 1e-300), 1.0)


def _smooth(y: Array) -> Flags:
    """Return which of the signals (m, k) change little from interval to interval."""
    centred = y - y.mean(axis=0)
    power, change = (centred**2).sum(axis=0), (np.diff(y, axis=0) ** 2).sum(axis=0)
    return np.asarray((change < ROUGH * power) & (power > 1e-12 * (1 + (y * y).sum(axis=0))))


def _explained(
    robot: Robot,
    window: Window,
    rows: _Rows,
    failing: Flags,
    overloaded: Flags,
    sound: Flags,
) -> WiringFault | None:
    """Return the hypothesis whose undoing makes every failing row follow; of about equal ones that of an effort.

    Before the window is full, about equal ones are not told apart yet. A full window may keep failing rows of other
    joints: more than one thing is wrong then.
    """
    n, full = robot.n, len(window.t) >= FULL
    links, motors = (set(np.flatnonzero(part).tolist()) for part in failing.reshape(2, n))
    encoders = (links | motors) - set(np.flatnonzero(sound).tolist())  # the spring's torque is in both equations
    scored = [
        (*_score(robot, window, undone(window), tried, rows, failing, overloaded), tried)
        for tried, undone in hypotheses(encoders, motors, n)
    ]
    kept = [each for each in scored if each[1] < FOLLOWS]
    whole = [each for each in kept if not each[0]] or (kept if full else [])
    best = min((each[1] for each in whole), default=np.inf)
    near = sorted(each[1:] for each in whole if each[1] <= CLEARER * best or not full)
    if not near or (not full and (len(near) > 1 or best > CERTAIN)):
        return None
    return next((tried for _, tried in near if tried.kind.startswith("effort")), near[0][1])


def _score(
    robot: Robot,
    window: Window,
    undone: Window,
    tried: WiringFault,
    rows: _Rows,
    failing: Flags,
    overloaded: Flags,
) -> tuple[bool, float]:
    """Return whether rows of other joints still fail once a fault is undone, and the unexplained share of its own rows.

    That is inf where the fault is no explanation.
    """
    n = robot.n
    own = np.isin(np.arange(2 * n) % n, tried.joints)
    left = _Rows.of(robot, undone).unexplained
    eased = _load(robot, undone) < FOLLOWS * _load(robot, window)
    if (overloaded & own[:n]).any() and eased[list(tried.joints)].all():
        rest = overloaded & ~own[:n]
        score = FOLLOWS / 10 * float(left[own].mean())
    else:
        known = own & (rows.smooth | (left < FOLLOWS))
        rest = failing & ~own & (left > FAILS)
        against = (rows.unexplained[known & failing] > AGAINST).any()
        score = float(left[known].mean()) if against else np.inf
    return bool(rest.any()), score
