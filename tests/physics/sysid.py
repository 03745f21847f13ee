# SPDX-License-Identifier: Apache-2.0
"""Foreign records for `fjr identify` and for mujoco.sysid, side by side: `python -m tests.physics.sysid [WORD ...]`.

mujoco.sysid estimates stiffness, rotor inertia, damping and dry friction. It is told what it does not estimate and
`fjr identify` does: the effort's delay, the link encoder's skew, the offset, and the state every half second.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT)]
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np  # noqa: E402
import pinocchio as pin  # noqa: E402
from scipy.interpolate import CubicSpline  # noqa: E402

import fjr_core as fjr  # noqa: E402
from bench.identification_peers import CHANGES, Case, Estimated, theirs  # noqa: E402
from fjr_identification.estimation.motion_record import MotionRecord  # noqa: E402
from fjr_identification.estimation.parameters import IdentifyOptions  # noqa: E402
from fjr_msgs_py.console.output import progress_bar  # noqa: E402
from physics.coverage import CASES, Interval, identified  # noqa: E402
from physics.draws import Draws, drawn  # noqa: E402
from physics.sensors import EDGE  # noqa: E402

PIECE = 0.5  # s; from one known state to the next
SUBSTEPS = 4  # of MuJoCo in a sample period; larger steps soften its dry friction
HEADINGS = ("physics", "records", "by", "error of K", "95 % intervals with the truth", "of K", "processor time")


def main(words: Sequence[str]) -> int:
    """Print the table; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.physics.sysid")
    parser.add_argument("--draws", type=int, default=20, help="records of each case")
    parser.add_argument("--joints", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("words", nargs="*", metavar="WORD", help="only cases whose name contains one of these")
    given = parser.parse_args(words)
    names = [name for name in CASES if not given.words or any(word in name for word in given.words)]
    print("\n".join([f"| {' | '.join(HEADINGS)} |", f"| --- {'| ---: ' * (len(HEADINGS) - 1)}|"]), flush=True)
    with progress_bar("identifying", "{desc}: {percentage:3.0f}% |{bar}| {elapsed}", total=len(names)) as bar:
        for name in names:
            bar.set_description(name)
            print("\n".join(rows(name, drawn(CASES[name], given.joints, given.draws, given.seed))), flush=True)
            bar.update()
    return 0


def rows(name: str, draws: Draws) -> list[str]:
    """Return the rows of a case: median error of K, coverage, and median processor time of both."""
    errors: dict[str, list[float]] = {"`fjr identify`": [], "`mujoco.sysid`": []}
    inside: dict[str, list[tuple[bool, bool]]] = {by: [] for by in errors}
    seconds: dict[str, list[float]] = {by: [] for by in errors}
    for i in range(len(draws.records)):
        for by, found in zip(errors, (_ours(draws, i), _theirs(draws, i)), strict=True):
            seconds[by].append(found[0])
            inside[by] += [(each.inside, each.kind == "joint_stiffness") for each in found[1]]
            errors[by] += [each.error for each in found[1] if each.kind == "joint_stiffness"]
    return [
        f"| {name} | {len(draws.records)} | {by} | {np.median(errors[by]):.2g} "
        f"| {np.mean([held for held, _ in inside[by]]):.1%} of {len(inside[by])} "
        f"| {sum(held for held, of_K in inside[by] if of_K)} of {len(errors[by])} | {np.median(seconds[by]):.2f} s |"
        for by in errors
    ]


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
    text = draws.urdf(i)
    robot = fjr.robot_from_urdf(text, names, stiffness=draws.stiffness[i], motor_inertia=draws.motor_inertia[i])
    limits = '<limit lower="-9" upper="9" effort="1" velocity="1"/></joint>'
    model = pin.buildModelFromXML(text.replace('"continuous"', '"revolute"').replace("</joint>", limits))
    known = {name: truth[name] for name in CHANGES}
    start = {name: value * np.exp(0.3 * (-1) ** j) for j, (name, value) in enumerate(known.items())}
    start |= {"joint_stiffness": draws.stiffness[i], "motor_inertia": draws.motor_inertia[i]}
    return Case(robot, model, record, motion.reshape(len(k), -1), known, start)


def intervals(case: Case, found: Estimated) -> list[Interval]:
    """Return the intervals of an estimate beside the truth."""
    return [
        Interval(name, abs(value - true) / max(high - value, 1e-300) * 1.96, abs(value / true - 1), "identified", "")
        for name, *ends in zip(case.truth, found.values, found.high, case.truth.values(), strict=True)
        for value, high, true in zip(*ends, strict=True)
    ]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
