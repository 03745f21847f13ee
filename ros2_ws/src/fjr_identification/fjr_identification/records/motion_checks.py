# SPDX-License-Identifier: Apache-2.0
"""Compare the motion of a record with the nominal robot: units, signs, gear ratios, sides, order of joints, efforts.

The nominal robot needs to be right within a factor of SPREAD only. Each check compares two measured signals, or one
with the torque tau = M_l ddq_l + C dq_l + grad P_l that the measured motion needs, below a cut-off frequency. Which
joint a signal belongs to, and its sign where no other side shows it, is the better of two hypotheses: a changed record
is believed if the efforts of the joints that it concerns then follow from the motion, and did not before.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from fjr_core.numerics.checks import Array
from fjr_core.runtime.events import Finding

from ..estimation.elastic_arm import coulomb
from ..estimation.lack_of_fit import slipping_elements
from ..estimation.motion_record import MotionRecord
from ..estimation.parameters import LARGEST_SKEW
from .rigid_motion import (
    DEGREES,
    GEAR_RATIO,
    ORDER,
    SCALE,
    SIGN,
    SKEW,
    SWAPPED,
    FittedLine,
    RigidMotion,
    contradiction,
    rigid_motion,
    without,
)

LEAST_DEGREES = 3.0  # rad; larger positions may be degrees
RATIO = 0.005  # relative error of a gear ratio that is found
SPREAD = 10.0  # factor by which stiffness and inertia may differ from those of the robot file
LEAST_COMPLIANCE = 1 / 3  # of the nominal one; less may be hysteresis or a skew that changes
UNITS = {"degrees against rad": np.degrees(1.0), "turns against rad": 1.0 / (2.0 * np.pi)}
SMOOTHING = 0.01  # rad/s; of the friction regressors
FINE = np.geomspace(0.05, 0.8, 8)  # of the root mean square torque, at which elements slip
POOR, GOOD = 0.5, 0.25  # unexplained share of an effort without and with a change
BETTER = 0.5  # unexplained with a change, relative to without
NEAR = 1.25  # factor; a slope within it is right
EXCHANGED = {"the positions": ("q_l", "q_m"), "all signals": ("u", "q_l", "q_m", "torque")}
FOLLOWS = 0.1  # unexplained share of one side's position by that of another joint
ONE_ORDER = "one order of the joints"


def degrees(motion: RigidMotion) -> Iterator[Finding]:
    """Find positions of both sides in degrees: as rad they leave the joints' range or contradict the efforts."""
    slides = [unit.position == "m" for unit in motion.robot.units]
    moving = [j for j in range(motion.robot.n) if motion.record.joints[j] not in motion.record.still and not slides[j]]
    if not moving:
        return
    largest = float(np.max(np.nanmax(np.abs(motion.position[:, moving]), axis=0)))
    scaled, votes = rigid_motion(motion.record, motion.robot, np.where(slides, 1.0, np.radians(1.0))), 0
    for j in moving:
        here, there = effort_line(motion, j), effort_line(scaled, j)
        plausible = 1 / SPREAD < there.slope < SPREAD and there.slope > 3 * there.deviation
        votes += plausible and there.unexplained < 0.5 * here.unexplained
    if _leaves_range(motion, moving) or (2 * votes > len(moving) and largest > LEAST_DEGREES):
        joint = motion.record.joints[moving[0]] if len(moving) == 1 else ""
        yield contradiction(DEGREES, joint, f"positions reach {largest:.4g} and fit the robot as degrees only", "rad")


def _leaves_range(motion: RigidMotion, moving: list[int]) -> bool:
    """Return whether positions are outside twice the range of most joints."""
    if motion.robot.limits is None:
        return False
    low, high = np.asarray(motion.robot.limits.lower), np.asarray(motion.robot.limits.upper)
    bounded = [j for j in moving if np.isfinite(high[j] - low[j])]
    outside = [np.max(np.abs(motion.position[:, j] - (low + high)[j] / 2)) > (high - low)[j] for j in bounded]
    return 2 * sum(outside) > len(bounded) > 0


