# SPDX-License-Identifier: Apache-2.0
"""What is wrong with the model of a joint: its spring, its gear, or the links of the robot file.

The equations along a filtered motion (`filtered_fit`) are fitted again, each time with one more term:

    zeta = q_m - q_l - offset = tau / K + c zeta^3          a spring that stiffens (c < 0) or softens
    zeta                      = tau / K + b sign(tau) / 2   backlash: a dead zone of width b
    zeta                      = tau / K - c w               hysteresis: w follows zeta, but slips at +-s (J. C. Maxwell)
    zeta                      = tau / K + a sin(n q_m + f)  kinematic error of the gear, n times in a turn
    u                         = tau + B a_m + ... + c rigid links that are 1 + c times as heavy as in the robot file
    both                      = ... + sum_k a_k sin k q + b_k cos k q, k = 1, 2     the torque of a cable; if zeta alone
                                                             has it, an eccentric encoder

A term counts if it explains much of what the equation leaves, and stands out against its deviation over blocks of the
record, whose scores are nearly independent. Friction of other shapes leaves errors, too, but not ones that follow the
torque or the deflection.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import t as student

from fjr_core.model import springs
from fjr_core.numerics.checks import Array
from fjr_design.uncertainty.posterior import IDENTIFIED, UNKNOWN, WEAK, Estimate

from .elastic_arm import position_terms
from .estimation_problem import Estimation
from .filtered_fit import BLOCK, FEWEST_BLOCKS, FilteredEquations, Side
from .motion_record import decimated, inner, shifted
from .parameters import HARDENING, LOAD, RATIO
from .verdicts import CONFIDENCE, Estimates

SHARE = 0.3  # of the squares that the equation leaves, which a term explains
APART = 0.1  # between the shares of a dead zone and a cubic term of which the larger one is the cause
UNLIKE = 0.25  # relative difference of the compliances of records that is named
SURE = 5.0  # standard deviations of its coefficient
FLAT, BLUNT = 0.1, 0.5  # of the root mean square torque; a dead zone is passed within the first one
SLIPS = np.array([0.03, 0.06, 0.12, 0.25, 0.5])  # of the root mean square deflection
WIDE = 40.0  # Hz; band in which a kinematic error is sought
PERIODS = np.arange(40.0, 401.0, 2.0)  # of a kinematic error in a turn of the joint, behind gears of 20 to 200
LEAST = 0.01  # of the root mean square deflection; smaller loops and dead zones are no cause
LEAST_ECCENTRIC = 0.0025  # the same of the sine of an eccentric encoder; the filter leaves 2e-3 of a large motion
EXTENT = (0.01, 0.99)  # quantiles of deflections between which a stiffness is seen
USUAL = 0.95  # quantile of deflections up to which a spring is seen
LEAST_SHARE = 2e-3  # of the load by which friction grows; less does not count
LIGHT, MOST = 0.05, 4.0  # least error of the links that is named, and largest factor; others are no cause
CURVED = 0.1  # least relative change of a stiffness that is named
OUTLYING = 4.0  # median errors, beyond which they are cut where a kinematic error is sought: friction at reversals
FAINT, SURER = 0.1, 8.0  # as SHARE and SURE, of a kinematic error, whose band has more noise
SLOW, MOSTLY = 0.1, 0.4  # of the RMS velocity, and share of a wave above it; below, friction leaves what resembles one

Parameter = tuple[str, int]  # name and index


@dataclass(frozen=True, eq=False)
class Rows:
    """Independent samples of an equation: errors (k,), columns (k, m) that are fitted anyway, and the block of each."""

    errors: Array
    columns: Array
    block: Array

    def term(self, added: Array) -> Term:
        """Return what more columns (k, c) explain; by deviations of their coefficients over blocks."""
        X = self.columns / np.maximum(np.linalg.norm(self.columns, axis=0), 1e-300)
        u, s, _ = np.linalg.svd(X, full_matrices=False)
        Q = u[:, s > 1e-8 * np.max(s, initial=0.0)]
        straight, T = (values - Q @ (Q.T @ values) for values in (self.errors, added))
        c = np.linalg.lstsq(T, straight, rcond=1e-10)[0]
        left = straight - T @ c
        scores = np.array([T[self.block == b].T @ left[self.block == b] for b in np.unique(self.block)])
        inverse = np.linalg.pinv(T.T @ T)
        covariance = inverse @ scores.T @ scores @ inverse
        wald = float(c @ np.linalg.pinv(covariance) @ c) / len(c)
        share = 1 - float(left @ left) / max(float(straight @ straight), 1e-300)
        changes = np.linalg.lstsq(self.columns, self.errors - added @ c, rcond=1e-10)[0]
        size = float(np.sqrt(np.mean((T @ c) ** 2)))
        return Term(share, float(np.sqrt(max(wald, 0.0))), c, float(np.sum(changes[:1])), size)


@dataclass(frozen=True, eq=False)
class Term:
    """A term of an equation. share: of the squares that it explains. ratio: coefficients by their deviations.

    log_stiffness: by how much log K changes with it, if the first column is that of K. size: root mean square.
    """

    share: float
    ratio: float
    c: Array
    log_stiffness: float
    size: float

    def is_cause(self, share: float = SHARE, ratio: float = SURE) -> bool:
        """Return whether the term is a cause."""
        return self.share >= share and self.ratio >= ratio


@dataclass(frozen=True)
class Seen:
    """What records show of a joint: what its model lacks, "": nothing; and what its stiffness exceeds, 0: no bound.

    A stiff joint deflects less than the noise: the interval of its compliance c contains 0, and K >= 1 / (c + t s), s:
    deviation of c, t: one-sided quantile of Student.
    """

    wrong: str = ""
    at_least: float = 0.0


def seen(setup: Estimation, z: Array) -> dict[str, Seen]:
    """Return what the records show of each joint whose both sides are measured, at a fit z (p,) to filtered motions."""
    equations, joints = FilteredEquations(setup, z), {}
    for j, joint in enumerate(setup.records[0].joints):
        sides = equations.links(j)
        if not sides:
            continue
        K = float(equations.p["joint_stiffness"][j])
        wrong = _of_links(equations, j) or _of_spring(equations, sides, j) or _of_records(setup, sides, j, K)
        wrong = wrong or _of_position(equations, sides, j)
        c, deviation, blocks = _compliance(setup, sides, j)
        reach = float(student.ppf(CONFIDENCE, blocks - 1)) * deviation
        joints[joint] = Seen(setup.robot.units[j].of(wrong), K / (c + reach) if abs(c) < reach else 0.0)
    return joints


def deflections(setup: Estimation, z: Array, j: int) -> list[float]:
    """Return the ends of the deflections [rad] of joint j, of 98 % of the samples, at z (p,)."""
    p, records = setup.coordinates.parameters(z), [record for record in setup.records if record.both_sides(j)]
    late = [shifted(record.q_l[:, j], record.dt, p["link_skew"][j]) for record in records]
    gear = 1 + p[RATIO][j]
    zeta = [record.q_m[:, j] / gear - q - p["offset"][j] for record, q in zip(records, late, strict=True)]
    return [float(end) for end in np.nanquantile(np.concatenate(zeta), EXTENT)]


def rubs_with_load(setup: Estimation, z: Array) -> bool:
    """Return whether the friction of some joint grows with the torque of its spring, at a fit z (p,) without that."""
    equations = FilteredEquations(setup, z)
    for j in range(setup.robot.n):
        sides = equations.motors(j)
        term = _of_terms(setup, sides, [side.columns[(LOAD[1], j)][:, None] for side in sides])
        if term.is_cause() and term.c[0] > LEAST_SHARE:
            return True
    return False


def _of_terms(setup: Estimation, sides: Sequence[Side], terms: Sequence[Array]) -> Term:
    """Return what more terms (k, c) explain of the equations of one side of a joint, some in each record."""
    pairs = zip(sides, terms, strict=True)
    added = np.concatenate([decimated(term * side.used[:, None], side.stride) for side, term in pairs])
    return _rows(sides, _columns(setup, sides)).term(added)


def _of_position(equations: FilteredEquations, links: Sequence[Side], j: int) -> str:
    """Return a sentence if the equation of the spring of joint j depends on its position, and so does its effort."""
    setup, motors = equations.setup, equations.motors(j)
    terms = [np.column_stack(position_terms(inner(m.q_m[:, j], m.dt), np)) for m in setup.motions]
    on_link, on_motor = (_of_terms(setup, sides, [terms[side.record] for side in sides]) for sides in (links, motors))
    if not on_link.is_cause() or on_link.size < LEAST_ECCENTRIC * links[0].measured:
        return ""
    if on_motor.is_cause() and on_motor.size > LEAST * motors[0].measured:
        return "a torque that depends on the position is missing, such as that of a cable or a counterbalance"
    return "q_m - q_l depends on the position: an encoder is eccentric"


def _of_links(equations: FilteredEquations, j: int) -> str:
    """Return a sentence if the effort of joint j needs other links than those of the robot file."""
    sides = equations.motors(j)
    loads = [inner(equations.rigid[side.record][0][:, [j]], side.dt) for side in sides]
    term = _of_terms(equations.setup, sides, loads)
    factor = 1 + float(term.c[0])
    if not term.is_cause() or abs(factor - 1) < LIGHT or not 1 / MOST < factor < MOST:
        return ""
    return f"the links of the robot file do not fit: a factor of {factor:.2f} on their inertia and weight explains it"


def _of_spring(equations: FilteredEquations, sides: Sequence[Side], j: int) -> str:
    """Return a sentence if the deflection of joint j is no straight line of its torque."""
    K, cubic = (float(equations.p[name][j]) for name in ("joint_stiffness", HARDENING))
    torques = [side.torque for side in sides]
    usual = float(np.sqrt(np.mean(np.concatenate(torques) ** 2))) / K
    if not usual:
        return ""
    first = [("joint_stiffness", j), ("offset", j)]
    columns = [*first, *_columns(equations.setup, sides, first)]
    rows = _rows(sides, columns)
    pairs = list(zip(torques, sides, strict=True))
    slow = np.concatenate([decimated(torque / K, side.stride) for torque, side in pairs])
    zeta = [decimated(side.errors + springs.root(K, cubic, torque, np), side.stride) for torque, side in pairs]
    deflection = np.concatenate(zeta)
    slipping = np.concatenate([slipping_elements(each, usual * SLIPS) for each in zeta])
    loops = [rows.term(-slipping[:, [i]]) for i in range(len(SLIPS))]
    slip = int(np.argmax([term.share * (term.c[0] > 0) for term in loops]))
    dead, blunt = (rows.term(np.tanh(slow / usual / flat)[:, None]) for flat in (FLAT, BLUNT))
    curved = rows.term(deflection[:, None] ** 3)
    width = 2 * loops[slip].c[0] * usual * SLIPS[slip]
    if loops[slip].is_cause() and width > LEAST * usual and loops[slip].share > max(dead.share, curved.share):
        return f"hysteresis, loop of about {1e3 * width:.2g} mrad: the deflection depends on the direction, too"
    stiffens = curved.c[0] < 0 and curved.is_cause()
    sharp = dead.is_cause() and 2 * dead.c[0] > LEAST * usual and dead.share > blunt.share - APART / 2
    if sharp and dead.share > curved.share - APART * stiffens:
        if stiffens and curved.share > dead.share - APART:
            return "the spring is not linear: it is softer at small deflections, by backlash or because it stiffens"
        return f"backlash of about {2e3 * dead.c[0]:.2g} mrad: the deflection jumps where the torque changes sign"
    return _curved(rows, deflection, curved, K) or _of_gear(equations.setup, sides, columns, j)


def _curved(rows: Rows, zeta: Array, cubic: Term, K: float) -> str:
    """Return a sentence if a cubic term of the deflection zeta (k,) counts, about its own offset if need be."""
    if not cubic.is_cause():
        both = rows.term(np.column_stack([zeta**3, zeta**2])).c  # c (zeta + d)^3, d: error of the offset
        extent = float(np.quantile(np.abs(zeta), USUAL))
        zeta = zeta + np.clip(both[1] / (3 * both[0]), -extent, extent)
        cubic = rows.term(zeta[:, None] ** 3)
    K = K * float(np.exp(cubic.log_stiffness))
    ends = [float(np.sqrt(np.mean(zeta**2))) / 2, float(np.quantile(np.abs(zeta), USUAL))]
    near, far = (K * (1 - float(cubic.c[0]) * end**2) for end in ends)
    if not cubic.is_cause() or min(near, far) <= 0 or abs(far / near - 1) < CURVED:
        return ""
    seen = [f"{secant:.4g} N m/rad at {1e3 * end:.2g} mrad" for secant, end in zip((near, far), ends, strict=True)]
    return f"the spring is not linear: {seen[0]}, {seen[1]}"


def _of_gear(setup: Estimation, sides: Sequence[Side], columns: Sequence[Parameter], j: int) -> str:
    """Return a sentence if the deflection has a part that is periodic in the motor's position."""
    sides = [replace(side, stride=max(1, int(0.4 / (WIDE * side.dt)))) for side in sides]
    rows, pairs = _rows(sides, columns), [(setup.motions[side.record], side) for side in sides]
    q, v = (
        np.concatenate([decimated(inner(getattr(m, name)[:, j], m.dt), side.stride) for m, side in pairs])
        for name in ("q_m", "v_m")
    )
    passed = PERIODS[:, None] * np.abs(v) < np.pi * WIDE
    waves = np.stack([np.sin(PERIODS[:, None] * q), np.cos(PERIODS[:, None] * q)], axis=-1) * passed[..., None]
    X = rows.columns / np.maximum(np.linalg.norm(rows.columns, axis=0), 1e-300)
    Q, _ = np.linalg.qr(X)
    errors = rows.errors - Q @ (Q.T @ rows.errors)
    errors = np.clip(errors, *(np.median(np.abs(errors)) * np.array([-OUTLYING, OUTLYING])))
    rows = replace(rows, errors=errors)
    powers = np.sum(np.einsum("pkc,k->pc", waves, errors) ** 2, axis=1) / np.maximum(passed.sum(axis=1), len(q) / 20)
    best = int(np.argmax(powers))
    term, turning = rows.term(waves[best]), np.abs(v) > SLOW * np.sqrt(np.mean(v**2))
    if not term.is_cause(FAINT, SURER) or rows.term(waves[best] * turning[:, None]).share < MOSTLY * term.share:
        return ""
    size, turns = float(np.hypot(*term.c)), PERIODS[best]
    return f"kinematic error of about {1e3 * size:.2g} mrad, {turns:.0f} times in a turn of the joint"


