# SPDX-License-Identifier: Apache-2.0
"""Identify an elastic arm from records: start values, maximum likelihood over segments, intervals and verdicts."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..errors import StateError
from ..robot.robot import Robot
from .estimation_problem import SHORTEST, Estimation
from .fit import fits
from .gauss_newton import Optimum, Problem, optimise
from .motion_record import MotionRecord
from .parameters import KINDS, PAYLOAD, Options, Prior
from .posterior import spread
from .result import IDENTIFIED, LOG, NONNEGATIVE, UNKNOWN, WEAK, Estimate, Identification
from .verdict import Motion, not_identifiable, partners, reason, verdict

NOT_CONVERGED = (
    "the fit did not reach a minimum, so that the interval may be too narrow; check signs, units and the prior"
)


def identify(
    records: Sequence[MotionRecord],
    robot: Robot,
    prior: Prior,
    options: Options = Options(),  # noqa: B008 - immutable
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> Identification:
    """Return estimates of the free parameters with intervals and verdicts, from all records together.

    robot: whose rigid links are trusted. prior: start and fallback, e.g. Prior.of(robot). progress: called with what is
    done and its share. Raises StateError for records that do not fit the robot, CompilerError without a C compiler.
    """
    _check(records, robot)
    setup = Estimation(list(records), robot, prior, options)
    progress("filtered least squares", 0.0)
    motions, start = setup.start()
    progress("compilation", 0.0)
    problem = setup.problem(setup.coordinates, start, motions)
    x0 = problem.filtered
    optimum = optimise(
        problem, problem.coordinates.of_values(start), x0, lambda share: progress("prediction error", share)
    )
    fixed = not_identifiable(optimum.projected, optimum.chance, setup.coordinates.width)
    if fixed:
        problem = setup.problem(setup.coordinates.without(fixed), start, motions)
        kept = [k for k in range(len(optimum.z)) if k not in fixed]
        again = optimise(problem, optimum.z[kept], optimum.x0, lambda share: progress("prediction error again", share))
    else:
        again = optimum
    progress("intervals", 1.0)
    return _result(setup, problem, optimum, again, fixed)


def _check(records: Sequence[MotionRecord], robot: Robot) -> None:
    if not records:
        raise StateError("there is no record; expected at least one")
    for record in records:
        if len(record.joints) != robot.n or record.joints != records[0].joints:
            raise StateError(
                f"{record.name} has joints {', '.join(record.joints)}; expected the {robot.n} of the robot"
            )
        if len(record.u) * record.dt < 2 * SHORTEST:
            raise StateError(
                f"{record.name} has {len(record.u) * record.dt:.3g} s; expected at least {2 * SHORTEST:g} s"
            )


def _result(
    setup: Estimation, problem: Problem, first: Optimum, optimum: Optimum, fixed: Sequence[int]
) -> Identification:
    """Return the estimates at the optimum without the parameters that are not identifiable."""
    coordinates, width = setup.coordinates, setup.coordinates.width
    kept = [k for k in range(len(width)) if k not in fixed]
    found = spread(first.projected, first.chance, width, fixed)
    alone = found.from_records
    covariance = found.covariance[np.ix_(kept, kept)]
    z = coordinates.mean.copy()
    z[kept] = optimum.z
    whole = spread(first.projected, first.chance, width)
    names = [_label(setup, *each) for each in coordinates.free]
    together = partners(whole.covariance, names)
    sd = np.where(np.isfinite(alone), np.sqrt(np.diag(found.covariance)), width)
    motions = [Motion.of(setup.records, j) for j in range(setup.robot.n)]
    estimates = []
    for k, (name, j) in enumerate(coordinates.free):
        before = float(setup.prior.values[name][j])
        value, low, high = _interval(name, z[k], sd[k])
        judged = UNKNOWN if k in fixed else verdict(name, value, sd[k], width[k])
        if judged == IDENTIFIED and not optimum.converged:
            judged = WEAK
        why = reason(name, judged, motions[-1 if name in PAYLOAD else j], together.get(k, ""))
        if judged != UNKNOWN and not optimum.converged:
            why = NOT_CONVERGED
        joint = "" if name in PAYLOAD else setup.records[0].joints[j]
        value = before if k in fixed else value
        estimates.append(Estimate(name, joint, _unit(setup, name, j), value, low, high, before, judged, why))
    kinds = tuple(KINDS[coordinates.free[k][0]].coordinate for k in kept)
    series = fits(problem, optimum)
    return Identification(setup.records[0].joints, tuple(estimates), tuple(kept), kinds, optimum.z, covariance, series)


def _interval(name: str, z: float, sd: float) -> tuple[float, float, float]:
    ends = np.array([z, z - 1.96 * sd, z + 1.96 * sd])
    coordinate = KINDS[name].coordinate
    if coordinate == LOG:
        ends = np.exp(ends)
    elif coordinate == NONNEGATIVE:
        ends = np.maximum(ends, 0.0)
    value, low, high = ends.tolist()
    return value, low, high


def _label(setup: Estimation, name: str, j: int) -> str:
    words = name.replace("_", " ")
    return words if name in PAYLOAD else f"{words} of {setup.records[0].joints[j]}"


def _unit(setup: Estimation, name: str, j: int) -> str:
    unit = KINDS[name].unit
    slides = bool(setup.robot.prismatic) and name not in PAYLOAD and setup.robot.prismatic[j]
    return PRISMATIC_UNITS.get(unit, unit) if slides else unit


PRISMATIC_UNITS = {"N m/rad": "N/m", "kg m^2": "kg", "N m s/rad": "N s/m", "N m": "N", "rad": "m"}
