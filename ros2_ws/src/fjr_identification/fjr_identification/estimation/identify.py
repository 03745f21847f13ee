# SPDX-License-Identifier: Apache-2.0
"""Identify an elastic arm from records: start values, maximum likelihood over segments, intervals and verdicts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from fjr_core.errors import StateError
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array
from fjr_design.uncertainty.posterior import Identification

from .estimation_problem import SHORTEST, Estimation
from .filtered_fit import confounded, filtered_fit, filtered_judgement, simulation_start
from .fit import deflection_error, fits, fits_at, motion_fits
from .initial_guess import FilteredMotion
from .judgement import Judgement, judge
from .motion_record import MotionRecord
from .parameters import PAYLOAD, Options, Prior
from .simulated_fit import simulated_fit
from .unmodelled_torque import is_simulated
from .validation import predicted_deflection

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
    z = filtered_fit(setup, motions, setup.coordinates.of_values(start))
    filtered = filtered_judgement(setup, motions, z)
    simulated_from = _simulated_from(setup, motions, z)
    if simulated_from is None:
        found = filtered.identification(records[0].joints)
        return replace(found, fits=motion_fits(setup, found))
    start = simulation_start(setup, simulated_from)
    progress("compilation", 0.0)
    fit = simulated_fit(setup, motions, start, progress)
    progress("intervals", 1.0)
    doubt = "" if fit.optimum.converged else NOT_CONVERGED
    simulated = judge(setup, fit.whole.projected, fit.chance, fit.fixed, fit.z, doubt)
    predicted = fits(*fit.last)
    residual = deflection_error(predicted, motions)
    replaced = _not_simulated(setup, simulated, filtered, fit.optimum.converged, residual)
    chosen = simulated.with_entries_of(filtered, replaced)
    other = fits_at(fit.problem, chosen.mean, fit.whole.x0) if replaced else ()
    return chosen.identification(records[0].joints, other or predicted)


def _simulated_from(setup: Estimation, motions: Sequence[FilteredMotion], z: Array) -> Array | None:
    """Return the fit from which the motion can be simulated, None without one.

    z (p,): the fit with link dampings at their prior. A wrong prior displaces the motion; free dampings may not.
    """
    for found in (z, filtered_fit(setup, motions, z, free=confounded(setup))):
        if is_simulated(setup, motions, found):
            return found
    return None


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


def _not_simulated(
    setup: Estimation, simulated: Judgement, filtered: Judgement, converged: bool, residual: Array
) -> list[int]:
    """Return the entries of z of joints whose deflection filtered least squares explain better; rather if in doubt.

    residual (n,) [rad]: what the simulation leaves of the deflection. Joints without a measured deflection are among
    them if the fit is in doubt and another joint is.
    """
    factor, own = WORSE if converged else DOUBTFUL, _unexplained(setup, simulated)
    worse = np.fmin(own, residual) > factor * _unexplained(setup, filtered)
    worse |= np.isnan(own) & (not converged and bool(worse.any()))
    return [k for k, (name, j) in enumerate(setup.coordinates.free) if name not in PAYLOAD and worse[j]]


def _unexplained(setup: Estimation, judgement: Judgement) -> Array:
    """Return the root mean square (n,) of the deflections that are not explained, NaN: not measured."""
    found = judgement.identification(setup.records[0].joints)
    seen = [predicted_deflection(each, setup.robot, setup.prior, found, setup.options) for each in setup.records]
    count = sum(len(each.t) for each in seen)
    return np.asarray(np.sqrt(sum(len(each.t) * each.elastic**2 for each in seen) / count))
