# SPDX-License-Identifier: Apache-2.0
"""`fjr identify`: a robot file with intervals from recorded motion."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from fjr_bringup.identification.command import Request, identify_robot
from fjr_bringup.identification.read_record import Reading
from fjr_bringup.result import Result
from fjr_core.errors import ParameterError
from fjr_core.identification.finding import KINDS
from fjr_core.identification.parameters import Options


def identify(
    records: Sequence[Path],
    robot: Path,
    hold_outs: Sequence[Path],
    mapping: Path | None,
    joints: tuple[str, ...],
    start: float,
    duration: float,
    accepted: Sequence[str],
    payload: bool,
    link_inertia: bool,
    static_friction: bool,
    position_torque: str,
    output: Path,
) -> Result:
    """Identify a robot from records; accepted: kinds of contradictions that are reported only."""
    unknown = [kind for kind in accepted if kind not in KINDS]
    if unknown:
        raise ParameterError(f"--accept is '{unknown[0]}'; expected one of {', '.join(KINDS)}")
    options = Options(
        joints=joints,
        payload=payload,
        link_inertia=link_inertia,
        static_friction=static_friction,
        position_torque=position_torque,
    )
    reading = Reading(start=start, duration=duration, accepted=accepted)
    return identify_robot(Request(records, hold_outs, robot, mapping, reading, options, output))
