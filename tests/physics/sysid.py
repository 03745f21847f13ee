# SPDX-License-Identifier: Apache-2.0
"""Foreign records for `fjr identify` and for mujoco.sysid, side by side.

mujoco.sysid estimates stiffness, rotor inertia, damping and dry friction. It is told what it does not estimate and
`fjr identify` does: the effort's delay, the link encoder's skew, the offset, and the state every half second.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
from scipy.interpolate import CubicSpline

import fjr_core as fjr
from bench.figures import markdown
from bench.identification_peers import CHANGES, Case, Estimated, theirs
from fjr_identification.estimation.motion_record import MotionRecord
from fjr_identification.estimation.parameters import IdentifyOptions

from .coverage import CASES, Interval, identified
from .draws import Draws, drawn
from .sensors import EDGE

PIECE = 0.5  # s; from one known state to the next
SUBSTEPS = 4  # of MuJoCo in a sample period; larger steps soften its dry friction
HEADINGS = ("physics", "records", "by", "error of K", "95 % intervals with the truth", "of K", "processor time")


Both = dict[str, tuple[float, list[Interval]]]
"""Processor time [s] and intervals of a draw, by who estimates them."""


def of_batch(job: tuple[str, int, int, int]) -> list[Both]:
    """Return the intervals of each draw of a batch: name of the case, number of joints, of draws, and seed."""
    name, joints, count, seed = job
    draws = drawn(CASES[name], joints, count, seed)
    return [{"`fjr identify`": _ours(draws, i), "`mujoco.sysid`": _theirs(draws, i)} for i in range(count)]


def head(_: Sequence[int]) -> str:
    """Return the first lines of the table."""
    return "\n".join(markdown(HEADINGS, [], right=HEADINGS[1:]))


def line(name: str, of_number: Sequence[Sequence[Both]]) -> str:
    """Return the rows of a case: median error of K, coverage, and median processor time of both."""
    results = [result for of_n in of_number for result in of_n]
    rows = []
    for by in results[0]:
        intervals = [each for result in results for each in result[by][1]]
        of_K = [each for each in intervals if each.kind == "joint_stiffness"]
        rows.append(
            f"| {name} | {len(results)} | {by} | {np.median([each.error for each in of_K]):.2g} "
            f"| {np.mean([each.inside for each in intervals]):.1%} of {len(intervals)} "
            f"| {sum(each.inside for each in of_K)} of {len(of_K)} "
            f"| {np.median([result[by][0] for result in results]):.2f} s |"
        )
    return "\n".join(rows)


def _ours(draws: Draws, i: int) -> tuple[float, list[Interval]]:
    began = time.process_time()
    found = identified(draws, i, IdentifyOptions(threads=1))
    return time.process_time() - began, [each for each in found or [] if each.kind in CHANGES]


def _theirs(draws: Draws, i: int) -> tuple[float, list[Interval]]:
    case = case_of(draws, i)
    found = theirs(case, round(draws.case.duration / PIECE), SUBSTEPS)
    return found.seconds, intervals(case, found)


def case_of(draws: Draws, i: int) -> Case:
    """Return draw i at the instants at which its efforts change, without skew, delay and offset."""
    samples, n, truth = draws.records[i], draws.skew.shape[1], draws.truth(i)
    k = np.arange(EDGE, len(draws.motion.u) - EDGE)
    t = draws.motion.t[k, i]
    q_l, q_m = (
        np.stack([CubicSpline(samples.t + late, q)(t) for late, q in zip(lates, sides.T, strict=True)], axis=1)
        for lates, sides in ((draws.skew[i], samples.q_l), (np.zeros(n), samples.q_m))
    )
    names = tuple(f"joint{j}" for j in range(n))
    u, unmeasured = draws.motion.u[k, i], np.full_like(q_l, np.nan)
    record = MotionRecord("physics", names, draws.case.dt, u, q_l, q_m - truth["offset"], unmeasured)
    motion = draws.motion.x[k, i, :4].copy()
    motion[:, 1] -= truth["offset"]
    robot = fjr.robot_from_urdf(
        draws.urdf(i), names, stiffness=draws.stiffness[i], motor_inertia=draws.motor_inertia[i]
    )
    known = {name: truth[name] for name in CHANGES}
    start = {name: value * np.exp(0.3 * (-1) ** j) for j, (name, value) in enumerate(known.items())}
    start |= {"joint_stiffness": draws.stiffness[i], "motor_inertia": draws.motor_inertia[i]}
    return Case(robot, record, motion.reshape(len(k), -1), known, start)


def intervals(case: Case, found: Estimated) -> list[Interval]:
    """Return the intervals of an estimate beside the truth."""
    return [
        Interval(name, abs(value - true) / max(high - value, 1e-300) * 1.96, abs(value / true - 1), "identified", "")
        for name, *ends in zip(case.truth, found.values, found.high, case.truth.values(), strict=True)
        for value, high, true in zip(*ends, strict=True)
    ]