def effort_line(motion: RigidMotion, j: int, effort: int | None = None) -> FittedLine:
    """Fit the effort of joint `effort` (None: j) by the torque that the motion of joint j needs, with friction."""
    v_l, v_m = motion.velocity[:, j], motion.motor_velocity[:, j]
    friction = [v_l, coulomb(v_l, SMOOTHING)]
    friction += [] if np.array_equal(v_l, v_m) else [v_m, coulomb(v_m, SMOOTHING)]
    return motion.line(motion.needed[:, j], motion.u[:, j if effort is None else effort], *friction)


def skews(motion: RigidMotion) -> Iterator[Finding]:
    """Find link encoders and torque sensors that are read too much later or earlier than the other side."""
    for j, joint in enumerate(motion.record.joints):
        v, tau = motion.velocity[:, j], motion.tau[:, j]
        lines = {}
        if motion.both[j]:
            lines["q_l"] = motion.line(v, motion.deflection[:, j], tau, coulomb(v, SMOOTHING))
        if np.all(np.isfinite(motion.torque[:, j])):
            lines["torque"] = motion.line(-np.gradient(tau, motion.dt), motion.torque[:, j], tau, v)
        for name, line in lines.items():
            if abs(line.slope) - 5 * line.deviation > LARGEST_SKEW:
                when = "earlier" if line.slope > 0 else "later"
                seen = f"{name} of {joint} is read {1e3 * abs(line.slope):.3g} ms {when} than the other side"
                yield contradiction(SKEW, joint, seen, f"at most {1e3 * LARGEST_SKEW:g} ms")


def sides(motion: RigidMotion) -> Iterator[Finding]:
    """Find a side that moves against the other, in another unit or by another gear ratio, and swapped sides."""
    for j, joint in enumerate(motion.record.joints):
        slopes = _slopes(motion, j) if motion.both[j] else None
        if slopes is None:
            continue
        low, high = slopes
        middle, differs, exchanged = (low + high) / 2, _differs(slopes) and not _slips(motion, j), motion.exchanged
        if high < 0:
            seen = f"q_m of {joint} moves against q_l (slope {middle:.3g})"
            yield contradiction(SIGN, joint, seen, "one direction")
        elif differs and not _differs(_slopes(exchanged, j)) and _is_spring(exchanged, j):
            sentence = f"q_m of {joint} is where q_l is expected, and the reverse: sides swapped"
            yield Finding(SWAPPED, joint, sentence=sentence)
        elif differs:
            yield _ratio(joint, middle)


def _compared(motion: RigidMotion, j: int, rows: slice = slice(None)) -> list[Array]:
    """Return q_l, q_m, the torque of joint j, and what skew and friction change; some rows of each."""
    v = motion.velocity[:, j]
    return [each[rows] for each in (motion.q_l[:, j], motion.q_m[:, j], motion.tau[:, j], v, coulomb(v, SMOOTHING))]


def _slopes(
    motion: RigidMotion, j: int, rows: slice = slice(None), elements: Sequence[Array] = ()
) -> tuple[float, float] | None:
    """Return the range of the ratio r of q_m to q_l without the deflection; None if it is not known.

    q_m = r q_l + c tau + others + constant, +- 5 deviations of r, for a compliance c within SPREAD of that of the robot
    file. elements: more of the others.
    """
    q_l, q_m, tau, *others = [*_compared(motion, j, rows), *elements]
    free, compliance = motion.line(tau, q_m, q_l, *others), 1.0 / motion.robot.K[j, j]
    ends = np.array([-5.0, 5.0]) * free.deviation + free.slope
    lines = [motion.line(q_l, q_m - c * tau, *others) for c in np.clip(ends, compliance / SPREAD, compliance * SPREAD)]
    if any(not max(1.0, abs(line.slope)) > 20 * line.deviation for line in lines):
        return None
    return min(a.slope - 5 * a.deviation for a in lines), max(a.slope + 5 * a.deviation for a in lines)


