# SPDX-License-Identifier: Apache-2.0
"""Say which sensors the joints of records lack and what stays unknown; check gear ratio and time of one side alone.

docs/from_csv.md has the same sentences. If one side only is measured, no second side contradicts it:

    u / e = tau(g q, g dq / s, g ddq / s^2) + B g ddq / s^2 + D dq + F tanh(dq / v0) + constant

tau: torque that the links of the robot file need, with all of their weight and inertia. B is free within a factor of
TRUST about that of the file, D, F and the constant are free. Three hypotheses are tried: positions wrong by g (e = 1),
positions and effort wrong by a gear ratio (e = g), and time wrong by s. One is found if it leaves less than BETTER of
the variance that is unexplained without it, by five standard deviations.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.signal import butter, sosfiltfilt

from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array
from fjr_core.runtime.events import Finding

from ..estimation.elastic_arm import coulomb
from ..estimation.motion_record import SIGNALS, MotionRecord
from .rigid_motion import GEAR_RATIO, TIME, RigidMotion, contradiction, rigid_motion, spring_torques, without

CUTOFF = 2.0  # Hz; well below resonances, which the rigid links do not have
ROWS = 1000  # samples that are compared
TRUST = 3.0  # factor by which the motor inertia may differ from that of the robot file
BETTER = 1 / 3  # unexplained with the scale, relative to without
DEVIATIONS = 5.0  # standard deviations of the noise; a larger difference is significant
LARGEST, STEP = 128.0, 2 ** (1 / 3)  # scales that are tried, from 1 / LARGEST on
SMALLEST = 1.25  # factor; less is an error of the links
SHORTEST, LONGEST = 1.0, 60.0  # s of a record that are compared; rows of longer ones are too far apart
SETTLING = 15  # rows that the filter needs at an end
SMOOTHING = 0.01  # rad/s; v0
PARAMETERS = 5  # B, D, F, constant and the scale
POSITION, RATIO, SECONDS = "position", "ratio", "time"
WORDS = {
    POSITION: "positions {0:.3g} times as large",
    RATIO: "positions {0:.3g} times and efforts {1:.3g} times as large",
    SECONDS: "a time {0:.3g} times as long",
}
BY_RESONANCE = "only motion near its resonance reveals its stiffness"
LINK, MOTOR, TORQUE = "link encoder", "motor encoder", "torque sensor"
LACKING: Mapping[tuple[str, ...], str] = {
    (LINK,): "the torque sensor reveals the stiffness; the control law needs the link encoder",
    (LINK, TORQUE): f"{BY_RESONANCE}, only gravity the offset of its spring; the control law needs the link encoder",
    (MOTOR,): "the torque sensor replaces it; nothing reveals the offset of the spring",
    (MOTOR, TORQUE): f"{BY_RESONANCE}, nothing the offset of its spring; the control law needs one of the two",
}  # what it means that a joint has none of these sensors
NOT_SEEN = "would not be noticed and would bias motor inertia, stiffness and friction"  # with one side only


@dataclass(frozen=True, eq=False)
class Scan:
    """Share (k,) of an effort's variance that is unexplained at the scales (k,), for each hypothesis.

    here: without any scale. freedom: number of independent samples less that of the parameters.
    """

    scales: Array
    unexplained: dict[str, Array]
    here: float
    freedom: float

    def best(self, what: str) -> tuple[float, float]:
        """Return the best scale of a hypothesis and its unexplained share."""
        k = int(np.argmin(self.unexplained[what]))
        return float(self.scales[k]), float(self.unexplained[what][k])

    def differs(self, scale: float, other: float, here: float) -> bool:
        """Return whether a scale with the unexplained share `other` is found where the share is `here` without it."""
        significant = (here - other) * max(self.freedom, 1.0) > DEVIATIONS**2 * other
        return significant and other < BETTER * here and abs(np.log(scale)) > np.log(SMALLEST)

    def least_found(self, what: str) -> float:
        """Return the factor from which on errors of a right record would be found; inf: none would."""
        seen = [self.differs(s, self.here, u) for s, u in zip(self.scales, self.unexplained[what], strict=True)]
        missed = np.max(np.exp(np.abs(np.log(self.scales[~np.array(seen)]))), initial=1.0)
        return float(missed * STEP) if missed * STEP < LARGEST else np.inf


def scales(record: MotionRecord, robot: Robot) -> Iterator[Finding]:
    """Find gear ratios and times with which the effort of a joint of one measured side fits much better."""
    for joint, scan in _scans(record, robot).items():
        best = {what: scan.best(what) for what in scan.unexplained}
        what, (scale, least) = min(best.items(), key=lambda item: item[1][1])
        if scan.differs(scale, least, scan.here):
            like = [name for name, (_, share) in best.items() if share < 2 * least]
            seen = " or ".join(WORDS[name].format(best[name][0], 1 / best[name][0]) for name in like)
            fits = f"effort and motion of {joint} fit the links of the robot only with {seen}"
            yield contradiction(TIME if what == SECONDS else GEAR_RATIO, joint, fits, "1 times")


def least_seen(record: MotionRecord, robot: Robot) -> dict[str, tuple[float, float]]:
    """Return the factors from which on a wrong gear ratio and time are found, for joints of one measured side only."""
    return {
        joint: (max(scan.least_found(what) for what in (POSITION, RATIO)), scan.least_found(SECONDS))
        for joint, scan in _scans(record, robot).items()
    }


@lru_cache(maxsize=2)
def _scans(record: MotionRecord, robot: Robot) -> dict[str, Scan]:
    """Return the scan of each moving joint of one measured side, by name; none for a short record."""
    if record.measured("q_l").all() and record.measured("q_m").all():
        return {}
    record = _most_moving(record)
    motion = rigid_motion(record, robot)
    short = len(record.u) * record.dt < SHORTEST or len(motion.u) <= SETTLING
    if short:
        return {}
    one_sided = [j for j in record.driven if not motion.both[j]]
    count = round(np.log(LARGEST) / np.log(STEP))
    tried = STEP ** np.arange(-count, count + 1, dtype=float)
    late = [_terms(motion, time=s) for s in tried] if one_sided else []
    return {record.joints[j]: _scan(motion, j, tried, late) for j in one_sided}


def _most_moving(record: MotionRecord) -> MotionRecord:
    """Return the LONGEST seconds of a record in which the joints move farthest."""
    count, q = int(LONGEST / record.dt), np.where(np.isfinite(record.q_m), record.q_m, record.q_l)
    if len(q) <= count:
        return record
    path = np.append(0.0, np.cumsum(np.sum(np.abs(np.diff(q, axis=0)), axis=1)))
    first = int(np.argmax(path[count - 1 :] - path[: len(path) - count + 1]))
    return replace(record, **{name: getattr(record, name)[first : first + count] for name in ("u", *SIGNALS)})


def _scan(motion: RigidMotion, j: int, tried: Array, late: list[Terms]) -> Scan:
    """Return the scan of joint j; late: terms at the times tried."""
    here = _terms(motion)
    moved = [_terms(motion, np.where(np.arange(motion.robot.n) == j, g, 1.0)) for g in tried]
    unexplained = {
        POSITION: np.array([terms.unexplained(j) for terms in moved]),
        RATIO: np.array([terms.unexplained(j, g) for terms, g in zip(moved, tried, strict=True)]),
        SECONDS: np.array([terms.unexplained(j) for terms in late]),
    }
    independent = min(2 * CUTOFF * here.dt, 1.0) * here.of(j).shape[1]
    return Scan(tried, unexplained, here.unexplained(j), independent - PARAMETERS)


@dataclass(frozen=True, eq=False)
class Terms:
    """Terms of the equation, (k, n) each: tau, inertia B ddq with the file's B, dq, tanh(dq / v0), effort."""

    links: Array
    inertia: Array
    velocity: Array
    sign: Array
    effort: Array
    dt: float

    def of(self, j: int) -> Array:
        """Return the terms of joint j below CUTOFF (5, samples), without what the filter does at both ends."""
        edge = int(0.3 / CUTOFF / self.dt)
        sections = butter(4, min(2 * CUTOFF * self.dt, 0.9), output="sos")
        terms = (x[:, j] for x in (self.links, self.inertia, self.velocity, self.sign, self.effort))
        return np.asarray(sosfiltfilt(sections, [*terms])[:, edge : len(self.effort) - edge])

    def unexplained(self, j: int, effort: float = 1.0) -> float:
        """Return the share of the variance of joint j's effort, divided by a scale, that the equation leaves."""
        links, inertia, *friction, measured = self.of(j)
        y, inertia = (without(x, *friction) for x in (measured / effort - links, inertia))
        factor = np.clip(float(y @ inertia) / max(float(inertia @ inertia), 1e-300), 1 / TRUST, TRUST)
        return float(np.sum((y - factor * inertia) ** 2) / max(len(y) * np.var(measured / effort), 1e-300))


