# SPDX-License-Identifier: Apache-2.0
"""Whether springs are straight lines: deflection against torque, and what is wrong where they are not.

The link side of the equations along a filtered motion (`filtered_fit`) is fitted again with one more term:

    zeta = q_m - q_l - offset = tau / K + c zeta^3          a spring that stiffens (c < 0) or softens
    zeta                      = tau / K + b sign(tau) / 2   backlash: a dead zone of width b

A term counts if it explains much of what the straight line leaves, and stands out against its deviation over blocks of
the record, whose scores are nearly independent. Friction of other shapes leaves errors, too, but not ones that follow
the torque: on tests/physics they explain at most a fifth.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from fjr_core.model import springs
from fjr_core.numerics.checks import Array
from fjr_design.uncertainty.posterior import IDENTIFIED, WEAK, Estimate

from .estimation_problem import Estimation
from .filtered_fit import BLOCK, FEWEST_BLOCKS, Side, link_side, rigid_along
from .filtered_motion import decimated
from .parameters import HARDENING
from .verdicts import Estimates

SHARE = 0.3  # of the squares that the straight line leaves, which a term explains
APART = 0.25  # between the shares of two terms of which the larger one is the cause
SURE = 5.0  # standard deviations of its coefficient
FLAT = 0.1  # of the root mean square torque; a dead zone is passed within it
CUBIC, DEAD = "cubic", "dead zone"


@dataclass(frozen=True)
class Term:
    """A term of the deflection. share: of the squares that it explains. ratio: coefficient by its deviation.

    size [rad]: coefficient, at the root mean square deflection. log_stiffness: by how much log K changes with it.
    """

    share: float
    ratio: float
    size: float
    log_stiffness: float


def not_linear(setup: Estimation, z: Array) -> dict[str, str]:
    """Return a sentence for each joint whose spring is not a straight line at z (p,), a fit to the filtered motions."""
    rigid = [rigid_along(setup, motion, z) for motion in setup.motions]
    p, sentences = setup.coordinates.parameters(z), {}
    for j, joint in enumerate(setup.records[0].joints):
        used = [k for k, record in enumerate(setup.records) if record.both_sides(j)]
        sides = [link_side(setup, setup.motions[k], rigid[k], z, j) for k in used]
        K, cubic = float(p["joint_stiffness"][j]), float(p[HARDENING][j])
        torques = [side.torque for side in sides]
        usual = float(np.sqrt(np.mean(np.concatenate(torques) ** 2))) if sides else 0.0
        if not usual:
            continue
        deflections = [
            side.errors + springs.root(K, cubic, torque, np) for side, torque in zip(sides, torques, strict=True)
        ]
        extent = np.abs(np.concatenate(deflections))
        shapes = {
            CUBIC: [(zeta * K / usual) ** 3 for zeta in deflections],
            DEAD: [np.tanh(t / usual / FLAT) for t in torques],
        }
        periods = [setup.motions[k].dt for k in used]
        terms = {name: _term(_blocks(setup, sides, periods, shape, j)) for name, shape in shapes.items()}
        sentence = _sentence(terms, K, usual / K, float(np.max(extent)))
        if sentence:
            sentences[joint] = sentence
    return sentences


def _blocks(setup: Estimation, sides: list[Side], periods: list[float], shape: list[Array], j: int) -> list[Array]:
    """Return the rows of blocks of the records: columns of stiffness and of other parameters, the term, the errors."""
    first = [("joint_stiffness", j), ("offset", j)]
    columns = [*first, *(key for key in sides[0].columns if key in setup.coordinates.free and key not in first)]
    blocks = []
    for side, dt, term in zip(sides, periods, shape, strict=True):
        rows = np.column_stack([*(side.columns[key] for key in columns), term, side.errors])
        count = max(FEWEST_BLOCKS, round(dt * len(rows) / BLOCK))
        blocks += np.array_split(decimated(rows, side.stride), count)
    return blocks


def _term(blocks: list[Array]) -> Term:
    """Return the term of the last but one column, from `_blocks`."""
    rows = np.vstack(blocks)
    scale = np.linalg.norm(rows[:, :-1], axis=0)
    scale[scale == 0] = 1.0
    X, errors = rows[:, :-1] / scale, rows[:, -1]
    fitted = np.linalg.lstsq(X, errors, rcond=1e-10)[0]
    left = errors - X @ fitted
    straight = errors - X[:, :-1] @ np.linalg.lstsq(X[:, :-1], errors, rcond=1e-10)[0]
    ends = np.cumsum([len(block) for block in blocks])[:-1]
    pairs = zip(np.split(X, ends), np.split(left, ends), strict=True)
    scores = np.array([of_block.T @ residual for of_block, residual in pairs])
    inverse = np.linalg.pinv(X.T @ X)
    deviation = float(np.sqrt((inverse @ scores.T @ scores @ inverse)[-1, -1]))
    share = 1 - float(left @ left) / max(float(straight @ straight), 1e-300)
    changes = fitted / scale
    return Term(share, float(fitted[-1]) / max(deviation, 1e-300), float(changes[-1]), float(changes[0]))


def _sentence(terms: dict[str, Term], K: float, usual: float, largest: float) -> str:
    """Return what is wrong with a spring, "" if nothing is. usual, largest [rad]: deflections."""
    other, name = sorted(terms, key=lambda each: terms[each].share)
    term = terms[name]
    if term.share < SHARE or abs(term.ratio) < SURE or (name == DEAD and term.size < 0):
        return ""
    if name == DEAD and terms[other].share > max(SHARE, term.share - APART) and terms[other].size < 0:
        return "the spring is not linear: it is softer at small deflections, by backlash or because it stiffens"
    if name == DEAD:
        return f"backlash of about {2e3 * term.size:.2g} mrad: the deflection jumps where the torque changes sign"
    K = K * float(np.exp(term.log_stiffness))
    secants = [(K * (1 - term.size * zeta**2 / usual**3), zeta) for zeta in (usual / 2, largest)]
    seen = [f"{secant:.4g} N m/rad at {1e3 * zeta:.2g} mrad" for secant, zeta in secants]
    return f"the spring is not linear: {seen[0]}, {seen[1]}"


def withheld(estimates: Estimates, wrong: Mapping[str, str]) -> Estimates:
    """Return the estimates without "identified" for joints with a sentence on what is wrong, which is the reason."""

    def checked(estimate: Estimate) -> Estimate:
        sentence = wrong.get(estimate.joint, "")
        if not sentence or not (estimate.verdict == IDENTIFIED or estimate.name == "joint_stiffness"):
            return estimate
        verdict = WEAK if estimate.verdict == IDENTIFIED else estimate.verdict
        return replace(estimate, verdict=verdict, reason="; ".join(filter(None, (sentence, estimate.reason))))

    return replace(estimates, estimates=tuple(map(checked, estimates.estimates)))
