# SPDX-License-Identifier: Apache-2.0
"""How much of a record the identified arm explains: deflections predicted from the motion, simulated fits, hold-outs.

    q_m - q_l(t + skew) = offset + (M_l a + C v + grad P_l + D_l v + F_l(v) + T(q)) / K

The right side, at t + skew, follows from the filtered motion of the record and the parameters alone (`filtered_fit`);
nothing is fitted. A rigid arm without skew has a constant deflection.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array
from fjr_design.uncertainty.posterior import DEFLECTION, Fit, Identification

from .estimation_problem import Estimation
from .filtered_fit import FilteredEquations
from .motion_record import FilteredMotion, MotionRecord, decimated, inner, smoothed
from .multiple_shooting import PredictedSegments
from .parameters import IdentifyOptions, Prior

STIFF = 1e12  # times the identified stiffness


def motion_fits(setup: Estimation, z: Array) -> list[Fit]:
    """Return the fit of each record that is not simulated: the deflection is predicted from the filtered motion.

    z (p,): parameters. Deflections are those within the bandwidth of the motion, less their means; NaN where a side is
    not measured.
    """
    fits, equations = [], FilteredEquations(setup, z)
    for k, (record, motion) in enumerate(zip(setup.records, setup.motions, strict=True)):
        errors = np.column_stack([equations.link(k, j).errors for j in range(setup.robot.n)])
        seen = inner(smoothed(record.q_m - record.q_l, record.dt), record.dt)
        measured, predicted = (decimated(side - np.mean(side, axis=0), motion.stride) for side in (seen, seen - errors))
        t = record.dt * inner(np.arange(len(record.u), dtype=float), record.dt)[:: motion.stride]
        left = _rms(measured - predicted)
        sides = {DEFLECTION: measured}, {DEFLECTION: predicted}, {DEFLECTION: left}
        fits.append(Fit(record.name, t, *sides, 1 - (left / _rms(measured)) ** 2))
    return fits


def _rms(signal: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(signal**2, axis=0)))


@dataclass(frozen=True, eq=False)
class HoldOut:
    """Root mean square of the deflection q_m - q_l that models leave unexplained, relative to all of it: shares (n, 3).

    Of the identified model; of rigid joints, with the identified skew between the sides; of the identified stiffness
    without skew. NaN where a side is not measured. A rigid joint without skew explains nothing: 1.
    """

    record: str
    joints: tuple[str, ...]
    shares: Array


def hold_out(
    identification: Identification, record: MotionRecord, robot: Robot, prior: Prior, options: IdentifyOptions
) -> HoldOut:
    """Return what models leave unexplained of a record; robot, prior, options: of the identification."""
    values = {name: value.copy() for name, value in prior.items()}
    for estimate in identification.estimates:
        values[estimate.name][identification.joints.index(estimate.joint) if estimate.joint else 0] = estimate.value
    rigid, no_skew = (
        {name: factor * values[name]} for name, factor in (("joint_stiffness", STIFF), ("link_skew", 0.0))
    )
    shares = []
    for changed in ({}, rigid, no_skew):
        setup = Estimation([record], robot, {**values, **changed}, options)
        (fit,) = motion_fits(setup, setup.coordinates.mean)
        shares.append(fit.noise[DEFLECTION] / _rms(fit.measured[DEFLECTION]))
    return HoldOut(record.name, identification.joints, np.column_stack(shares))


def simulated_fits(prediction: PredictedSegments, deviations: Array) -> tuple[Fit, ...]:
    """Return the fit of each record from the prediction of its segments and the noise (signals,).

    Samples outside the segments are predicted by NaN.
    """
    problem = prediction.problem
    records = {id(segment.record): segment.record for segment in problem.segments}
    fits = []
    for record in records.values():
        names = sorted({signal for signal, _ in problem.signals})
        predicted = {name: np.full(record.u.shape, np.nan) for name in names}
        noise = {name: np.full(record.u.shape[1], np.nan) for name in names}
        for k, (signal, joint) in enumerate(problem.signals):
            noise[signal][joint] = deviations[k]
            for segment, compared in zip(problem.segments, prediction.compared, strict=True):
                if segment.record is record:
                    at = slice(segment.first, segment.first + segment.count)
                    predicted[signal][at, joint] = compared.predicted[k]
        measured = {name: np.asarray(getattr(record, name)) for name in names}
        t: Array = record.dt * np.arange(len(record.u), dtype=float)
        fits.append(Fit(record.name, t, measured, predicted, noise, _explained(measured, predicted)))
    return tuple(fits)


def _explained(measured: Mapping[str, Array], predicted: Mapping[str, Array]) -> Array:
    """Return the share (n,) of the variance of q_m - q_l that is predicted, NaN where a side is not measured."""
    if not {"q_l", "q_m"} <= set(measured):
        return np.full(next(iter(measured.values())).shape[1], np.nan)
    seen, model = (sides["q_m"] - sides["q_l"] for sides in (measured, predicted))
    known = np.isfinite(seen) & np.isfinite(model)
    shares = [
        1 - np.var((seen - model)[known[:, j], j]) / np.var(seen[known[:, j], j]) if known[:, j].any() else np.nan
        for j in range(seen.shape[1])
    ]
    return np.array(shares)


def deflection_error(fits: Sequence[Fit], motions: Sequence[FilteredMotion]) -> Array:
    """Return the root mean square (n,) [rad] of the deflections that fits leave, within the bandwidth of the motions.

    NaN where a side is not measured.
    """
    slow = []
    for fit, motion in zip(fits, motions, strict=True):
        if not {"q_l", "q_m"} <= set(fit.measured):
            return np.full(motion.u.shape[1], np.nan)
        error = {name: fit.measured[name] - fit.predicted[name] for name in ("q_l", "q_m")}
        deflection = error["q_m"] - error["q_l"]
        known = ~np.all(np.isnan(deflection), axis=0)
        slow.append(np.where(known, decimated(np.nan_to_num(deflection), motion.stride), np.nan))
    return np.asarray(np.sqrt(np.mean(np.vstack(slow) ** 2, axis=0)))
