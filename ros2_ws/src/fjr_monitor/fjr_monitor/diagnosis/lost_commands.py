# SPDX-License-Identifier: Apache-2.0
"""Find the commands that never acted, by the likelihood of the motion under the noise of the velocities.

A driver that hears nothing holds the effort h that acted before. Over an interval dt command u then leaves the momentum

    e dt = (h - u) dt      if it is lost
    e dt = f (h - u) dt    if it acts from a share f of the interval on

unexplained. The noise of the velocities telescopes in the sum of e dt: a lost command is a step of known size, the same
instant at all joints, that stays. The Viterbi algorithm finds the most likely sequence of lost commands. Each of its
paths follows the sum with a level and a rate (alpha-beta filter), so that a torque that the model lacks is no loss.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fjr_core.numerics.checks import Array

from .thresholds import BLOCK

LONGEST = 40
"""Most commands in a row that are found lost."""
BEFORE, AFTER = 32, 20
"""Intervals before and after each block that are decoded with it."""
BEGIN, STAY, FIRST = 12.0, 0.7, 4.0
"""Minus the logarithm of the probability that a command is lost: after one that acted, after a lost one, the first."""
ALPHA, BETA = 0.2, 0.02
"""Gains of level and rate of the sum of e."""
OUTLIER = 50.0
"""Squared innovation of all joints, relative to the variance, above which it is no further evidence."""
ROUNDING, INEXACT = 1e-4, 0.01
"""Error of e relative to the usual command, and of a deviation relative to itself, due to the discretisation."""
TINY = 1e-300
LEFT = 3.0
"""Largest mean squared innovation, relative to the variance, of intervals that lost commands explain."""
STEP, SEEN = 8, 4.0
"""Intervals over which a step of the sum of e is looked for, and its least size in standard deviations."""


def noise_of(u: Array, e: Array) -> Array:
    """Estimate the standard deviation (n,) of the white noise on the sum of e (k, n), whatever few intervals do."""
    differences, usual = (np.median(np.abs(each), axis=0) for each in (np.diff(e, axis=0), u))
    return np.asarray(1.4826 * differences / np.sqrt(6) + ROUNDING * usual)  # 1 -2 1 of the sum


def lost_commands(
    u: Array, e: Array, late: Array, sigma: tuple[Array, Array], begin: int = 0
) -> tuple[NDArray[np.bool_], Array]:
    """Return which commands (k,) were lost, and the effort (k, n) [N m] that acted before each interval.

    u (k, n) [N m]: commands. e (k, n) [N m]: effort that the motion requires minus u. late (k,): share of each interval
    in which the effort before still acts. sigma: standard deviations (n,) of the sum of e, and (k,) of the share.
    begin: interval with which a block begins, so that blocks are decoded alike in any part of a record.
    """
    older = np.vstack([u[:1], u[:-1]])
    variance = sigma[0] ** 2 + (sigma[1][:, None] * (older - u)) ** 2 + TINY
    rest, size = e - late[:, None] * (older - u), BEFORE + BLOCK + AFTER
    rows = np.arange(max(begin - BLOCK, begin % BLOCK), len(u), BLOCK)[:, None] + np.arange(size) - BEFORE
    there = (rows >= 0) & (rows < len(u))
    rows = np.clip(rows, 0, len(u) - 1)
    stepped = np.append(np.zeros(1, dtype=np.intp), np.cumsum(_steps(rest, variance)))
    some = stepped[rows[:, -1] + 1] > stepped[rows[:, 0]]
    held, before = np.zeros(len(u), dtype=bool), older
    if some.any():
        slow = np.nanmedian(np.where(there[some][:, :, None], rest[rows[some]], np.nan), axis=1)
        rates = np.concatenate([np.full_like(slow, np.nan), slow])  # a segment may begin among lost commands
        twice = np.tile(rows[some], (2, 1)), np.tile(there[some], (2, 1))
        decoded = _most_likely(u, e, late, variance, twice, rates)
        ages, left, cost = (np.stack(np.split(each, 2)) for each in decoded)
        ages, left = (each[np.argmin(cost, axis=0), np.arange(len(slow))] for each in (ages, left))
        good, kept = left < LEFT * u.shape[1] * there[some].sum(axis=1), slice(BEFORE, BEFORE + BLOCK)
        ages, some[some] = ages[good], good
        here = there[some, kept]
        at = rows[some, kept][here]
        held[at] = ages[:, 1:][:, kept][here] > 0
        before = older.copy()
        before[at] = u[np.maximum(at - 1 - ages[:, :-1][:, kept][here], 0)]
    return held, before


def _steps(e: Array, variance: Array) -> NDArray[np.bool_]:
    """Return in which intervals (k,) the sum of e has a step beside a slope that noise does not explain."""
    found = np.zeros(len(e), dtype=bool)
    if len(e) > 2 * STEP:
        sums = np.cumsum(e, axis=0)
        steps = sums[2 * STEP :] - 2 * sums[STEP:-STEP] + sums[: -2 * STEP]
        white = variance[2 * STEP :] + 4 * variance[STEP:-STEP] + variance[: -2 * STEP]
        found[STEP:-STEP] = (steps**2 > SEEN**2 * white).any(axis=1)
    return found


def _most_likely(
    u: Array,
    e: Array,
    late: Array,
    variance: Array,
    segments: tuple[NDArray[np.intp], NDArray[np.bool_]],
    rates: Array,
) -> tuple[NDArray[np.intp], Array, Array]:
    """Return how many commands in a row were lost before the first and at each interval of segments, as (s, m + 1).

    Return, too, the sum of squared innovations (s,) relative to their variance, and the cost (s,). segments (s, m):
    intervals, and whether they exist. rates (s, n) [N m]: at the start, NaN: of the first intervals.
    """
    rows, there = segments
    (count, length), n, ages = rows.shape, u.shape[1], np.arange(LONGEST + 1)  # a path is lost `ages` times in a row
    came, all_of = np.zeros((count, length, len(ages)), np.int8), np.arange(count)
    left = np.zeros((count, len(ages)))
    cost = left + np.where(ages, FIRST, 0.0)
    unknown = np.isnan(rates[:, None])
    level = np.zeros((count, len(ages), n))
    rate = level + np.where(unknown, 0.0, rates[:, None])
    total, seen = np.zeros((count, 1, n)), np.zeros((count, 1, 1))
    for i, (now, real) in enumerate(zip(rows.T, there.T[:, :, None, None], strict=True)):
        total, seen = total + real * e[now, None], seen + real
        line = seen * seen + seen + (seen < 1)  # at first the least squares of a line, or a mean
        alpha = np.maximum(ALPHA, np.where(unknown, (4 * seen - 2) / line, 1 / np.maximum(seen, 1)))
        beta = np.maximum(BETA, np.where(unknown, 6 / line, 0.0)) * real
        held = u[np.maximum(now[:, None] - 1 - ages, 0)] - u[now, None]
        paths = []
        for deviation, chance in (
            (late[now, None, None] * held, np.where(ages, STAY, 0.0)),
            (held, np.where(ages, STAY, BEGIN)),
        ):
            ahead = level + real * (rate + deviation)
            off = total - ahead
            square = (real * (1 - alpha) * off**2 / (variance[now, None] + (INEXACT * deviation) ** 2)).sum(axis=2)
            likely = cost + chance + np.minimum(square, OUTLIER) / 2
            paths.append((likely, left + square, ahead + alpha * off, rate + beta * off))
        acts, lost = paths
        best = np.argmin(acts[0], axis=1)
        came[:, i, 0], came[:, i, 1:] = best, ages[:-1]
        cost, left, level, rate = (
            np.concatenate([a[all_of, best][:, None], b[:, :-1]], axis=1) for a, b in zip(acts, lost, strict=True)
        )
    found = np.zeros((count, length + 1), np.intp)
    found[:, -1] = np.argmin(cost, axis=1)
    for i in reversed(range(length)):
        found[:, i] = came[all_of, i, found[:, i + 1]]
    return found, left[all_of, found[:, -1]], cost.min(axis=1)
