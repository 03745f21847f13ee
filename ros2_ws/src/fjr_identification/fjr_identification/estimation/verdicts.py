# SPDX-License-Identifier: Apache-2.0
"""Intervals and verdicts: the covariance of the estimate from coloured residuals, and what the records alone say.

Residuals of a wrong model are correlated over time. Segments have initial states of their own, so their scores
g_s = J_s' r_s are nearly independent, and the sandwich H^-1 (sum g_s g_s') H^-1 measures what the correlation does
(K.-Y. Liang, S. L. Zeger, Biometrika 73(1), 1986). Its standard deviations, where larger, replace those of H^-1; its
correlations do not, because it has the rank of the number of segments. The quantile is Student's.

A record has few segments, so a variance of the sandwich is uncertain by half. What is wrong with a model widens most
parameters: a factor of variance counts as at least the geometric mean of its own and of the median of all (G. K. Smyth,
Stat. Appl. Genet. Mol. Biol. 3(1), 2004: variances moderated by those of the others).

The sandwich takes the errors of segments to be independent. Those of a wrong model (friction of another shape) are not:
they displace the estimate in the same direction in each segment, which scores at the optimum, whose sum is 0, do not
show. The part of their squares that exceeds white residuals counts as correlated between all segments (SYSTEMATIC), so
that it does not average out however long the record is. No record shows this correlation. It is estimated from others
(tests/physics, seed 7001), where errors in standard deviations have mean square 1 at 0.36 with Dahl's friction, 0.06
with LuGre's and 0.02 with Stribeck's; the largest counts.

Part of the information about z in the normal equations is spurious: the records do not determine what it says. Initial
states fit noise: a spring at rest seems to swing, at a frequency that seems to reveal its stiffness. And initial states
have a prior: without a motor encoder the offset of a spring only shifts the motor, away from this prior.

A parameter is identified, weakly identified or not identifiable. Parameters are held at their prior one by one, the
worst known first, before the others are judged. One is determined all the same if the records contradict its prior's
value: spurious information is estimated generously, which may make a parameter look unknown.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.stats import norm, t

from fjr_core.numerics.checks import Array
from fjr_design.uncertainty.posterior import IDENTIFIED, LOG, UNKNOWN, WEAK, Estimate, Fit, Identification, natural

from .estimation_problem import Estimation
from .motion_record import MotionRecord
from .multiple_shooting import RIDGE, NormalEquations, PredictedSegments
from .optimise import bounded_step
from .parameters import COULOMB, HARDENING, KINDS, LAG, LOAD, OF_LINKS, PAYLOAD, SMOOTHING, STATIC, TIMING

CONFIDENCE = 0.95  # two-sided, of the intervals
LAGS = 2
"""Segments over which scores are taken to be correlated, with the weights of Bartlett (W. Newey, K. West, 1987)."""
SYSTEMATIC, TWO_SIDED = 0.4, 2.0
"""Correlation of the errors of a model between segments, and standard deviations of what is due to chance."""
LEAST_DRAWS = 24  # of all segments together
CAUTION = 4.0  # factor on spurious information: noise is estimated from few draws, the prior's share to first order
SHARP = 0.25
"""Standard deviation of an identified parameter: of its logarithm, or relative to its size or to its prior's width."""
BLUNT = 0.6  # of its prior's width; a parameter whose standard deviation exceeds it is not identifiable
STILL = 2e-3  # rad; a joint that moves less stands still
WORSE = 1.1  # root mean square residual of some signal, relative to that of the most likely parameters
LESS_LIKELY = 2.0  # of -log L, half the 95 % quantile of chi^2
CORRELATED = 0.9  # least coefficient of correlation that is named
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
"""Factor on standard deviations of a joint whose friction has another shape, whose residuals remain coloured, or with a
lag. No record shows this error. It covers those of damping under LuGre's friction (8 of 16 intervals held), of K and B
on a table that swings, and of delay and damping behind a lag (docs/tables/identification.md)."""
SURE = 9.0  # ratio of a squared lag's square to its variance, from which a joint has a lag
WITHOUT_MOTOR = {"offset": "without a motor position the offset shifts the motor alone; measure the motor"}


