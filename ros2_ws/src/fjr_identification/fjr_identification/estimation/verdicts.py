# SPDX-License-Identifier: Apache-2.0
"""Verdicts: what the records alone say about each parameter: identified, weakly identified, or not identifiable.

Parameters are held at their prior one by one, the worst known first, before the others are judged. One is determined
all the same if the records contradict its prior's value: spurious information is estimated generously, which may make a
parameter look unknown.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fjr_core.numerics.checks import Array
from fjr_design.uncertainty.posterior import IDENTIFIED, LOG, UNKNOWN, WEAK, Estimate, Fit, Identification, natural

from .estimation_problem import Estimation
from .intervals import posterior
from .motion_record import MotionRecord
from .multiple_shooting import NormalEquations, PredictedSegments
from .optimise import bounded_step
from .parameters import COULOMB, HARDENING, KINDS, LOAD, OF_LINKS, PAYLOAD, SMOOTHING, STATIC, TIMING

SHARP = 0.25
"""Standard deviation of an identified parameter: of its logarithm, or relative to its size or to its prior's width."""
BLUNT = 0.6
"""A parameter whose standard deviation exceeds this part of its prior's width is not identifiable."""
STILL = 2e-3  # rad; a joint that moves less stands still
WORSE = 1.1  # root mean square residual of some signal, relative to that of the most likely parameters
LESS_LIKELY = 2.0  # of -log L, half the 95 % quantile of chi^2
CORRELATED = 0.9
PRISMATIC_UNITS = {
    "N m/rad": "N/m",
    "N m/rad^3": "N/m^3",
    "kg m^2": "kg",
    "N m s/rad": "N s/m",
    "N m": "N",
    "rad": "m",
    "rad/s": "m/s",
}
WITHOUT_LINK = {
    **dict.fromkeys(
        ("joint_stiffness", HARDENING, "link_damping", "link_coulomb_friction", "link_static_friction"),
        "without a link encoder only the resonance determines it; excite the joint near its resonance",
    ),
    "offset": "without a link encoder the offset shifts the link alone; measure the link, or a gravity torque",
}
SHAPED = ("link_damping", "motor_damping", *COULOMB, *STATIC, *LOAD, SMOOTHING, *TIMING)
"""Parameters that friction of another shape than the model's resembles at reversals."""
OTHER_SHAPE = "friction has another shape, such as that of bristles, and acts like damping and skew at reversals"
WIDER = 2.5
"""Factor on standard deviations of a joint whose friction has another shape.

No record shows this error: jumps at reversals make residuals white. It covers the errors of damping under LuGre's
friction, of which 8 of 16 intervals held; other records are in docs/tables/identification.md.
"""
WITHOUT_MOTOR = {"offset": "without a motor position the offset shifts the motor alone; measure the motor"}


def not_identifiable(
    parts: Sequence[NormalEquations], spurious: Array, width: Array, first: Sequence[int] = ()
) -> tuple[int, ...]:
    """Return the entries of z that the records do not determine: `first`, then one by one, the worst first.

    Each is held at its prior before the others are judged: of two parameters of which only the sum matters, one is
    not identifiable, and the other one is, as far as the prior of the first allows.
    """
    fixed = list(first)
    while len(fixed) < len(width):
        ratio = posterior(parts, spurious, width, fixed).from_records / width
        ratio[fixed] = 0.0
        worst = int(np.argmax(ratio))
        if ratio[worst] <= BLUNT:
            break
        fixed.append(worst)
    return tuple(sorted(fixed))


def fitted_at_prior(best: PredictedSegments, entries: Sequence[int]) -> PredictedSegments | None:
    """Return the prediction with some entries of z at their prior's mean; None if the records contradict it.

    They do if the residuals are clearly larger there although all others adapt; where friction turns over, of which few
    samples depend, already if they are less likely by LESS_LIKELY. Initial states are sought from where the normal
    equations move them, and from those of the most likely parameters.
    """
    coordinates, (H, _) = best.problem.coordinates, best.normal_equations
    moved = np.isin(np.arange(len(best.z)), entries)
    unlikely = LESS_LIKELY if any(coordinates.free[k][0] == SMOOTHING for k in entries) else np.inf
    step = np.where(moved, coordinates.mean - best.z, 0.0)
    g = -H[np.ix_(~moved, moved)] @ step[moved]
    step[~moved] = bounded_step(H[np.ix_(~moved, ~moved)], g, best.z[~moved], coordinates.nonnegative[~moved])
    followed = best.x0 - np.array([part.B @ step for part in best.projected])
    for x0 in (followed, best.x0):
        adapted = best.problem.evaluate(best.z + step, x0, best.noise)
        if adapted is not None and np.all(adapted.residual <= WORSE * best.residual):
            return adapted if adapted.cost - best.cost < unlikely else None
    return None


