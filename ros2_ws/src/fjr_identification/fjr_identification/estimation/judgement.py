# SPDX-License-Identifier: Apache-2.0
"""Estimates with intervals and verdicts from the normal equations at an optimum."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from fjr_core.numerics.checks import Array
from fjr_design.uncertainty.posterior import IDENTIFIED, LOG, NONNEGATIVE, UNKNOWN, WEAK, Estimate, Fit, Identification

from .estimation_problem import Estimation
from .parameters import KINDS, PAYLOAD
from .posterior import spread
from .variable_projection import Projected
from .verdict import Motion, partners, reason, verdict


@dataclass(frozen=True, eq=False)
class Judgement:
    """Estimates of all entries of z, and its mean (p,) and covariance (p, p); UNKNOWN ones have the prior's mean."""

    estimates: tuple[Estimate, ...]
    mean: Array
    covariance: Array

    def with_entries_of(self, other: Judgement, entries: Collection[int]) -> Judgement:
        """Return the judgement with some entries, and their covariance with each other, of another one."""
        of_other = np.array([k in entries for k in range(len(self.mean))], dtype=bool)
        covariance = np.where(np.outer(~of_other, ~of_other), self.covariance, 0.0)
        covariance = np.where(np.outer(of_other, of_other), other.covariance, covariance)
        estimates = zip(self.estimates, other.estimates, of_other, strict=True)
        return Judgement(
            tuple(theirs if chosen else own for own, theirs, chosen in estimates),
            np.where(of_other, other.mean, self.mean),
            covariance,
        )

    def identification(self, joints: tuple[str, ...], fits: tuple[Fit, ...] = ()) -> Identification:
        """Return the identification with the posterior of the entries that are not UNKNOWN."""
        free = tuple(k for k, each in enumerate(self.estimates) if each.verdict != UNKNOWN)
        kinds = tuple(KINDS[self.estimates[k].name].coordinate for k in free)
        kept = list(free)
        return Identification(
            joints, self.estimates, free, kinds, self.mean[kept], self.covariance[np.ix_(kept, kept)], fits
        )


def judge(
    setup: Estimation, parts: Sequence[Projected], chance: Array, fixed: Sequence[int], z: Array, doubt: str = ""
) -> Judgement:
    """Return the judgement of z (p,) from normal equations of segments or blocks and the chance information (p, p).

    fixed: entries that are not identifiable. doubt: why no parameter is better than weakly identified; "": none.
    """
    coordinates, width = setup.coordinates, setup.coordinates.width
    found = spread(parts, chance, width, fixed)
    names = [_label(setup, *each) for each in coordinates.free]
    together = partners(spread(parts, chance, width).covariance, names)
    sd = np.where(np.isfinite(found.from_records), np.sqrt(np.diag(found.covariance)), width)
    mean = z.copy()
    mean[list(fixed)] = coordinates.mean[list(fixed)]
    motions = [Motion.of(setup.records, j) for j in range(setup.robot.n)]
    estimates = []
    for k, (name, j) in enumerate(coordinates.free):
        before = float(setup.prior.values[name][j])
        value, low, high = _interval(name, mean[k], sd[k])
        judged = UNKNOWN if k in fixed else verdict(name, value, sd[k], width[k])
        judged = WEAK if doubt and judged == IDENTIFIED else judged
        why = reason(name, judged, motions[-1 if name in PAYLOAD else j], together.get(k, ""))
        why = doubt if doubt and judged != UNKNOWN else why
        joint = "" if name in PAYLOAD else setup.records[0].joints[j]
        value = before if k in fixed else value
        estimates.append(Estimate(name, joint, _unit(setup, name, j), value, low, high, before, judged, why))
    return Judgement(tuple(estimates), mean, found.covariance)


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
