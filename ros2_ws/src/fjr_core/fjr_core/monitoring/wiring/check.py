# SPDX-License-Identifier: Apache-2.0
"""Find exchanged joints and wrong signs of efforts and encoders in the first samples of a run.

A joint is suspected if its signals do not follow each other (see signals). Each hypothesis on the wiring is then undone
in the data. The fault is a hypothesis that makes the signals follow and that no other measured torque contradicts.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from ...numerics.checks import Array
from ...robot.robot import Robot
from .hypotheses import Window, WiringFault, hypotheses
from .signals import (
    FEWEST,
    SPEED_FACTORS,
    Flags,
    Rows,
    differs,
    link_torques,
    motor_squares,
    slopes,
    speeds,
    unfollowed,
)

WINDOW = 20
"""Number of samples compared."""
FULL = WINDOW - 4
"""Number of samples from which a choice is made between nearly equal explanations."""
PIECE = 4
"""Number of intervals over which spring torques are averaged."""
OVERLOAD = 2.0
"""Suspect the encoders of a joint if its spring torque minus weight and motion exceeds this multiple of the weight."""
EASED = 0.05
"""Largest fraction of such a torque that remains after the right fault is undone."""
CLEARER = 3.0
"""Factor in the unexplained share by which a hypothesis must be better than another one."""
FOLLOWS = 0.1
"""Largest unexplained share of a row that follows."""
FAILS = 0.3
"""Smallest unexplained share of a row that fails to follow."""
AGAINST = 1.0
"""Smallest unexplained share of a row with a wrong sign or of another joint."""
WORSE = 1.1
"""Factor by which noise may raise the unexplained share of a row when the right fault is undone."""
CONFIRMED = 3
"""Number of consecutive comparisons that must agree on a fault."""
SOUND = 0.003
"""Largest unexplained share of a link row whose encoders are right; small because coupling hides wrong signs."""
EARLY, RARER = 2, 1.1
"""Samples between comparisons in the first window, and ratio of the sample counts of later comparisons.

The mean cost per sample vanishes if noise hides whether a joint follows.
"""
CERTAIN = 0.02
"""Largest unexplained share at which a fault is reported before the window is full."""


class WiringCheck:
    """Check of the wiring with samples and efforts from the start until every joint follows or a fault is found."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self.start()

    def start(self) -> None:
        """Start again with no joint checked."""
        self._cleared = np.zeros(2 * self._robot.n, dtype=bool)
        self.skip()

    def skip(self) -> None:
        """Discard the samples so far; the next one does not follow them."""
        self._rows: deque[tuple[float, Array, Array, Array]] = deque(maxlen=WINDOW)
        self._count = self._due = self._agreed = 0
        self._last: WiringFault | None = None

    @property
    def done(self) -> bool:
        """Return whether the signals of every joint follow."""
        return bool(self._cleared[self._robot.n :].all())

    def see(self, t: float, q: Array, dq: Array) -> WiringFault | None:
        """Take the state q, dq (2n,) at time t [s]; return a fault that CONFIRMED comparisons in a row agree on."""
        self._rows.append((t, q.copy(), dq.copy(), np.zeros(self._robot.n)))
        self._count += 1
        if self._count <= FEWEST or self._count < self._due:
            return None
        self._due = self._count + EARLY if self._count < WINDOW else math.ceil(RARER * self._count)
        return self._compared()

    def sent(self, u: Array) -> None:
        """Take the command u (n,) [N m] for the last state."""
        if self._rows:
            self._rows[-1][3][...] = u

    def _compared(self) -> WiringFault | None:
        window = Window(*(np.array(values) for values in zip(*self._rows, strict=True)))
        with np.errstate(all="ignore"):
            fault, cleared = wiring_fault(self._robot, window, self._cleared, self._count <= WINDOW)
        self._cleared |= cleared
        self._agreed = self._agreed + 1 if fault is not None and fault == self._last else int(fault is not None)
        self._last = fault
        return fault if self._agreed >= CONFIRMED else None


def wiring_fault(
    robot: Robot, window: Window, cleared: Flags, starting: bool = True
) -> tuple[WiringFault | None, Flags]:
    """Return the fault that explains a window of samples, or None, and flags of what follows (2n,).

    The first n flags: the link follows its spring, so that the encoders of the joint are right. The others: both
    equations and both velocities of the joint follow. cleared (2n,): flags so far. starting: true for the first window;
    later, external torques may load the springs, so that loads are no evidence.
    """
    n, velocities = robot.n, speeds(window)
    rows = Rows.of(robot, window)
    sound = cleared[:n] | ((rows.unexplained[:n] < SOUND) & rows.smooth[:n])
    right = sound & (np.concatenate([rows.unexplained, velocities.unexplained]).reshape(4, n).max(axis=0) < FOLLOWS)
    follows = np.concatenate([sound, right]) & (len(window.t) >= FULL)
    suspected = ~np.tile(cleared[n:], 2)
    velocity = _wrong_velocity(
        window, (velocities.unexplained > FAILS) & velocities.smooth & differs(window) & suspected
    )
    if velocity is not None or right.all():
        return velocity, follows
    load = _Load.of(robot, window)
    overloaded = load.unlikely & starting
    failing = (((rows.unexplained > FAILS) & rows.smooth) | np.tile(overloaded, 2)) & suspected
    return _Evidence(robot, window, rows, load, failing, overloaded, sound).explained(), follows