def _terms(motion: RigidMotion, scale: Array | float = 1.0, time: float = 1.0) -> Terms:
    """Return the terms with positions at a scale (n,) and time at another one."""
    rows = slice(None, None, max(1, len(motion.u) // ROWS))
    q, v = motion.position * scale, motion.velocity * scale / time
    a = np.gradient(v, motion.dt * time, axis=0)
    links = spring_torques(motion.robot, q[rows], v[rows], a[rows])
    inertia, effort = (a @ motion.robot.M_m.T)[rows], motion.u[rows] @ motion.robot.B_m.T
    return Terms(links, inertia, v[rows], coulomb(v[rows], SMOOTHING), effort, motion.dt * (rows.step or 1))


def lacking(records: Sequence[MotionRecord], robot: Robot) -> list[str]:
    """Return a sentence for each set of sensors that joints lack in all records, and one on gear ratios and times."""
    of_sensors: dict[tuple[str, ...], list[str]] = {}
    for j, joint in enumerate(records[0].joints):
        signals = {LINK: "q_l", MOTOR: "q_m", TORQUE: "torque"}
        there = {sensor: any(record.measured(name)[j] for record in records) for sensor, name in signals.items()}
        absent = tuple(sensor for sensor in signals if not there[sensor])
        if absent in LACKING:
            of_sensors.setdefault(absent, []).append(joint)
    sentences = [
        f"{', '.join(joints)}: no {' and no '.join(absent)}: {LACKING[absent]}" for absent, joints in of_sensors.items()
    ]
    return [*sentences, *_not_seen(records, robot)]


def _not_seen(records: Sequence[MotionRecord], robot: Robot) -> list[str]:
    """Return a sentence on errors of gear ratios and times that no record shows; none if both sides are measured."""
    least: dict[str, list[tuple[float, float]]] = {}
    for record in records:
        for joint, factors in least_seen(record, robot).items():
            least.setdefault(joint, []).append(factors)
    if not least:
        return []
    ratios, times = zip(*(map(min, zip(*found, strict=True)) for found in least.values()), strict=True)
    return [
        f"{', '.join(least)}: one side only is measured: a wrong gear ratio ({_factors(ratios)}) or time scale "
        f"({_factors(times)}) {NOT_SEEN}"
    ]


def _factors(values: Sequence[float]) -> str:
    """Return the factors of the joints, in their order, from which on an error is seen, equal ones once."""
    return ", ".join(f"up to {value:.3g} times" if np.isfinite(value) else "any" for value in dict.fromkeys(values))
