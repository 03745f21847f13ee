# SPDX-License-Identifier: Apache-2.0
"""Check the motion of a record against the nominal robot: units, signs, gear ratios, swapped sides, scale of efforts.

The nominal robot needs to be right within a factor of SPREAD only. Each check compares two measured signals, or one
with the torque tau = M_l ddq_l + C dq_l + grad P_l that the measured motion needs, below a cut-off frequency.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fjr_core.model.robot import Robot

from .finding import DEGREES, GEAR_RATIO, SCALE, SIGN, SKEW, SWAPPED, Finding
from .line_fit import Line, bounded_slope, line
from .motion_record import MotionRecord
from .parameters import LARGEST_SKEW
from .rigid_motion import RigidMotion, rigid_motion
from .signal_checks import still_joints

LEAST_DEGREES = 3.0  # rad; larger positions may be degrees
RATIO = 0.005  # relative error of a gear ratio that is found
SPREAD = 10.0  # factor by which stiffness and inertia may differ from those of the robot file
LEAST_COMPLIANCE = 1 / 3  # of the nominal one; less may be hysteresis or a skew that changes
UNITS = {"degrees against rad": np.degrees(1.0), "turns against rad": 1.0 / (2.0 * np.pi)}


def degrees(record: MotionRecord, robot: Robot, motion: RigidMotion) -> Iterator[Finding]:
    """Find positions of both sides in degrees: as rad they leave the joints' range or contradict the efforts."""
    slides = [unit.position == "m" for unit in robot.units]
    moving = [j for j in range(robot.n) if record.joints[j] not in still_joints(record) and not slides[j]]
    if not moving:
        return
    seen = float(np.max(np.nanmax(np.abs(motion.position[:, moving]), axis=0)))
    scaled = rigid_motion(record, robot, np.where(slides, 1.0, np.radians(1.0)))
    votes = sum(_prefers(motion, scaled, j) for j in moving)
    if _leaves_range(robot, motion, moving) or (2 * votes > len(moving) and seen > LEAST_DEGREES):
        joint = record.joints[moving[0]] if len(moving) == 1 else ""
        sentence = f"positions reach {seen:.4g} and fit the robot as degrees only; expected rad"
        yield Finding(DEGREES, joint, sentence)


def _leaves_range(robot: Robot, motion: RigidMotion, moving: list[int]) -> bool:
    """Return whether positions are outside twice the range of most joints."""
    if robot.limits is None:
        return False
    low, high = np.asarray(robot.limits.lower), np.asarray(robot.limits.upper)
    bounded = [j for j in moving if np.isfinite(high[j] - low[j])]
    outside = [np.max(np.abs(motion.position[:, j] - (low + high)[j] / 2)) > (high - low)[j] for j in bounded]
    return 2 * sum(outside) > len(bounded) > 0


def _prefers(motion: RigidMotion, other: RigidMotion, j: int) -> bool:
    """Return whether the efforts fit another unit of the positions much better, with a plausible slope."""
    here, there = effort_line(motion, j), effort_line(other, j)
    good = 1 / SPREAD < there.slope < SPREAD and there.slope > 3 * there.deviation
    return good and there.unexplained < 0.5 * here.unexplained


def effort_line(motion: RigidMotion, j: int, effort: int | None = None) -> Line:
    """Fit the effort of joint `effort` (None: j) by the torque that the motion of joint j needs, with friction."""
    v_l, v_m = motion.velocity[:, j], motion.motor_velocity[:, j]
    friction = (v_l, np.tanh(v_l / 0.01), *(() if np.array_equal(v_l, v_m) else (v_m, np.tanh(v_m / 0.01))))
    return line(motion.needed[:, j], motion.u[:, j if effort is None else effort], friction, motion.independent)


def skews(record: MotionRecord, motion: RigidMotion) -> Iterator[Finding]:
    """Find link encoders and torque sensors that are read too much later or earlier than the other side."""
    for j, joint in enumerate(record.joints):
        v, tau = motion.velocity[:, j], motion.tau[:, j]
        lines = {}
        if motion.both[j]:
            lines["q_l"] = line(v, motion.deflection[:, j], (tau, np.tanh(v / 0.01)), motion.independent)
        if np.all(np.isfinite(motion.torque[:, j])):
            lines["torque"] = line(-np.gradient(tau, motion.dt), motion.torque[:, j], (tau, v), motion.independent)
        for name, fit in lines.items():
            if abs(fit.slope) - 5 * fit.deviation > LARGEST_SKEW:
                when = "later" if fit.slope > 0 else "earlier"
                sentence = (
                    f"{name} of {joint} is read {1e3 * abs(fit.slope):.3g} ms {when} than the other side; "
                    f"expected at most {1e3 * LARGEST_SKEW:g} ms"
                )
                yield Finding(SKEW, joint, sentence)