@dataclass(frozen=True, eq=False)
class Estimates:
    """Estimates of all entries of z, and its mean (p,) and covariance (p, p); UNKNOWN ones have the prior's mean."""

    estimates: tuple[Estimate, ...]
    mean: Array
    covariance: Array

    def with_entries_of(self, other: Estimates, entries: Collection[int]) -> Estimates:
        """Return these estimates with some entries, and their covariance with each other, of the other ones."""
        of_other = np.array([k in entries for k in range(len(self.mean))], dtype=bool)
        covariance = np.where(np.outer(~of_other, ~of_other), self.covariance, 0.0)
        covariance = np.where(np.outer(of_other, of_other), other.covariance, covariance)
        pairs = zip(self.estimates, other.estimates, of_other, strict=True)
        estimates = tuple(theirs if chosen else ours for ours, theirs, chosen in pairs)
        return Estimates(estimates, np.where(of_other, other.mean, self.mean), covariance)

    def identification(self, joints: tuple[str, ...], fits: tuple[Fit, ...] = ()) -> Identification:
        """Return the identification with the posterior of the entries that are not UNKNOWN."""
        free = [k for k, estimate in enumerate(self.estimates) if estimate.verdict != UNKNOWN]
        kinds = tuple(KINDS[self.estimates[k].name].coordinate for k in free)
        covariance = self.covariance[np.ix_(free, free)]
        return Identification(joints, self.estimates, tuple(free), kinds, self.mean[free], covariance, fits)


def estimates_at(
    setup: Estimation,
    parts: Sequence[NormalEquations],
    spurious: Array,
    fixed: Sequence[int],
    z: Array,
    doubt: str = "",
    step: Array | None = None,
    other_shape: Collection[int] = (),
) -> Estimates:
    """Return the estimates at z (p,) from normal equations of segments or blocks and their spurious information (p, p).

    fixed: entries that are not identifiable. doubt: why no parameter is better than weakly identified; "": none. step
    (p,): by which z is away from the minimum, if it was not reached; it counts as an error. other_shape: joints whose
    friction has another shape than the model's.
    """
    coordinates, width, joints = setup.coordinates, setup.coordinates.width, setup.records[0].joints
    distribution = posterior(parts, spurious, width, fixed)
    partners = _partners(setup, posterior(parts, spurious, width).covariance)
    away = np.zeros(len(z)) if step is None else np.minimum(np.abs(step), width)
    shaped = np.array([name not in OF_LINKS and j in other_shape for name, j in coordinates.free])
    wider = np.where(shaped, WIDER, 1.0)
    covariance = distribution.covariance * np.outer(wider, wider) + np.diag(away**2)
    sd = np.where(np.isfinite(distribution.from_records), np.sqrt(np.diag(covariance)), width)
    mean = z.copy()
    mean[list(fixed)] = coordinates.mean[list(fixed)]
    estimates = []
    for k, (name, j) in enumerate(coordinates.free):
        prior = float(setup.prior.values[name][j])
        ends = mean[k] + 1.96 * sd[k] * np.array([0.0, -1.0, 1.0])
        value, low, high = natural(ends, KINDS[name].coordinate).tolist()
        why = "; ".join(filter(None, (doubt, OTHER_SHAPE if shaped[k] and name in SHAPED else "")))
        if k in fixed:
            verdict, value, why = UNKNOWN, prior, ""
        else:
            size = 1.0 if KINDS[name].coordinate == LOG else max(abs(value), SHARP * width[k])
            verdict = IDENTIFIED if sd[k] <= SHARP * size and not why else WEAK
        why = why or reason(name, verdict, setup.records, -1 if name in PAYLOAD else j, partners.get(k, ""))
        joint, unit = "" if name in PAYLOAD else joints[j], KINDS[name].unit
        unit = PRISMATIC_UNITS.get(unit, unit) if joint and any(setup.robot.prismatic[j : j + 1]) else unit
        estimates.append(Estimate(name, joint, unit, value, low, high, prior, verdict, why))
    return Estimates(tuple(estimates), mean, covariance)


def _partners(setup: Estimation, covariance: Array) -> Mapping[int, str]:
    """Return for each entry of z the name of the one that it is correlated with most, if by more than CORRELATED."""
    if not len(covariance):
        return {}
    joints, words = setup.records[0].joints, [(name, name.replace("_", " "), j) for name, j in setup.coordinates.free]
    names = [text if name in PAYLOAD else f"{text} of {joints[j]}" for name, text, j in words]
    sd = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    correlation = np.abs(covariance / np.outer(sd, sd))
    np.fill_diagonal(correlation, 0.0)
    most = np.argmax(correlation, axis=1)
    return {k: names[most[k]] for k in range(len(names)) if correlation[k, most[k]] > CORRELATED}


def reason(name: str, verdict: str, records: Sequence[MotionRecord], j: int, partner: str) -> str:
    """Return why a parameter of joint j is weakly or not identifiable, and what motion would reveal it.

    "" if it is identified. partner: the parameter that has nearly its effect, "" for none.
    """
    if verdict == IDENTIFIED:
        return ""
    link, motor = (any(np.isfinite(getattr(r, q)[:, j]).any() for r in records) for q in ("q_l", "q_m"))
    seen = [r.q_m[:, j] if np.isfinite(r.q_m[:, j]).any() else r.q_l[:, j] for r in records]
    moved = max(float(np.nanmax(q) - np.nanmin(q)) for q in seen)
    if moved < STILL and name not in ("offset", "joint_stiffness"):
        return f"the joint stands still (it moves {moved:.2g} rad); move it"
    shared = f"nearly the effect of {partner}; " if partner else ""
    without = WITHOUT_LINK if not link else {} if motor else WITHOUT_MOTOR
    return shared + without.get(name, KINDS[name].revealed_by)