def posterior(
    parts: Sequence[NormalEquations], spurious: Array, width: Array, fixed: Sequence[int] = ()
) -> tuple[Array, Array]:
    """Return the covariance (p, p) of z, and the standard deviations (p,) that the records alone give, inf: none.

    parts: normal equations of segments or blocks. width (p,): of the prior. spurious (p, p): information that the
    records do not give. fixed: entries of z that keep their prior; their uncertainty is that of the prior and acts on
    the others, and the records alone give inf for them.
    """
    H = np.asarray(sum(part.H for part in parts))
    free = [k for k in range(len(width)) if k not in fixed]
    chosen = H[np.ix_(free, free)]
    information = chosen + np.diag(width[free] ** -2.0)
    scale = np.sqrt(np.diag(information))
    inverse = np.linalg.inv(information / np.outer(scale, scale)) / np.outer(scale, scale)
    factor = inflation(np.array([part.g[free] for part in parts]), inverse)
    covariance = inverse * np.outer(factor, factor)
    by_prior = inverse @ H[np.ix_(free, list(fixed))] * width[list(fixed)]
    covariance = covariance + by_prior @ by_prior.T
    alone = np.full(len(width), np.inf)
    alone[free] = _standard_deviations(chosen - spurious[np.ix_(free, free)], width[free]) * factor
    whole = np.zeros_like(H)
    whole[np.ix_(free, free)] = covariance
    return whole, alone


def inflation(scores: Array, inverse: Array) -> Array:
    """Return by what factor (p,) standard deviations exceed those of white residuals, with Student's quantile.

    Errors of the model count as systematic, as above.

    scores (segments, p), inverse (p, p): of the information. The factor is at least that of the quantile.
    """
    count = len(scores)
    if not scores.size:
        return np.ones(scores.shape[1])
    scores = scores - scores.mean(axis=0)
    meat = scores.T @ scores
    for lag in range(1, min(LAGS, count - 1) + 1):
        product = scores[lag:].T @ scores[:-lag]
        meat = meat + (1 - lag / (LAGS + 1)) * (product + product.T)
    sandwich = np.diag(inverse @ meat @ inverse) * count / max(count - 1, 1)
    alone = np.mean((scores @ inverse) ** 2, axis=0) * count / np.diag(inverse)
    by_chance = 1 + TWO_SIDED * np.sqrt(2 / count)
    of_model = max(0.0, 1 - by_chance / max(by_chance, float(np.median(alone))))
    widened = np.maximum(sandwich / np.diag(inverse), 1.0)
    widened = np.maximum(widened, np.sqrt(widened * np.median(widened)))
    ratio = np.sqrt(widened * (1 + SYSTEMATIC * (count - 1) * of_model))
    quantile = (1 + CONFIDENCE) / 2
    return np.asarray(ratio * t.ppf(quantile, max(count - 1, 1)) / norm.ppf(quantile))


def _standard_deviations(H: Array, width: Array) -> Array:
    """Return the standard deviations that the information H gives, large but finite where it is not definite."""
    scale = np.sqrt(np.maximum(np.diag(H), width**-2.0))
    w, v = np.linalg.eigh(H / np.outer(scale, scale))
    least = 1e-12 * (1 + np.max(np.abs(w), initial=0.0))
    return np.asarray(np.sqrt((v**2) @ (1 / np.maximum(w, least))) / scale)


