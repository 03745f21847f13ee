# SPDX-License-Identifier: Apache-2.0
"""Cases of physics that the product's model does not share, identified by `fjr identify`'s code, and their table."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import fjr_core as fjr
from bench.figures import markdown
from fjr_design.uncertainty.posterior import IDENTIFIED, UNKNOWN, Estimate
from fjr_identification.estimation.identify import identify
from fjr_identification.estimation.motion_record import MotionRecord, record_of_samples
from fjr_identification.estimation.parameters import IdentifyOptions, prior_of
from fjr_identification.records.checks import findings
from fjr_identification.robot_file import NominalRobot, nominal_robot

from . import laws
from .draws import Case, Draws, drawn
from .sensors import Encoder, Sensors

MS = 1e-3
CASES = {
    **{f"Coulomb over {v:g} mrad/s": Case(laws.coulomb(v * MS)) for v in (0.1, 0.3, 1.0, 3.0, 10.0, 20.0)},
    "v / sqrt(v^2 + v_0^2), 1 mrad/s": Case(laws.root(1e-3)),
    "Stribeck, + 50 % over 50 mrad/s": Case(laws.stribeck(1e-3)),
    "Dahl, 0.1 mrad": Case(laws.dahl(1e-4)),
    "LuGre, 0.1 mrad, + 50 %": Case(laws.lugre(1e-4)),
    "Coulomb + 3 % of the load": Case(laws.loaded(1e-3, 0.03)),
    "backlash 0.2 mrad": Case(spring=laws.backlash(2e-4), cause="backlash"),
    "backlash 0.5 mrad": Case(spring=laws.backlash(5e-4), cause="backlash"),
    "backlash 0.5 mrad about the hanging arm": Case(spring=laws.backlash(5e-4), aside=0.2, cause="backlash"),
    "backlash 2 mrad": Case(spring=laws.backlash(2e-3), cause="backlash"),
    "cubic, + 30 % at 5 mrad": Case(spring=laws.cubic(0.3, 5e-3), cause="the spring is not linear"),
    "hysteresis, 0.3 K up to 1 mrad": Case(spring=laws.hysteresis(0.3, 1e-3), cause="hysteresis"),
    "kinematic error, 0.1 mrad": Case(spring=laws.kinematic_error(1e-4), cause="kinematic error"),
    "gain of the motor encoder 1.003": Case(sensors=Sensors(motor=Encoder(gain=1.003))),
    "eccentricity of 1 mrad": Case(sensors=Sensors(link=Encoder(eccentricity=1e-3)), cause="eccentric"),
    "slip of 1 mrad": Case(sensors=Sensors(link=Encoder(slip=1e-3))),
    "delay that varies by 0.5 ms": Case(jitter=5e-4),
    "0.5 % of the samples lost": Case(sensors=Sensors(lost=5e-3)),
    "tip mass of 0.3 kg": Case(
        varied=lambda arm: replace(arm, tip_mass=arm.tip_mass + 0.3), cause="the links of the robot file"
    ),
    "links 30 % too heavy in the robot file": Case(stated_mass=1.3, cause="the links of the robot file"),
    "base tilted by 3 degrees": Case(varied=lambda arm: replace(arm, tilt=arm.tilt + np.deg2rad(3.0))),
    "torque of a cable, 0.2 N m": Case(varied=lambda arm: replace(arm, cable=arm.cable + 0.2)),
    "gain of the motor encoder 1.005": Case(sensors=Sensors(motor=Encoder(gain=1.005))),
    "lag of the actuator, 2 ms": Case(lag=2 * MS),
    "torque ripple, 2 % of the weight": Case(others=laws.ripple),
    "viscous friction that falls by 20 %": Case(others=laws.warming),
    "friction 15 % larger forwards": Case(laws.one_sided(0.01, 0.15)),
    "current loop 2 % weaker at 3 rad/s": Case(others=laws.weak_at_speed),
    "eccentricity of 1 mrad, 0.5 mrad twice in a turn": Case(
        sensors=Sensors(link=Encoder(eccentricity=1e-3, second=5e-4)), cause="eccentric"
    ),
    "cable that stiffens": Case(others=laws.stiffening_cable),
    "table that swings at 15 Hz": Case(table=True),
    "play of 0.5 mrad, + 30 % at 5 mrad": Case(
        spring=laws.play_and_hardening(5e-4, 0.3, 5e-3), aside=0.2, cause="the spring is not linear"
    ),
    "motors that drag each other": Case(others=laws.of_neighbours),
    "skew that grows by 0.4 ms": Case(sensors=Sensors(drift=0.4 * MS)),
    "1 % of the samples lost, 2 in a row": Case(sensors=Sensors(lost=0.01, burst=2)),
    "efforts in 8 bits": Case(sensors=Sensors(bits=8)),
}
KINDS = {
    "joint_stiffness": "K",
    "motor_inertia": "B",
    "link_damping": "D_l",
    "motor_damping": "D_m",
    "link_coulomb_friction": "F_l",
    "motor_coulomb_friction": "F_m",
    "friction_smoothing_velocity": "v_0",
    "link_static_friction": "F_s",
    "motor_static_friction": "F_s",
    "stribeck_velocity": "v_s",
    "link_load_friction": "load",
    "motor_load_friction": "load",
    "offset": "offset",
    "effort_delay": "delay",
    "link_skew": "skew",
    "actuator_lag": "lag",
    "gear_ratio_error": "ratio",
}
COLUMNS = tuple(dict.fromkeys(KINDS.values()))
CAUSES = ("backlash", "the spring is", "hysteresis", "kinematic error", "the links of the robot", "on the position")
"""Words of the reasons that name what the model lacks."""
ROBOT = """/**:
  ros__parameters:
    joints: {joints}
    robot: {{model: urdf, urdf: arm.urdf, joint_stiffness: {stiffness}, motor_inertia: {inertia}}}
"""


@dataclass(frozen=True)
class Interval:
    """A 95 % interval beside the truth. away: of the value from the truth, in standard deviations. error: relative.

    meets: whether the interval of a stiffness meets the range of the secants that were driven. width: relative.
    """

    kind: str
    away: float
    error: float
    verdict: str
    reason: str
    meets: bool = True
    width: float = 0.0

    @property
    def inside(self) -> bool:
        """Return whether the interval contains the truth."""
        return self.away <= 1.96


def of_batch(job: tuple[str, int, int, int]) -> list[list[Interval] | None]:
    """Return the intervals of each draw of a batch: name of the case, number of joints, of draws, and seed."""
    name, joints, count, seed = job
    draws = drawn(CASES[name], joints, count, seed)
    return [identified(draws, i, IdentifyOptions(threads=1)) for i in range(count)]


def identified(draws: Draws, i: int, options: IdentifyOptions) -> list[Interval] | None:
    """Return the intervals of draw i, None if its record is refused."""
    try:
        record, nominal = read(draws, i)
        if findings(record, nominal.robot):
            return None
        found = identify([record], nominal.robot, prior_of(nominal.robot), options)
    except fjr.FjrError:
        return None
    truth, secants = draws.truth(i), draws.secants(i)
    known = [each for each in found.estimates if each.name in truth]
    joints = [nominal.joints.index(each.joint) for each in known]
    return [_interval(each, float(truth[each.name][j]), *secants[j]) for each, j in zip(known, joints, strict=True)]


def read(draws: Draws, i: int) -> tuple[MotionRecord, NominalRobot]:
    """Return the record of draw i and the robot of its robot file."""
    samples = draws.records[i]
    names = [f"joint{j}" for j in range(samples.u.shape[1])]
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "arm.urdf").write_text(draws.urdf(i), encoding="utf-8")
        text = ROBOT.format(
            joints=names, stiffness=draws.stiffness[i].tolist(), inertia=draws.motor_inertia[i].tolist()
        )
        Path(folder, "robot.yaml").write_text(text, encoding="utf-8")
        nominal = nominal_robot(Path(folder, "robot.yaml"))
    unmeasured = np.full_like(samples.u, np.nan)
    record, _ = record_of_samples(
        "physics", nominal.joints, samples.t, [samples.q_l, samples.q_m, samples.u, unmeasured]
    )
    return record, nominal


def _interval(estimate: Estimate, true: float, softest: float, stiffest: float) -> Interval:
    """Return where the truth is in an interval; that of a positive parameter has a logarithmic scale."""
    meets = estimate.name != "joint_stiffness" or bool(estimate.low <= stiffest and estimate.high >= softest)
    values = np.array([estimate.low, estimate.value, estimate.high, true])
    if estimate.name in ("joint_stiffness", "motor_inertia", "friction_smoothing_velocity", "stribeck_velocity"):
        values = np.log(values)
    values = values**2 if estimate.name == "actuator_lag" else values
    low, value, high, truth = values
    side = (value - low if truth < value else high - value) / 1.96
    if side <= 0:  # cut at 0
        side = max(value - low, high - value) / 1.96
    away = abs(truth - value) / side if side > 0 else np.inf
    error = abs(estimate.value - true) / (abs(true) or 1.0)
    width = (estimate.high - estimate.low) / (abs(true) or 1.0)
    verdict, reason = estimate.verdict, estimate.reason
    return Interval(estimate.name, float(away), float(error), verdict, reason, meets, float(width))


def head(_: Sequence[int] = ()) -> str:
    """Return the first lines of the table."""
    columns = [
        "physics",
        "records",
        "inside",
        *COLUMNS,
        "largest sigma",
        "K identified",
        "of these beyond the secants",
        "error of K",
        "width of K",
        "named",
    ]
    return "\n".join(markdown(columns, [], right=columns[1:]))


def line(name: str, of_number: Sequence[Sequence[list[Interval] | None]]) -> str:
    """Return a row of the table from the draws of each number of joints: how many intervals contain the truth.

    named: stiffnesses with the right cause; where the model lacks nothing that changes K, with any cause.
    """
    results = [result for of_n in of_number for result in of_n]
    intervals = [each for result in results if result is not None for each in result if each.verdict != UNKNOWN]
    K = [each for each in intervals if each.kind == "joint_stiffness"]
    sure = [each for each in K if each.verdict == IDENTIFIED]
    refused = sum(result is None for result in results)
    words = (CASES[name].cause,) if name in CASES and CASES[name].cause else CAUSES
    cells = [
        name,
        f"{len(results)}" + (f" ({refused} refused)" if refused else ""),
        f"{np.mean([each.inside for each in intervals]):.1%}" if intervals else "",
        *(_share([each for each in intervals if KINDS[each.kind] == column]) for column in COLUMNS),
        f"{max((each.away for each in intervals), default=0.0):.1f}",
        f"{len(sure)} of {sum(each.kind == 'joint_stiffness' for result in results for each in result or ())}",
        f"{sum(not each.meets for each in sure)} of {len(sure)}",
        f"{np.median([each.error for each in K]):.1g}" if K else "",
        f"{np.median([each.width for each in K]):.1g}" if K else "",
        f"{sum(any(word in each.reason for word in words) for each in K)}/{len(K)}" if K else "",
    ]
    return "| " + " | ".join(cells) + " |"


def _share(intervals: Iterable[Interval]) -> str:
    inside = [each.inside for each in intervals]
    return f"{sum(inside)}/{len(inside)}" if inside else ""
