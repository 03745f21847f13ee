# SPDX-License-Identifier: Apache-2.0
"""Check which joint a signal belongs to, and its sign where no other side shows it: by the better of two hypotheses.

Each hypothesis changes the record. It is believed if the efforts of the joints that it concerns then follow from the
motion, and did not before.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array

from .finding import ORDER, SIGN, Finding
from .line_fit import Line, line
from .motion_checks import SPREAD, effort_line
from .motion_record import MotionRecord
from .rigid_motion import RigidMotion, rigid_motion
from .signal_checks import still_joints

POOR, GOOD = 0.5, 0.25  # unexplained share of an effort without and with the change
BETTER = 0.5  # unexplained with the change, relative to without
NEAR = 1.25  # factor; a slope within it is right
EXCHANGED = {"the positions": ("q_l", "q_m"), "all signals": ("u", "q_l", "q_m", "torque")}
FOLLOWS = 0.1  # unexplained share of one side's position by that of another joint


def turned(record: MotionRecord, robot: Robot, motion: RigidMotion) -> Iterator[Finding]:
    """Find joints all of whose positions have the wrong sign: with the other one their efforts fit."""
    for j, joint in _moving(record):
        here = effort_line(motion, j)
        if here.unexplained > POOR:
            scale = np.where(np.arange(robot.n) == j, -1.0, 1.0)
            if _explains(here, effort_line(rigid_motion(record, robot, scale), j)):
                sentence = f"the effort of {joint} fits its motion only with the other sign of its positions"
                yield Finding(SIGN, joint, f"{sentence}; expected the direction of the robot file")


def crossed_sides(record: MotionRecord) -> Iterator[Finding]:
    """Find pairs of joints whose links are recorded in another order than their motors."""
    for (i, first), (j, second) in combinations(_moving(record), 2):
        own = [_unexplained(record.q_l[:, k], record.q_m[:, k]) for k in (i, j)]
        other = [_unexplained(record.q_l[:, a], record.q_m[:, b]) for a, b in ((i, j), (j, i))]
        if max(other) < FOLLOWS and max(other) < BETTER * min(own):
            sentence = f"q_m of {first} follows q_l of {second}, and the reverse; expected one order of the joints"
            yield Finding(ORDER, first, sentence)


def crossed(record: MotionRecord, robot: Robot, motion: RigidMotion) -> Iterator[Finding]:
    """Find pairs of joints whose efforts, or all of whose signals, are recorded in the other order."""
    for (i, first), (j, second) in combinations(_moving(record), 2):
        here = [effort_line(motion, k) for k in (i, j)]
        pairs = (i, i), (j, j), (i, j), (j, i)
        efforts = [effort_line(motion, *pair) for pair in pairs]
        sensors = [line(motion.tau[:, k], motion.torque[:, of], (), motion.independent) for k, of in pairs]
        wrong = [name for name, fit in (("efforts", efforts), ("torques", sensors)) if _all_explain(fit[:2], fit[2:])]
        if wrong:
            sentence = f"the {wrong[0]} of {first} and {second} fit the motion of the other joint"
            yield Finding(ORDER, first, f"{sentence}; expected one order of the joints")
            continue
        if max(each.unexplained for each in here) > GOOD / 5:
            for what, names in EXCHANGED.items():
                other = rigid_motion(_exchanged(record, i, j, names), robot)
                if _all_explain(here, [effort_line(other, k) for k in (i, j)]):
                    sentence = f"{what} of {first} and {second} fit the robot in the other order"
                    yield Finding(ORDER, first, f"{sentence}; expected the order of the joints in the robot file")
                    break


def _exchanged(record: MotionRecord, i: int, j: int, names: Sequence[str]) -> MotionRecord:
    """Return the record with some signals of two joints exchanged."""
    order = np.arange(len(record.joints))
    order[[i, j]] = order[[j, i]]
    u, q_l, q_m, torque = (
        getattr(record, name)[:, order if name in names else slice(None)] for name in ("u", "q_l", "q_m", "torque")
    )
    return replace(record, u=u, q_l=q_l, q_m=q_m, torque=torque)


def _moving(record: MotionRecord) -> list[tuple[int, str]]:
    still = still_joints(record)
    return [(j, joint) for j, joint in enumerate(record.joints) if joint not in still and np.ptp(record.u[:, j]) > 0]


def _explains(here: Line, there: Line) -> bool:
    """Return whether a change makes an effort fit, with a slope of the right order."""
    return _fits(there) and there.unexplained < BETTER * here.unexplained


def _fits(line: Line) -> bool:
    """Return whether an effort follows from the motion with a slope of the right order."""
    right_order = 1 / SPREAD < line.slope < SPREAD and line.slope > 5 * line.deviation
    return right_order and line.unexplained < GOOD


def _all_explain(here: Sequence[Line], there: Sequence[Line]) -> bool:
    """Return whether both efforts fit after a change.

    Each fits better, the product of the unexplained shares is below BETTER^2 of that before, and the slopes are nearer
    to 1, or within NEAR of it.
    """
    pairs = list(zip(here, there, strict=True))
    together = np.prod([b.unexplained for _, b in pairs]) < np.prod([BETTER * a.unexplained for a, _ in pairs])
    return bool(together) and all(
        _fits(b)
        and b.unexplained < a.unexplained
        and (a.slope <= 0 or abs(np.log(b.slope)) < max(abs(np.log(a.slope)), np.log(NEAR)))
        for a, b in pairs
    )


def _unexplained(x: Array, y: Array) -> float:
    """Return the share of the variance of y (k,) that a line over x (k,) leaves; inf if one is not measured."""
    if not (np.all(np.isfinite(x)) and np.all(np.isfinite(y)) and np.ptp(x) > 0 and np.ptp(y) > 0):
        return np.inf
    return float(1 - np.corrcoef(x, y)[0, 1] ** 2)