def _of_records(setup: Estimation, sides: Sequence[Side], j: int, K: float) -> str:
    """Return a sentence if records give the spring of joint j different compliances."""
    found = [(*_compliance(setup, [side], j)[:2], setup.records[side.record].name) for side in sides]
    (low, s_low, soft), (high, s_high, stiff) = max(found), min(found)
    if low - high < SURE * np.hypot(s_low, s_high) or low - high < UNLIKE * low:
        return ""
    of_stiff = f"{K / high:.3g} N m/rad" if high > 0 else "no spring"
    return f"the records do not agree: {K / low:.3g} N m/rad from {soft}, {of_stiff} from {stiff}"


def _compliance(setup: Estimation, sides: Sequence[Side], j: int) -> tuple[float, float, int]:
    """Return 1/K of joint j, relative to that of the equations, its deviation over their blocks, and their number."""
    stiffness = ("joint_stiffness", j)
    rows = _rows(sides, _columns(setup, sides, [stiffness]))
    column = np.concatenate([decimated(side.columns[stiffness], side.stride) for side in sides])
    term = rows.term(column[:, None])
    return 1 - float(term.c[0]), abs(float(term.c[0])) / max(term.ratio, 1e-300), len(np.unique(rows.block))


def _columns(setup: Estimation, sides: Sequence[Side], without: Sequence[Parameter] = ()) -> list[Parameter]:
    """Return the free parameters of an equation but some."""
    return [key for key in sides[0].columns if key in setup.coordinates.free and key not in without]


