# SPDX-License-Identifier: Apache-2.0
"""Identify an elastic arm from records: filtered least squares, maximum likelihood over segments, intervals, verdicts.

A simulation predicts the deflection of a spring only if the torques that the model lacks displace the motion less than
it deflects; they add up twice over the time of a segment:

    d = integral integral r_m / (B + M_jj) less the line of a free initial state,   r_m: error of the motor's equation

Friction of large gears and a counterbalance easily move a simulated motor by a hundred times the deflection. Joints
that a simulation does not explain keep the values of filtered least squares.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.signal import detrend

from fjr_core.errors import StateError
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array
from fjr_design.uncertainty.posterior import DEFLECTION, Fit, Identification

from .elastic_arm import packed
from .estimation_problem import SHORTEST, Estimation
from .filtered_fit import (
    FilteredEquations,
    confounded,
    filtered_estimates,
    filtered_fit,
    simulation_start,
    with_static_friction,
)
from .lack_of_fit import rubs_with_load, seen, withheld
from .motion_record import MotionRecord, shifted
from .multiple_shooting import PredictedSegments
from .optimise import COLOURED, coloured, joints_lacking, optimise, parameter_step, refine, with_reversals
from .parameters import COULOMB, PAYLOAD, SMOOTHING, IdentifyOptions, Prior
from .validation import deflection_error, motion_fits, simulated_fits
from .verdicts import Estimates, estimates_at, fitted_at_prior, not_identifiable, spurious_information

NOT_CONVERGED = (
    "the fit did not reach a minimum, so that the interval may be too narrow; check signs, units and the prior"
)
WORSE, DOUBTFUL = 1.5, 1.1
"""Unexplained deflection, relative to that of filtered least squares, beyond which a simulation does not fit: one that
has converged, and one that has not."""
RUBS = 2.0  # standard deviations; friction of a joint that is not 0 by chance
LIKELIER = 10.0  # increase of log L from which on a friction that falls with the velocity counts
SMOOTHER = (1.0, 0.1)  # times the prior's velocity over which friction turns over
MOST = 1.0  # displacement, relative to the deflection, beyond which a simulation does not predict it

Progress = Callable[[str, float], None]


def identify(
    records: Sequence[MotionRecord],
    robot: Robot,
    prior: Prior,
    options: IdentifyOptions = IdentifyOptions(),  # noqa: B008 - immutable
    progress: Progress = lambda what, share: None,
) -> Identification:
    """Return estimates of the free parameters with intervals and verdicts, from all records together.

    robot: whose rigid links are trusted. prior: start and fallback, e.g. prior_of(robot). progress: called with what is
    done and its share. Raises StateError for records that do not fit the robot, CompilerError without a C compiler.
    """
    _check(records, robot)
    setup = Estimation(list(records), robot, prior, options)
    progress("filtered least squares", 0.0)
    z = filtered_fit(setup, setup.coordinates.mean)
    if not options.load_friction and rubs_with_load(setup, z):
        setup = replace(setup, options=replace(options, load_friction=True))
        z = filtered_fit(setup, setup.coordinates.mean)
    names, joints = setup.records[0].joints, seen(setup, z)
    filtered = withheld(setup, filtered_estimates(setup, z), joints)
    z_start = _start_of_simulation(setup, z)
    if z_start is None:
        by_filter = filtered.identification(names)
        return replace(by_filter, fits=tuple(motion_fits(setup, filtered.mean)))
    progress("compilation", 0.0)
    simulated = simulated_fit(setup, simulation_start(setup, z_start), progress)
    simulated = replace(simulated, estimates=withheld(simulated.setup, simulated.estimates, joints))
    progress("intervals", 1.0)
    if simulated.setup is not setup:
        setup = simulated.setup
        z = filtered_fit(setup, setup.coordinates.mean)
        filtered = withheld(setup, filtered_estimates(setup, z), joints)
    entries = _better_by_filter(setup, simulated, filtered)
    if not entries:
        return simulated.estimates.identification(names, simulated.fits)
    mixed = simulated.estimates.with_entries_of(filtered, entries)
    best = simulated.best
    other = best.problem.evaluate(mixed.mean, best.x0, best.problem.rough_noise)
    return mixed.identification(names, simulated_fits(other, other.residual) if other else simulated.fits)


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


@dataclass(frozen=True, eq=False)
class Simulation:
    """Estimates by simulation and the fit of each record; best: the prediction with all parameters free.

    setup: whose friction may have more parameters than that of the start. converged: as of the last prediction.
    """

    setup: Estimation
    best: PredictedSegments
    estimates: Estimates
    fits: tuple[Fit, ...]
    converged: bool


def simulated_fit(setup: Estimation, start: Mapping[str, Array], progress: Progress) -> Simulation:
    """Return the most likely parameters by simulation, without those that the records do not determine."""
    best = _optimum(setup, start, progress)
    if np.max(coloured(best)) >= COLOURED and not setup.options.static_friction:
        setup, best = _falling_with_speed(setup, best, progress)
    best, smooth = with_reversals(best, lambda share: progress("friction of another shape", share)), best
    progress("intervals", 0.0)
    spurious, held = spurious_information(best), best.problem.coordinates.held
    parts = best.projected
    if held:  # what they change acts on the intervals of the others
        whole = best.problem.holding(()).evaluate(best.z, best.x0, best.noise)
        parts = whole.projected if whole else parts
    unknown = not_identifiable(parts, spurious, setup.coordinates.width, tuple(held))
    fixed = tuple(k for k in unknown if k in held or fitted_at_prior(best, (k,)) is not None)
    last = best
    if set(fixed) != held:
        near = fitted_at_prior(best, fixed) or best
        z = np.where(np.isin(np.arange(len(near.z)), fixed), setup.coordinates.mean, near.z)
        again = lambda share: progress("prediction error again", share)  # noqa: E731
        last = refine(best.problem.holding(fixed), z, near.x0, best.noise, again)
    doubt = "" if last.converged else NOT_CONVERGED
    step = None if last.converged else parameter_step(last, 0.0)
    estimates = estimates_at(setup, parts, spurious, fixed, last.z, doubt, step, *joints_lacking(smooth, best))
    return Simulation(setup, best, estimates, simulated_fits(last, last.noise), last.converged)


def _falling_with_speed(
    setup: Estimation, best: PredictedSegments, progress: Progress
) -> tuple[Estimation, PredictedSegments]:
    """Return what is given, or the most likely parameters with static friction, if records show it.

    The search starts from two velocities over which friction turns over, because it seldom finds one that is far off.
    """
    options, values = replace(setup.options, static_friction=True), setup.prior
    near = with_static_friction(best.problem.coordinates.parameters(best.z))
    for factor in SMOOTHER:
        smoother = {SMOOTHING: factor * values[SMOOTHING]}
        richer = replace(setup, options=options, prior={**values, **smoother})
        static = _optimum(richer, {**near, **smoother}, progress)
        if static.cost < best.cost - LIKELIER:
            setup, best = richer, static
        if np.max(coloured(best)) < COLOURED:
            break
    return setup, best


def _optimum(setup: Estimation, start: Mapping[str, Array], progress: Progress) -> PredictedSegments:
    """Return the most likely parameters.

    The velocity over which the friction of a joint turns over is free once all others are near, and if that friction
    is not 0 by chance: else it only changes what is within the noise, and keeps its prior. It does so, too, if the
    search reaches a minimum without it only: then friction has another shape, which jumps at reversals average out.
    """
    free = setup.coordinates.free
    turning = [k for k, (name, _) in enumerate(free) if name == SMOOTHING]
    problem = setup.problem(start, turning)
    z = problem.coordinates.of_values(start)
    near = optimise(problem, z, problem.filtered, lambda share: progress("prediction error", share))
    levels, covariance = problem.coordinates.parameters(near.z), np.linalg.inv(near.normal_equations[0])
    still = []
    for k in turning:
        of_joint = [name in COULOMB and j == free[k][1] for name, j in free]
        deviation = np.sqrt(np.sum(covariance[np.ix_(of_joint, of_joint)]))
        if sum(levels[name][free[k][1]] for name in COULOMB) <= RUBS * deviation:
            still.append(k)
    if len(still) == len(turning):
        return near
    step = lambda share: progress("friction at reversals", share)  # noqa: E731
    turned = refine(problem.holding(still), near.z, near.x0, near.noise, step)
    return near if near.converged and not turned.converged else turned


def _start_of_simulation(setup: Estimation, z: Array) -> Array | None:
    """Return the fit from which the deflection of some joint can be simulated, None without one.

    z (p,): the fit with link dampings at their prior. A wrong prior displaces the motion; free dampings may not.
    """
    for free in ((), confounded(setup)):
        start = filtered_fit(setup, z, free=free) if free else z
        relative = displacement(setup, start)
        if not len(relative) or np.min(relative) <= MOST:
            return start
    return None


def displacement(setup: Estimation, z: Array) -> Array:
    """Return by how much torques that the model lacks displace the joints in a segment, relative to their deflection.

    (n,), root mean squares over all records at z (p,). Without the joints that are not measured on both sides.
    """
    n, equations, arm = setup.robot.n, FilteredEquations(setup, z), setup.arm(setup.coordinates)
    p = equations.p
    length, values = setup.segment_length(p), packed(arm, p)
    links = np.mean([np.diag(arm.link_inertia(q, values).full()) for q in setup.poses], axis=0)
    inertia = np.asarray(links + p["motor_inertia"])
    moved, deflected = np.zeros(n), np.zeros(n)
    for k, (record, motion) in enumerate(zip(setup.records, setup.motions, strict=True)):
        for j in (j for j in range(n) if record.both_sides(j)):
            side = equations.motor(k, j)
            acceleration = np.where(side.used, side.errors, 0.0) / inertia[j]
            for piece in np.array_split(acceleration, max(1, round(len(acceleration) * motion.dt / length))):
                velocity = cumulative_trapezoid(piece, dx=motion.dt, initial=0.0)
                moved[j] += np.sum(detrend(cumulative_trapezoid(velocity, dx=motion.dt, initial=0.0)) ** 2)
            deflection = motion.q_m[:, j] - shifted(motion.q_l[:, j], motion.dt, p["link_skew"][j])
            deflected[j] += np.sum((deflection - np.mean(deflection)) ** 2)
    return np.sqrt(moved[deflected > 0] / deflected[deflected > 0])


def _better_by_filter(setup: Estimation, simulated: Simulation, filtered: Estimates) -> list[int]:
    """Return the entries of z of joints whose deflection filtered least squares explain better; rather if in doubt.

    Joints without a measured deflection are among them if the fit is in doubt and another joint is.
    """
    factor = WORSE if simulated.converged else DOUBTFUL
    by_motion, by_filter = (_unexplained(setup, estimates) for estimates in (simulated.estimates, filtered))
    worse = np.fmin(by_motion, deflection_error(simulated.fits, setup.motions)) > factor * by_filter
    worse |= np.isnan(by_motion) & (not simulated.converged and bool(worse.any()))
    return [k for k, (name, j) in enumerate(setup.coordinates.free) if name not in PAYLOAD and worse[j]]


def _unexplained(setup: Estimation, estimates: Estimates) -> Array:
    """Return the root mean square (n,) of the deflections that are not explained, NaN: not measured."""
    fits = motion_fits(setup, estimates.mean)
    count = sum(len(fit.t) for fit in fits)
    return np.asarray(np.sqrt(sum(len(fit.t) * fit.noise[DEFLECTION] ** 2 for fit in fits) / count))