def _wrong_velocity(window: Window, failing: Flags) -> WiringFault | None:
    """Return the fault of a velocity that follows the slope of another position, or of its own with changed sign."""
    (slope, mean), n = slopes(window), window.u.shape[1]
    for channel in np.flatnonzero(failing):
        side, j, own = ("link", "motor")[channel // n], int(channel % n), mean[:, [channel]]
        first = n * (channel // n)
        left = unfollowed(own, slope[:, first : first + n], SPEED_FACTORS)
        left[j] = unfollowed(own, -slope[:, [channel]], SPEED_FACTORS)[0]
        k = int(np.argmin(left))
        if left[k] < FOLLOWS / 4:
            kind, joints = ("velocity sign", (j,)) if k == j else ("velocity of another joint", (j, k))
            return WiringFault(kind, joints, side)
    return None


@dataclass(frozen=True)
class _Load:
    """Spring torques minus weight and motion of the links [N m]: RMS of means over PIECE intervals, and |mean| (n,).

    weight: largest of all joints; motion (n,): mean torque of the motion.
    """

    rms: Array
    mean: Array
    weight: float
    motion: Array

    @classmethod
    def of(cls, robot: Robot, window: Window) -> _Load:
        n, q, motion = robot.n, window.q[:-1], link_torques(robot, window)
        weights = np.array([robot.grad_P_l(q[0, :n]), robot.grad_P_l(q[-1, :n])])
        along = np.linspace(0.0, 1.0, len(q))[:, None]
        load = (q[:, n:] - q[:, :n]) @ robot.K - motion - weights[0] - along * (weights[1] - weights[0])
        pieces = load[len(load) % PIECE :].reshape(-1, PIECE, n).mean(axis=1)  # the noise of velocities telescopes
        size, weight = np.sqrt((pieces**2).mean(axis=0)), float(np.abs(weights).max())
        return cls(size, np.abs(load.mean(axis=0)), weight, np.abs(motion.mean(axis=0)))

    @property
    def unlikely(self) -> Flags:
        """Return which spring torques far exceed weight and motion."""
        return np.asarray(self.rms > OVERLOAD * self.weight + 1e-3)


@dataclass(frozen=True)
class _Evidence:
    """Rows (2n,) and loads (n,) of a window as measured, with flags of failing rows and overloaded joints."""

    robot: Robot
    window: Window
    rows: Rows
    load: _Load
    failing: Flags
    overloaded: Flags
    sound: Flags

    def explained(self) -> WiringFault | None:
        """Return the hypothesis that makes every failing row follow once it is undone.

        Of nearly equal hypotheses, the best one on an effort is returned, else the best one. Under a static load it is
        the first, since link and motor cannot be distinguished at rest. Before the window is full, None is returned for
        nearly equal hypotheses. With a full window, rows of other joints may still fail: there are several faults.
        """
        n, full = self.robot.n, len(self.window.t) >= FULL
        links, motors = (set(np.flatnonzero(part).tolist()) for part in self.failing.reshape(2, n))
        encoders = (links | motors) - set(np.flatnonzero(self.sound).tolist())  # the spring is in both equations
        scored = [
            (*self._score(undone(self.window), tried), tried) for tried, undone in hypotheses(encoders, motors, n)
        ]
        kept = [each for each in scored if each[1] < FOLLOWS]
        whole = [each for each in kept if not each[0]] or (kept if full else [])
        best = min((each[1] for each in whole), default=np.inf)
        near = [each[1:] for each in whole if each[1] <= CLEARER * best or not full]
        if not near or (not full and (len(near) > 1 or best > CERTAIN)):
            return None
        efforts = [each for each in near if each[1].kind.startswith("effort")]
        if not efforts and self.overloaded.any():
            return near[0][1]
        return min(efforts or near, key=lambda each: each[0])[1]

    def _score(self, undone: Window, tried: WiringFault) -> tuple[bool, float]:
        """Return whether rows of other joints still fail once a fault is undone, and the unexplained share of its own.

        The share is inf if the fault is no explanation.
        """
        n, joints = self.robot.n, list(tried.joints)
        own = np.isin(np.arange(2 * n) % n, joints)
        left = Rows.of(self.robot, undone).unexplained
        if tried.kind.startswith("effort"):
            before, after = (motor_squares(self.robot, w)[joints].sum() for w in (self.window, undone))
            if CLEARER * after > before:  # a motor with too little torque still moves in the right direction
                return True, np.inf
        load = _Load.of(self.robot, undone)
        if (load.mean > self.load.mean + self.load.weight + self.load.motion)[joints].any():
            return True, np.inf
        if self.overloaded[joints].any() and (load.rms < EASED * self.load.rms)[joints].all():
            return bool((load.unlikely & self.overloaded & ~own[:n]).any()), FOLLOWS / 10 * float(left[own].mean())
        known = own & (self.rows.smooth | (left < FOLLOWS))
        against = (self.rows.unexplained[known & self.failing] > AGAINST).any()
        worse = (left > np.maximum(WORSE * self.rows.unexplained, SOUND))[own].any()
        rest = (self.failing & ~own & (left > FAILS)).any()
        return bool(rest), float(left[known].mean()) if against and not worse else np.inf