def _rows(sides: Sequence[Side], columns: Sequence[Parameter]) -> Rows:
    """Return the independent samples of an equation in all records, with the columns of some parameters."""
    tables: list[Array] = []
    block: list[Any] = []
    for side in sides:
        table = np.column_stack([*(side.columns[key] for key in columns), side.errors]) * side.used[:, None]
        tables.append(decimated(table, side.stride))
        count = max(FEWEST_BLOCKS, round(side.dt * len(table) / BLOCK))
        past = len(np.unique(np.concatenate(block))) if block else 0
        block.append(past + np.arange(len(tables[-1])) * count // len(tables[-1]))
    rows = np.vstack(tables)
    return Rows(rows[:, -1], rows[:, :-1], np.concatenate(block))


def slipping_elements(zeta: Array, slips: Array) -> Array:
    """Return elements (k, m) that follow a deflection (k,) but slip at +-slips (m,)."""
    w, out = np.zeros(len(slips)), np.empty((len(zeta), len(slips)))
    for k, change in enumerate(np.diff(zeta, prepend=zeta[0])):
        w = np.clip(w + change, -slips, slips)
        out[k] = w
    return out


def withheld(setup: Estimation, estimates: Estimates, joints: Mapping[str, Seen]) -> Estimates:
    """Return the estimates with what was seen of their joints: what is wrong withholds "identified", and is the reason.

    A stiffness comes with its deflections, one that is not identifiable with its bound, if there is one.
    """
    names = setup.records[0].joints

    def checked(estimate: Estimate) -> Estimate:
        found, is_stiffness = joints.get(estimate.joint, Seen()), estimate.name == "joint_stiffness"
        if found.wrong and (estimate.verdict == IDENTIFIED or is_stiffness):
            verdict = WEAK if estimate.verdict == IDENTIFIED else estimate.verdict
            reason = "; ".join(filter(None, (found.wrong, estimate.reason)))
            estimate = replace(estimate, verdict=verdict, reason=reason)
        bound = found.at_least if estimate.verdict == UNKNOWN else 0.0
        if not is_stiffness or estimate.joint not in joints or (estimate.verdict == UNKNOWN and not bound):
            return estimate
        ends = deflections(setup, estimates.mean, names.index(estimate.joint))
        return replace(estimate, deflections=ends, at_least=bound)

    return replace(estimates, estimates=tuple(map(checked, estimates.estimates)))
