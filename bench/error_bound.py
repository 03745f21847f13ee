# SPDX-License-Identifier: Apache-2.0
"""Bound of the tracking error against the largest error of simulated runs with factors drawn within the stated errors.

`python -m bench.error_bound SCENARIO [NAME=VALUE ...]` prints the figures of one scenario, e.g. for payload=0.2, with
one sample of delay. It fails if a bound is missed.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from tqdm import tqdm

from bench.figures import Figure, table
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.model.robot import Robot
from fjr_core.motions.inverse_dynamics import motor_motion
from fjr_core.motions.reference import Reference
from fjr_core.numerics.checks import Array
from fjr_design.batch import ClosedLoop, Draws
from fjr_msgs_py.scenarios import library
from fjr_proofs.error_bound import bound_errors

RUNS = 10_000
AT_ONCE = 250  # runs between two steps of the bar
LARGEST_RATIO = 2.0  # of bound and largest error


@dataclass(frozen=True)
class Observed:
    """Time [s] until errors count and length [s] of a run; a period of the reference is between them."""

    settled: float
    duration: float


SCENARIOS = {"paper_k31": Observed(1.0, 7.3), "two_link": Observed(1.0, 7.3), "arm7": Observed(1.0, 3.0)}


def of_scenario(name: str, errors: Mapping[str, float]) -> list[Figure]:
    """Bound the tracking error for relative errors of factors and one sample of delay; compare with runs."""
    scenario = library.load(name, [])
    T = scenario.sample_period
    bound = bound_errors(scenario.law, scenario.reference, T, T, errors, prove=True)
    runs = RUNS if errors else 1
    law = TrackingLaw(scenario.robot, scenario.gains)
    peaks = largest_errors(law, scenario.reference, (T, T), errors, runs, SCENARIOS[name])
    beyond = np.count_nonzero(np.any(peaks > bound.position, axis=1))
    basis = "proven" if bound.proven else "sampled"
    largest = peaks.max(axis=0)
    sizes = {
        f"{what} of {joint} [mrad]": 1e3 * float(size)
        for what, of_joints in (("bound", bound.position), ("largest error", largest))
        for joint, size in zip(scenario.joints, of_joints, strict=True)
    }
    ratio = float(np.max(bound.position / largest))
    return [
        Figure(f"{name}, {basis} error bound: runs of {runs} beyond it", beyond, "", 0),
        Figure(f"{name}, {basis} error bound / largest error, worst joint", ratio, "", LARGEST_RATIO, parts=sizes),
    ]


def drawn(errors: Mapping[str, float], runs: int) -> Draws:
    """Return factors drawn uniformly within errors; the first are their corners."""
    half = np.array(list(errors.values()))
    share = np.random.default_rng(0).uniform(-1, 1, (runs, len(half)))
    corners = list(product((-1, 1), repeat=len(half)))
    share[: len(corners)] = corners
    factors = dict(zip(errors, (1 + share * half).T, strict=True))
    payload = factors.pop("payload", None)
    return Draws(runs, **factors | ({} if payload is None else {"link_inertia": payload, "gravity": payload}))


def on_reference(robot: Robot, reference: Reference) -> Array:
    """Return the state (4n,) of the robot that keeps its links on the reference at time 0."""
    q, dq, *more = reference.jets(0.0)
    motors = motor_motion(robot, q, dq, *more)
    return robot.state(q, motors.theta.full().ravel(), dq, motors.dtheta.full().ravel())


def largest_errors(
    law: TrackingLaw,
    reference: Reference,
    times: tuple[float, float],
    errors: Mapping[str, float],
    runs: int,
    observed: Observed,
) -> Array:
    """Return the largest |q_l - q_ld| (runs, n) [rad] once settled, of runs that start on the reference.

    times [s]: sample period and delay. The robots are drawn within the errors.
    """
    (T, delay), x0 = times, on_reference(law.robot, reference)
    loop = ClosedLoop(law.robot, law, reference, x0, observed.duration, T, settle_after=observed.settled)
    draws = replace(drawn(errors, runs), delay=delay)
    parts = [draws.taken(slice(i, i + AT_ONCE)) for i in range(0, runs, AT_ONCE)]
    outcomes = [loop.run(part) for part in tqdm(parts, desc="runs", disable=not sys.stderr.isatty())]
    if not all(part.stable.all() for part in outcomes):
        raise RuntimeError("a run is not stable; expected all of them to be")
    return np.concatenate([part.peak for part in outcomes])


if __name__ == "__main__":
    if len(sys.argv) < 2 or sys.argv[1] not in SCENARIOS:
        sys.exit(f"usage: python -m bench.error_bound {'|'.join(SCENARIOS)} [NAME=VALUE ...]")
    given = (word.partition("=") for word in sys.argv[2:])
    figures = of_scenario(sys.argv[1], {error: float(size) for error, _, size in given})
    print(table(figures))
    sys.exit(not all(figure.holds for figure in figures))