def spurious_information(best: PredictedSegments) -> Array:
    """Return CAUTION times the information (p, p) that is due to noise in initial states, and to their prior.

    Noise: growth of the information under disturbances of the initial states, which have their covariance and come with
    both signs, so that what is linear in them cancels. No segment loses more than it contains, before CAUTION. Prior
    and ridge: initial states follow z by -B dz, away from their prior: sum_s B' diag(1 / width^2 + ridge) B.
    """
    segments, size = best.x0.shape
    draws = max(1, LEAST_DRAWS // segments)
    normals = np.random.default_rng(0).standard_normal((segments, draws, size))
    by_noise = best.problem.of_each(lambda k: _growth(best, k, normals[k]))
    by_prior = []
    for compared, part in zip(best.compared, best.projected, strict=True):
        weight = best.problem.state_width**-2 + RIDGE * np.diag(compared.H)[:size]
        by_prior.append(part.B.T @ (weight[:, None] * part.B))
    return np.asarray(CAUTION * np.asarray(sum(by_noise)) + CAUTION * np.asarray(sum(by_prior)))


def _growth(best: PredictedSegments, k: int, normals: Array) -> Array:
    """Return the growth of the information of segment k by disturbances of its initial state, (draws, 4n) each."""
    x, information = best.x0[k], best.projected[k].H
    scale, (factor, lower) = best.compared[k].state_factor(0.0)
    growth = np.zeros_like(information)
    for normal in normals:
        dx = solve_triangular(factor, normal, trans=1 if lower else 0, lower=lower) / scale
        pair = [best.problem.compare(k, best.z, x + sign * dx, best.noise) for sign in (1, -1)]
        complete = [compared.projected.H for compared in pair if compared is not None]
        if len(complete) == len(pair):
            growth += (sum(complete) / 2 - information) / len(normals)
    contained, grown = np.maximum(np.diag(information), 0.0), np.diag(growth)
    limit = np.sqrt(np.where(grown > contained, contained / np.where(grown > 0, grown, 1.0), 1.0))
    return np.asarray(growth * np.outer(limit, limit))


def not_identifiable(
    parts: Sequence[NormalEquations], spurious: Array, width: Array, first: Sequence[int] = ()
) -> tuple[int, ...]:
    """Return the entries of z that the records do not determine: `first`, then one by one, the worst first.

    Each is held at its prior before the others are judged: of two parameters of which only the sum matters, one is
    not identifiable, and the other one is, as far as the prior of the first allows.
    """
    fixed = list(first)
    while len(fixed) < len(width):
        ratio = posterior(parts, spurious, width, fixed)[1] / width
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
    unexplained: Collection[int] = (),
) -> Estimates:
    """Return the estimates at z (p,) from normal equations of segments or blocks and their spurious information (p, p).

    fixed: entries that are not identifiable. doubt: why no parameter is better than weakly identified; "": none. step
    (p,): by which z is away from the minimum, if it was not reached; it counts as an error. other_shape: joints whose
    friction has another shape than the model's; unexplained: those of which the model lacks something else.
    """
    coordinates, width, joints = setup.coordinates, setup.coordinates.width, setup.records[0].joints
    (covariance, from_records), (of_all, _) = (posterior(parts, spurious, width, held) for held in (fixed, ()))
    partners = _partners(setup, of_all)
    away = np.zeros(len(z)) if step is None else np.minimum(np.abs(step), width)
    shaped = np.array([name not in OF_LINKS and j in other_shape for name, j in coordinates.free])
    lagging = [j for k, (name, j) in enumerate(coordinates.free) if name == LAG and z[k] ** 2 > SURE * covariance[k, k]]
    other = np.array([name not in OF_LINKS and j in {*unexplained, *lagging} for name, j in coordinates.free])
    wider = np.where(shaped | other, WIDER, 1.0)
    covariance = covariance * np.outer(wider, wider) + np.diag(away**2)
    sd = np.where(np.isfinite(from_records), np.sqrt(np.diag(covariance)), width)
    mean = z.copy()
    mean[list(fixed)] = coordinates.mean[list(fixed)]
    estimates = []
    for k, (name, j) in enumerate(coordinates.free):
        prior = float(setup.prior[name][j])
        ends = mean[k] + 1.96 * sd[k] * np.array([0.0, -1.0, 1.0])
        value, low, high = natural(ends, KINDS[name].coordinate).tolist()
        why = "; ".join(filter(None, (doubt, OTHER_SHAPE if shaped[k] and name in SHAPED else "")))
        if k in fixed:
            verdict, value, why = UNKNOWN, prior, ""
        else:
            size = 1.0 if KINDS[name].coordinate == LOG else max(abs(mean[k]), SHARP * width[k])
            verdict = IDENTIFIED if sd[k] <= SHARP * size and not why else WEAK
        why = why or reason(name, verdict, setup.records, -1 if name in PAYLOAD else j, partners.get(k, ""))
        joint = "" if name in PAYLOAD else joints[j]
        unit, why = (setup.robot.units[j].of(text) for text in (KINDS[name].unit, why))
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
    link, motor = (any(r.measured(q)[j] for r in records) for q in ("q_l", "q_m"))
    moved = max(float(np.ptp((r.q_m if r.measured("q_m")[j] else r.q_l)[:, j])) for r in records)
    if moved < STILL and name not in ("offset", "joint_stiffness"):
        return f"the joint stands still (it moves {moved:.2g} rad); move it"
    shared = f"nearly the effect of {partner}; " if partner else ""
    without = WITHOUT_LINK if not link else {} if motor else WITHOUT_MOTOR
    return shared + without.get(name, KINDS[name].revealed_by)