def sides(record: MotionRecord, robot: Robot, motion: RigidMotion) -> Iterator[Finding]:
    """Find a side that moves against the other, in another unit or by another gear ratio, and swapped sides."""
    turned = rigid_motion(record, robot, swapped=True)
    for j, joint in enumerate(record.joints):
        slopes = _slopes(motion, robot, j)
        if slopes is None:
            continue
        low, high = slopes
        middle = (low + high) / 2
        if high < 0:
            yield Finding(SIGN, joint, f"q_m of {joint} moves against q_l (slope {middle:.3g}); expected one direction")
        elif _differs(slopes) and not _differs(_slopes(turned, robot, j)) and _is_spring(turned, robot, j):
            yield Finding(SWAPPED, joint, f"q_m of {joint} is where q_l is expected, and the reverse: sides swapped")
        elif _differs(slopes):
            yield _ratio(joint, middle)


def _slopes(motion: RigidMotion, robot: Robot, j: int) -> tuple[float, float] | None:
    """Return the range of the ratio of q_m to q_l without the deflection; None if it is not known."""
    if not motion.both[j]:
        return None
    nominal = 1.0 / robot.K[j, j]
    compliances = nominal / SPREAD, nominal * SPREAD
    v = motion.velocity[:, j]  # a skew, and friction of the link
    return bounded_slope(
        motion.q_l[:, j], motion.q_m[:, j], motion.tau[:, j], (v, np.tanh(v / 0.01)), compliances, motion.independent
    )


def _differs(slopes: tuple[float, float] | None) -> bool:
    """Return whether a ratio is known and not 1."""
    return slopes is not None and (slopes[1] < 1 - RATIO or slopes[0] > 1 + RATIO)


def _ratio(joint: str, slope: float) -> Finding:
    for name, scale in UNITS.items():
        if any(abs(slope / each - 1) < 0.1 for each in (scale, 1 / scale)):
            kind = DEGREES if "degrees" in name else GEAR_RATIO
            sentence = f"q_m of {joint} moves {slope:.4g} times as far as q_l: {name}; expected one unit"
            return Finding(kind, joint, sentence)
    sentence = f"q_m of {joint} moves {slope:.4g} times as far as q_l; expected 1: wrong gear ratio"
    return Finding(GEAR_RATIO, joint, sentence)


def swapped(record: MotionRecord, robot: Robot, motion: RigidMotion) -> Iterator[Finding]:
    """Find swapped sides: the motor then lags behind the torque that the spring transmits."""
    turned = rigid_motion(record, robot, swapped=True)
    for j, joint in enumerate(record.joints):
        if not motion.both[j]:
            continue
        here, there = _deflection_line(motion, j), _deflection_line(turned, j)
        against = here.slope < -4 * here.deviation or here.unexplained > 4 * there.unexplained
        if against and there.unexplained < 0.5 and _is_spring(turned, robot, j):
            sentence = (
                f"q_m - q_l of {joint} is {here.slope * robot.K[j, j]:.2g} times the deflection that the motion needs; "
                "expected about 1: sides swapped"
            )
            yield Finding(SWAPPED, joint, sentence)


def _is_spring(motion: RigidMotion, robot: Robot, j: int) -> bool:
    """Return whether the deflection rises with the spring torque by a plausible compliance."""
    fit = _deflection_line(motion, j)
    return LEAST_COMPLIANCE < fit.slope * robot.K[j, j] < SPREAD and fit.slope > 4 * fit.deviation


def _deflection_line(motion: RigidMotion, j: int) -> Line:
    """Fit the deflection of a joint by the spring torque, with a skew between the two measurements."""
    return line(motion.tau[:, j], motion.deflection[:, j], (motion.velocity[:, j],), motion.independent)


def efforts(record: MotionRecord, motion: RigidMotion) -> Iterator[Finding]:
    """Find efforts and sensor torques of the wrong sign or scale."""
    still = still_joints(record)
    for j, joint in enumerate(record.joints):
        if joint in still:
            continue
        lines = {"effort": effort_line(motion, j)}
        if np.all(np.isfinite(motion.torque[:, j])):
            lines["torque"] = line(motion.tau[:, j], motion.torque[:, j], (), motion.independent)
        for name, fit in lines.items():
            yield from _of_line(name, joint, fit)


def _of_line(name: str, joint: str, fit: Line) -> Iterator[Finding]:
    """Judge the slope of a measured torque over the one that the motion needs."""
    low, high = fit.slope - 5 * fit.deviation, fit.slope + 5 * fit.deviation
    seen = f"{name} of {joint} is {fit.slope:.3g} times the torque that its motion needs"
    if high < 0:
        yield Finding(SIGN, joint, f"{seen}; expected a positive factor near 1: a sign is wrong")
    elif high < 1 / SPREAD or low > SPREAD:
        yield Finding(
            SCALE, joint, f"{seen}; expected about 1: links in the robot file, gear ratio, unit of the {name}?"
        )
