# SPDX-License-Identifier: Apache-2.0
"""Identify an elastic arm from records: start values, maximum likelihood over segments, intervals and verdicts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import StateError
from ..numerics.checks import Array
from ..robot.robot import Robot
from .equation_error import filtered_judgement
from .estimation_problem import SHORTEST, Estimation
from .fit import fits
from .gauss_newton import Optimum, Problem, optimise
from .initial_guess import FilteredMotion, shared
from .judgement import Judgement, judge
from .motion_record import MotionRecord
from .parameters import PAYLOAD, Options, Prior
from .result import Identification
from .validation import predicted_deflection
from .verdict import not_identifiable

NOT_CONVERGED = (
    "the fit did not reach a minimum, so that the interval may be too narrow; check signs, units and the prior"
)
WORSE, DOUBTFUL = 1.5, 1.1
"""Unexplained deflection, relative to that of filtered least squares, beyond which a simulation does not fit.

The first one is for a fit that has converged, the second one for one that has not.
"""


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
    fit = _fit(setup, motions, start, progress)
    progress("intervals", 1.0)
    doubt = "" if fit.optimum.converged else NOT_CONVERGED
    simulated = judge(setup, fit.whole.projected, fit.whole.chance, fit.fixed, fit.z, doubt)
    filtered = filtered_judgement(setup, motions, setup.coordinates.of_values(start))
    replaced = _not_simulated(setup, simulated, filtered, fit.optimum.converged)
    chosen = simulated.with_entries_of(filtered, replaced)
    return chosen.identification(records[0].joints, fits(*(fit.at(chosen.mean) if replaced else fit.last)))


@dataclass(frozen=True, eq=False)
class _Simulation:
    """Optimum with all parameters, what it does not tell, and the optimum without these; the problem of each."""

    problem: Problem
    whole: Optimum
    fixed: tuple[int, ...]
    last: tuple[Problem, Optimum]

    @property
    def optimum(self) -> Optimum:
        """Return the optimum without the parameters that are not identifiable."""
        return self.last[1]

    @property
    def z(self) -> Array:
        """Return z (p,) with the prior's mean of what is not identifiable."""
        z = self.problem.coordinates.mean.copy()
        z[[k for k in range(len(z)) if k not in self.fixed]] = self.optimum.z
        return z

    def at(self, z: Array) -> tuple[Problem, Optimum]:
        """Return the prediction at other parameters z (p,); that of the optimum if it does not stay finite."""
        found = self.problem.evaluate(z, self.whole.x0, self.whole.noise)
        if found is None:
            return self.last
        x0, compared = found
        return self.problem, replace(self.whole, z=z, x0=x0, compared=compared, noise=self.problem.noise(compared))


def _fit(
    setup: Estimation,
    motions: Sequence[FilteredMotion],
    start: Mapping[str, Array],
    progress: Callable[[str, float], None],
) -> _Simulation:
    """Return the most likely parameters, and those without the ones that are not identifiable."""
    problem = setup.problem(setup.coordinates, start, motions)
    z = setup.coordinates.of_values(shared(start))
    whole = optimise(problem, z, problem.filtered, lambda share: progress("prediction error", share))
    fixed = not_identifiable(whole.projected, whole.chance, setup.coordinates.width)
    if not fixed:
        return _Simulation(problem, whole, fixed, (problem, whole))
    fewer = setup.problem(setup.coordinates.without(fixed), start, motions)
    kept = [k for k in range(len(z)) if k not in fixed]
    again = optimise(fewer, whole.z[kept], whole.x0, lambda share: progress("prediction error again", share))
    return _Simulation(problem, whole, fixed, (fewer, again))


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


def _not_simulated(setup: Estimation, simulated: Judgement, filtered: Judgement, converged: bool) -> list[int]:
    """Return the entries of z of joints whose deflection filtered least squares explain better; rather if in doubt."""
    factor = WORSE if converged else DOUBTFUL
    worse = _unexplained(setup, simulated) > factor * _unexplained(setup, filtered)
    return [k for k, (name, j) in enumerate(setup.coordinates.free) if name not in PAYLOAD and worse[j]]


def _unexplained(setup: Estimation, judgement: Judgement) -> Array:
    """Return the root of the sum of squares (n,) of the deflections that are not explained, NaN: not measured."""
    found = judgement.identification(setup.records[0].joints)
    seen = [predicted_deflection(each, setup.robot, setup.prior, found, setup.options) for each in setup.records]
    return np.asarray(np.sqrt(sum(len(each.t) * each.elastic**2 for each in seen)))