def _slips(motion: RigidMotion, j: int) -> bool:
    """Return whether hysteresis explains the deflection better than a gear ratio does, which is 1 beside it.

    Hysteresis: elements that follow the torque but slip. Samples count from where each has slipped, since its state at
    the start is not known, at least the second half.
    """
    tau = motion.tau[:, j]
    slips = np.sqrt(np.mean(tau**2)) * FINE
    following = slipping_elements(tau, slips)
    slipped = np.abs(following) >= slips
    rows = slice(min(int(np.max(np.argmax(slipped, axis=0))), len(tau) // 2), None)
    q_l, q_m, *usual = _compared(motion, j, rows)
    elements = list(following[rows].T)
    by_slip, by_ratio = (float(np.sum(without(q_m - q_l, *usual, *more) ** 2)) for more in (elements, [q_l]))
    return by_slip < by_ratio and not _differs(_slopes(motion, j, rows, elements))


def _differs(slopes: tuple[float, float] | None) -> bool:
    """Return whether a ratio is known and not 1."""
    return slopes is not None and (slopes[1] < 1 - RATIO or slopes[0] > 1 + RATIO)


def _ratio(joint: str, slope: float) -> Finding:
    seen = f"q_m of {joint} moves {slope:.4g} times as far as q_l"
    for name, scale in UNITS.items():
        if any(abs(slope / ratio - 1) < 0.1 for ratio in (scale, 1 / scale)):
            kind = DEGREES if "degrees" in name else GEAR_RATIO
            return contradiction(kind, joint, f"{seen}: {name}", "one unit")
    return contradiction(GEAR_RATIO, joint, seen, "1: wrong gear ratio")


def swapped(motion: RigidMotion) -> Iterator[Finding]:
    """Find swapped sides: the motor then lags behind the torque that the spring transmits."""
    for j, joint in enumerate(motion.record.joints):
        if not motion.both[j]:
            continue
        here, there = _deflection_line(motion, j), _deflection_line(motion.exchanged, j)
        against = here.slope < -4 * here.deviation or here.unexplained > 4 * there.unexplained
        if against and there.unexplained < 0.5 and _is_spring(motion.exchanged, j):
            times = f"{here.slope * motion.robot.K[j, j]:.2g} times the deflection that the motion needs"
            yield contradiction(SWAPPED, joint, f"q_m - q_l of {joint} is {times}", "about 1: sides swapped")


def _is_spring(motion: RigidMotion, j: int) -> bool:
    """Return whether the deflection rises with the spring torque by a plausible compliance."""
    line = _deflection_line(motion, j)
    return LEAST_COMPLIANCE < line.slope * motion.robot.K[j, j] < SPREAD and line.slope > 4 * line.deviation


def _deflection_line(motion: RigidMotion, j: int) -> FittedLine:
    """Fit the deflection of a joint by the spring torque, with a skew between the two measurements."""
    return motion.line(motion.tau[:, j], motion.deflection[:, j], motion.velocity[:, j])


def efforts(motion: RigidMotion) -> Iterator[Finding]:
    """Find efforts and sensor torques of the wrong sign or scale."""
    for j, joint in enumerate(motion.record.joints):
        if joint in motion.record.still:
            continue
        lines = {"effort": effort_line(motion, j)}
        if np.all(np.isfinite(motion.torque[:, j])):
            lines["torque"] = motion.line(motion.tau[:, j], motion.torque[:, j])
        for name, line in lines.items():
            low, high = line.slope - 5 * line.deviation, line.slope + 5 * line.deviation
            seen = f"{name} of {joint} is {line.slope:.3g} times the torque that its motion needs"
            if high < 0:
                yield contradiction(SIGN, joint, seen, "a positive factor near 1: a sign is wrong")
            elif high < 1 / SPREAD or low > SPREAD:
                causes = f"links in the robot file, gear ratio, unit of the {name}?"
                yield contradiction(SCALE, joint, seen, f"about 1: {causes}")


def turned(motion: RigidMotion) -> Iterator[Finding]:
    """Find joints all of whose positions have the wrong sign: with the other one their efforts fit."""
    for j in motion.record.driven:
        here, joint = effort_line(motion, j), motion.record.joints[j]
        if here.unexplained > POOR:
            scale = np.where(np.arange(motion.robot.n) == j, -1.0, 1.0)
            there = effort_line(rigid_motion(motion.record, motion.robot, scale), j)
            if _follows(there) and there.unexplained < BETTER * here.unexplained:
                seen = f"the effort of {joint} fits its motion only with the other sign of its positions"
                yield contradiction(SIGN, joint, seen, "the direction of the robot file")


def crossed_sides(record: MotionRecord) -> Iterator[Finding]:
    """Find pairs of joints whose links are recorded in another order than their motors."""
    for i, j in combinations(record.driven, 2):
        first, second = record.joints[i], record.joints[j]
        straight = [_unexplained(record.q_l[:, k], record.q_m[:, k]) for k in (i, j)]
        across = [_unexplained(record.q_l[:, a], record.q_m[:, b]) for a, b in ((i, j), (j, i))]
        if max(across) < FOLLOWS and max(across) < BETTER * min(straight):
            seen = f"q_m of {first} follows q_l of {second}, and the reverse"
            yield contradiction(ORDER, first, seen, ONE_ORDER)


def crossed(motion: RigidMotion) -> Iterator[Finding]:
    """Find pairs of joints whose efforts, or all of whose signals, are recorded in the other order."""
    for i, j in combinations(motion.record.driven, 2):
        first, second = motion.record.joints[i], motion.record.joints[j]
        pairs = (i, i), (j, j), (i, j), (j, i)
        by_effort = [effort_line(motion, *pair) for pair in pairs]
        by_sensor = [motion.line(motion.tau[:, k], motion.torque[:, of]) for k, of in pairs]
        wrong = [
            name
            for name, lines in (("efforts", by_effort), ("torques", by_sensor))
            if _all_follow(lines[:2], lines[2:])
        ]
        if wrong:
            seen = f"the {wrong[0]} of {first} and {second} fit the motion of the other joint"
            yield contradiction(ORDER, first, seen, ONE_ORDER)
        elif max(line.unexplained for line in by_effort[:2]) > GOOD / 5:
            order = np.arange(motion.robot.n)
            order[[i, j]] = j, i
            for what, names in EXCHANGED.items():
                changed = {name: getattr(motion.record, name)[:, order] for name in names}
                other = rigid_motion(replace(motion.record, **changed), motion.robot)
                if _all_follow(by_effort[:2], [effort_line(other, k) for k in (i, j)]):
                    seen = f"{what} of {first} and {second} fit the robot in the other order"
                    yield contradiction(ORDER, first, seen, "the order of the joints in the robot file")
                    break


def _follows(line: FittedLine) -> bool:
    """Return whether an effort follows from the motion with a slope of the right order."""
    right_order = 1 / SPREAD < line.slope < SPREAD and line.slope > 5 * line.deviation
    return right_order and line.unexplained < GOOD


def _all_follow(here: Sequence[FittedLine], there: Sequence[FittedLine]) -> bool:
    """Return whether both efforts follow from the motion after a change.

    Each fits better, the product of the unexplained shares is below BETTER^2 of that before, and the slopes are nearer
    to 1, or within NEAR of it.
    """
    pairs = list(zip(here, there, strict=True))
    together = np.prod([b.unexplained for _, b in pairs]) < np.prod([BETTER * a.unexplained for a, _ in pairs])
    return bool(together) and all(
        _follows(b)
        and b.unexplained < a.unexplained
        and (a.slope <= 0 or abs(np.log(b.slope)) < max(abs(np.log(a.slope)), np.log(NEAR)))
        for a, b in pairs
    )


def _unexplained(x: Array, y: Array) -> float:
    """Return the share of the variance of y (k,) that a line over x (k,) leaves; inf if one is not measured."""
    if not (np.all(np.isfinite(x)) and np.all(np.isfinite(y)) and np.ptp(x) > 0 and np.ptp(y) > 0):
        return np.inf
    return float(1 - np.corrcoef(x, y)[0, 1] ** 2)


IN_ORDER = (degrees, skews, sides, swapped, crossed, efforts, turned)
"""Checks of a motion, the most fundamental one first."""
