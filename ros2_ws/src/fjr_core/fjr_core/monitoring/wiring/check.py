# SPDX-License-Identifier: Apache-2.0
"""Find exchanged joints and wrong signs of efforts and encoders in the first samples of a run.

Each hypothesis on the wiring is undone in a window of samples. A likelihood-ratio test of the rows (see signals)
decides between it and the wiring as it should be. Evidence is twice the logarithm of a likelihood ratio.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from ...numerics.checks import Array
from ...robot.robot import Robot
from .hypotheses import Window, WiringFault, hypotheses
from .signals import Flags, Rows, delayed, distances, torque_tolerance

WINDOW, FEWEST = 21, 9
"""Largest and smallest number of states compared; 21 states are the first 20 samples and what follows the last."""
FULL = WINDOW - 2
"""Number of states from which a choice is made between nearly equal explanations."""
EVIDENCE = 2 * math.log(1e5)
"""Smallest evidence for a fault against the right wiring: a false alarm has probability 1e-5 (Wald)."""
CLEARER = 2 * math.log(1e2)
"""Smallest evidence for a fault against another one before the window is full, and for a velocity that is late."""
FAILS = 1.25
"""Smallest misfit per interval of a suspected row; its mean is at most 1 / DOUBT if the row is right."""
FITS, FOLLOWS = 1.6, 3.0
"""Largest misfit per interval once the right fault is undone: of a torque, and of a velocity."""
CLOSER = 2.0
"""Factor by which undoing the right fault decreases the mean squares of its torques, without any tolerance.

A motor that gives less than commanded still moves in the right direction.
"""
COARSE = 0.5
"""Largest share of intervals in which a position may repeat exactly; else its encoder is too coarse for a slope."""
CONFIRMED = 2
"""Number of consecutive comparisons that must agree on the first joint of a fault."""
EARLY, RARER = 2, 1.1
"""Samples between comparisons until the window is full, and ratio of the sample counts of later comparisons.

The mean cost per sample vanishes if noise hides whether the signals of a joint agree.
"""
LOADED = 100.0
"""Factor on the tolerance of constant torques after the first window, when the arm may touch something."""


class WiringCheck:
    """Check of the wiring with samples and efforts from the start until every joint is right or a fault is found."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self.start()

    def start(self) -> None:
        """Start again with no joint checked."""
        self._right = np.zeros(4 * self._robot.n, dtype=bool)
        self.skip()

    def skip(self) -> None:
        """Discard the samples so far; the next one does not follow them."""
        self._rows: deque[tuple[float, Array, Array, Array]] = deque(maxlen=WINDOW)
        self._count, self._agreed, self._due = 0, 0, FEWEST
        self._last: WiringFault | None = None
        self._constant: Array | None = None

    @property
    def done(self) -> bool:
        """Return whether all signals of all joints are known to be right."""
        return bool(self._right.all())

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
        if self._rows:
            self._rows[-1][3][...] = u

    def _compared(self) -> WiringFault | None:
        window = Window(*(np.array(values) for values in zip(*self._rows, strict=True)))
        if self._constant is None:
            self._constant = torque_tolerance(self._robot, window.q[0])
        constant = self._constant * (1.0 if self._count <= WINDOW else LOADED)
        try:
            with np.errstate(all="ignore"):
                fault, right = wiring_fault(self._robot, window, self._right, constant)
        except np.linalg.LinAlgError:  # values near overflow
            return None
        self._right |= right
        same = fault is not None and self._last is not None and fault.joints[0] == self._last.joints[0]
        self._agreed = self._agreed + 1 if same else int(fault is not None)
        self._last = fault
        return fault if self._agreed >= CONFIRMED else None


def wiring_fault(robot: Robot, window: Window, known: Flags, constant: Array) -> tuple[WiringFault | None, Flags]:
    """Return the fault that explains a window of samples, or None, and flags of the rows that are right (4n,).

    A row is right if it agrees and the evidence against a changed sign of one side suffices. known (4n,): flags so
    far. constant (n,) [N m]: standard deviation of constant torques.
    """
    n, count, full = robot.n, len(window.t) - 1, len(window.t) >= FULL
    rows = Rows.of(robot, window, constant)
    misfit = rows.misfit()
    right = (rows.misfit(-1.0) - misfit > EVIDENCE) & (misfit < FITS * count) & full
    failing = (misfit > FAILS * count) & ~known
    velocity = _wrong_velocity(rows, failing, count, full)
    if velocity is not None:
        return velocity, right
    links, motors = (set(np.flatnonzero(part).tolist()) for part in failing[: 2 * n].reshape(2, n))
    encoders = (links | motors) - set(np.flatnonzero(known[:n]).tolist())  # the spring is in both equations
    found: list[tuple[float, WiringFault]] = []
    for fault, undone in hypotheses(encoders, motors, n):
        left, own = Rows.of(robot, undone(window), constant), np.isin(np.arange(2 * n) % n, fault.joints)
        closer = CLOSER * left.squares[: 2 * n][own].sum() < rows.squares[: 2 * n][own].sum()
        if closer and left.misfit()[: 2 * n][own].max() < FITS * count:
            found.append((rows.deviance - left.deviance, fault))
    return _decided([each for each in found if each[0] > EVIDENCE], full), right


def _decided(found: list[tuple[float, WiringFault]], full: bool) -> WiringFault | None:
    """Return the fault with the largest evidence, or an effort's of nearly equal ones; None while they are open.

    Link and motor encoder of a joint cannot be told apart at rest: either stops the robot at once.
    """
    near = [each for each in found if each[0] > max(found)[0] - CLEARER]
    if not near or (not full and len({(fault.kind, fault.joints) for _, fault in near}) > 1):
        return None
    return max([each for each in near if each[1].kind.startswith("effort")] or near)[1]


def _wrong_velocity(rows: Rows, failing: Flags, count: int, full: bool) -> WiringFault | None:
    """Return the fault of a velocity that follows the slope of another position, or of its own with changed sign.

    A velocity that follows its own slope late, such as a filter's, is right. It is assumed to be 100 times rarer.
    """
    n = len(failing) // 4
    coarse = (rows.x == 0.0).mean(axis=1) > COARSE
    for row in np.flatnonzero((failing & ~coarse)[2 * n :]) + 2 * n:
        side, j, first = ("link", "motor")[row // n - 2], int(row % n), row - row % n
        slopes = rows.x[first : first + n].copy()
        slopes[j] *= -1.0
        left = np.where(coarse[first : first + n], np.inf, distances(rows.root[row], rows.y[row] - slopes))
        k = int(np.argmin(left))
        clear = full or bool((np.delete(left, k) > left[k] + CLEARER).all())
        late = distances(rows.root[row], rows.y[row] - delayed(rows.x[row], rows.y[row, 0]))
        own = min(late[0], late[1:].min() + CLEARER)
        if clear and left[k] < FOLLOWS * count and own > left[k] + EVIDENCE:
            kind, joints = ("velocity sign", (j,)) if k == j else ("velocity of another joint", (j, k))
            return WiringFault(kind, joints, side)
    return None
