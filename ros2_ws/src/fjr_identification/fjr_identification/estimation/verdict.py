# SPDX-License-Identifier: Apache-2.0
"""Judge each parameter by what the records alone say about it: identified, weakly identified, or not identifiable."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fjr_core.numerics.checks import Array
from fjr_design.uncertainty.posterior import IDENTIFIED, LOG, WEAK

from .motion_record import MotionRecord
from .parameters import KINDS, PSEUDO_INERTIA
from .posterior import spread
from .variable_projection import Projected

SHARP = 0.25
"""Standard deviation of an identified parameter: of its logarithm, or relative to its size or to its prior's width."""
BLUNT = 0.6
"""A parameter whose standard deviation exceeds this part of its prior's width is not identifiable."""
STILL = 2e-3  # rad; a joint that moves less stands still


def not_identifiable(
    parts: Sequence[Projected], chance: Array, width: Array, first: Sequence[int] = ()
) -> tuple[int, ...]:
    """Return the entries of z that the records do not determine: `first`, then one by one, the worst first.

    Each is held at its prior before the others are judged: of two parameters of which only the sum matters, one is
    not identifiable, and the other one is, as far as the prior of the first allows.
    """
    fixed = list(first)
    while len(fixed) < len(width):
        ratio = spread(parts, chance, width, fixed).from_records / width
        ratio[fixed] = 0.0
        worst = int(np.argmax(ratio))
        if ratio[worst] <= BLUNT:
            break
        fixed.append(worst)
    return tuple(sorted(fixed))


@dataclass(frozen=True)
class Motion:
    """How a joint moved: ranges of its positions [rad] and of its effort [N m], and which sides are measured."""

    position: float
    effort: float
    link_measured: bool
    motor_measured: bool

    @classmethod
    def of(cls, records: Sequence[MotionRecord], j: int) -> Motion:
        """Return the motion of joint j in all records."""
        link, motor = (any(np.isfinite(getattr(r, q)[:, j]).any() for r in records) for q in ("q_l", "q_m"))
        seen = [r.q_m[:, j] if np.isfinite(r.q_m[:, j]).any() else r.q_l[:, j] for r in records]
        return cls(max(_range(each) for each in seen), max(_range(r.u[:, j]) for r in records), link, motor)


def verdict(name: str, value: float, sd: float, width: float) -> str:
    """Return the verdict of a parameter that the records determine; sd: of its coordinate."""
    size = 1.0 if KINDS[name].coordinate == LOG else max(abs(value), SHARP * width)
    return IDENTIFIED if sd <= SHARP * size else WEAK


def reason(name: str, verdict: str, motion: Motion, partner: str) -> str:
    """Return why a parameter is weakly or not identifiable, and what motion would reveal it; "" if it is identified."""
    if verdict == IDENTIFIED:
        return ""
    if motion.position < STILL and name not in ("offset", "joint_stiffness"):
        return f"the joint stands still (it moves {motion.position:.2g} rad); move it"
    shared = f"nearly the effect of {partner}; " if partner else ""
    without = WITHOUT_LINK if not motion.link_measured else {} if motion.motor_measured else WITHOUT_MOTOR
    return shared + without.get(name, MISSING[name])


MISSING = {
    "joint_stiffness": "the spring deflects too little against the noise; use larger loads or accelerations",
    "motor_inertia": "the motor accelerates too little; use faster reversals",
    "link_damping": "needs link velocities with a known link skew; use faster motion that excites the resonance",
    "motor_damping": "needs a range of velocities; move at several speeds",
    "link_coulomb_friction": "needs reversals of the link; move to and fro, slowly, too",
    "motor_coulomb_friction": "needs reversals of the motor; move to and fro, slowly, too",
    "link_static_friction": "needs motion at velocities near zero; reverse slowly",
    "motor_static_friction": "needs motion at velocities near zero; reverse slowly",
    "offset": "needs spring torques of both signs, or a known one; change the load of the joint",
    "effort_delay": "needs efforts that change quickly; use faster reversals",
    "link_skew": "needs velocities that change; move faster",
    "torque_skew": "needs spring torques that change quickly; use faster reversals",
    **dict.fromkeys(("payload_mass",), "the payload changes the torques too little; move the joints that lift it"),
    **dict.fromkeys((f"payload_position_{axis}" for axis in "xyz"), "needs poses in which its weight pulls elsewhere"),
    **dict.fromkeys(
        PSEUDO_INERTIA, "the torques of the motion do not depend on it enough; use other poses, faster motion"
    ),
    **dict.fromkeys(
        (f"position_torque_{each}" for each in ("sin1", "cos1", "sin2", "cos2")), "needs a larger range of the joint"
    ),
}
_RESONANCE = "without a link encoder only the resonance determines it; excite the joint near its resonance"
WITHOUT_LINK = {
    "joint_stiffness": _RESONANCE,
    "link_damping": _RESONANCE,
    "link_coulomb_friction": _RESONANCE,
    "link_static_friction": _RESONANCE,
    "offset": "without a link encoder the offset shifts the link alone; measure the link, or a gravity torque",
}
WITHOUT_MOTOR = {"offset": "without a motor position the offset shifts the motor alone; measure the motor"}


def partners(covariance: Array, names: Sequence[str]) -> Mapping[int, str]:
    """Return for each entry the name of the one that it is correlated with most, if by more than 0.9."""
    if not names:
        return {}
    sd = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    correlation = np.abs(covariance / np.outer(sd, sd))
    np.fill_diagonal(correlation, 0.0)
    best = np.argmax(correlation, axis=1)
    return {k: names[best[k]] for k in range(len(names)) if correlation[k, best[k]] > 0.9}


def _range(signal: Array) -> float:
    return float(np.nanmax(signal) - np.nanmin(signal))
