# SPDX-License-Identifier: Apache-2.0
"""Measured and predicted signals of each record, and how much of the springs' deflection the model explains."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fjr_core.numerics.checks import Array
from fjr_design.uncertainty.posterior import DEFLECTION, Fit, Identification

from .estimation_problem import Estimation
from .gauss_newton import Optimum
from .initial_guess import FilteredMotion, decimated
from .motion_record import MotionRecord
from .multiple_shooting import ROUGH, Problem
from .segments import Comparison
from .validation import Deflection, predicted_deflection


def fits(problem: Problem, optimum: Optimum) -> tuple[Fit, ...]:
    """Return the fit of each record at the optimum."""
    return _fits(problem, optimum.compared, optimum.noise)


def fits_at(problem: Problem, z: Array, x0: Array) -> tuple[Fit, ...]:
    """Return the fit of each record at z (p,), from initial states near x0 (segments, 4n); () if it is not finite."""
    found = problem.evaluate(z, x0, np.maximum(problem.floor, ROUGH))
    return _fits(problem, found[1], problem.noise(found[1])) if found else ()


def motion_fits(setup: Estimation, found: Identification) -> tuple[Fit, ...]:
    """Return the deflection of each record with the one that follows from its motion; nothing is simulated."""
    return tuple(
        _motion_fit(predicted_deflection(each, setup.robot, setup.prior, found, setup.options))
        for each in setup.records
    )


def _motion_fit(seen: Deflection) -> Fit:
    measured, predicted = {DEFLECTION: seen.measured}, {DEFLECTION: seen.predicted}
    return Fit(seen.record, seen.t, measured, predicted, {DEFLECTION: seen.elastic}, 1 - seen.unexplained**2)


def _fits(problem: Problem, compared: Sequence[Comparison], noise: Array) -> tuple[Fit, ...]:
    """Return the fit of each record; samples outside the segments are predicted by NaN."""
    records = list({id(segment.record): segment.record for segment in problem.segments}.values())
    return tuple(_fit(problem, compared, noise, record) for record in records)


def _fit(problem: Problem, comparisons: Sequence[Comparison], deviations: Array, record: MotionRecord) -> Fit:
    names = sorted({signal for signal, _ in problem.signals})
    predicted = {name: np.full(record.u.shape, np.nan) for name in names}
    noise = {name: np.full(record.u.shape[1], np.nan) for name in names}
    for segment, compared in zip(problem.segments, comparisons, strict=True):
        if segment.record is record:
            for k, (signal, joint) in enumerate(problem.signals):
                predicted[signal][segment.first : segment.first + segment.count, joint] = compared.predicted[k]
    for k, (signal, joint) in enumerate(problem.signals):
        noise[signal][joint] = deviations[k]
    measured = {name: np.asarray(getattr(record, name)) for name in names}
    t: Array = record.dt * np.arange(len(record.u), dtype=float)
    return Fit(record.name, t, measured, predicted, noise, explained(measured, predicted))


def explained(measured: dict[str, Array], predicted: dict[str, Array]) -> Array:
    """Return the share (n,) of the variance of q_m - q_l that is predicted, NaN where a side is not measured."""
    if not {"q_l", "q_m"} <= set(measured):
        return np.full(next(iter(measured.values())).shape[1], np.nan)
    seen, model = (each["q_m"] - each["q_l"] for each in (measured, predicted))
    known = np.isfinite(seen) & np.isfinite(model)
    shares = [
        1 - np.var((seen - model)[known[:, j], j]) / np.var(seen[known[:, j], j]) if known[:, j].any() else np.nan
        for j in range(seen.shape[1])
    ]
    return np.array(shares)


def deflection_error(found: Sequence[Fit], motions: Sequence[FilteredMotion]) -> Array:
    """Return the root mean square (n,) [rad] of the deflections that fits leave, within the bandwidth of the motions.

    NaN where a side is not measured.
    """
    slow = []
    for fit, motion in zip(found, motions, strict=True):
        if not {"q_l", "q_m"} <= set(fit.measured):
            return np.full(motion.u.shape[1], np.nan)
        error = {name: fit.measured[name] - fit.predicted[name] for name in ("q_l", "q_m")}
        deflection = error["q_m"] - error["q_l"]
        known = ~np.all(np.isnan(deflection), axis=0)
        slow.append(np.where(known, decimated(np.nan_to_num(deflection), motion.stride), np.nan))
    return np.asarray(np.sqrt(np.mean(np.vstack(slow) ** 2, axis=0)))
