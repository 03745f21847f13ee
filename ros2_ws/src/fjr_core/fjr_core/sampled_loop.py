# SPDX-License-Identifier: Apache-2.0
"""The loop as it is run: u(x, x, t) sampled, held and delayed; linearised at rest, judged by its spectral radius.

The proof of the law is in continuous time. A hold and a delay are what it does not cover, and what this does:
locally, about rest at sampled configurations. The speed of motion is left out: it adds Coriolis terms of the size
of dq_l, small beside K_d / M and the elastic modes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from .checks import Array
from .errors import StateError
from .linear_loop import SampledLoop, closed_form, linearize, looked_at
from .plant import Plant
from .rest import Indices
from .static_law import StaticLaw
from .vdpbc.law import TrackingLaw

FEW = 48  # configurations of which all are looked at closely
KEPT = 16  # configurations of the largest radius at each screened delay: there margins are searched for
LONGEST_DELAY = 20.0  # samples; no margin above is reported
WITHIN = 0.02  # samples within the delay margin, and part above the lowest rate, where all are looked at again
MOST_STATES = 64  # of plant and waiting efforts: the longest delay at which all are looked at
ROUNDS = 8  # of looks at all
HIGHEST_RATE = 1e5  # Hz; no rate above is looked at
LOWEST_RATE = 1.0  # Hz
MOST_SAMPLES_OF_DELAY = 10  # a rate that makes more of them of the given delay is not looked at either


@dataclass(frozen=True, eq=False)
class SampledCheck:
    """What is known of a sampled loop before it runs.

    stable: spectral_radius < 1 at every looked-at configuration. spectral_radius: the worst, at the
    configuration (n,) [rad]. delay_margin [samples]: the largest total delay up to which all delays are stable,
    from the given one on (from zero on when the given one is unstable; 0 when none is); at most LONGEST_DELAY.
    lowest_stable_rate [Hz]: the lowest rate down to which all rates are stable, from the given one on; when the
    given one is unstable, the rate above it from which on all are, up to HIGHEST_RATE; None: there is no such rate.
    The delay [s] stays the same at other rates. configurations: how many were looked at.
    """

    stable: bool
    spectral_radius: float
    configuration: Array
    delay_margin: float
    lowest_stable_rate: float | None
    sample_period: float
    delay: float
    configurations: int


def spectral_radius(
    law: StaticLaw,
    sample_period: float,
    delay: float = 0.0,
    configurations: ArrayLike | None = None,
    plant: Plant | None = None,
) -> Array:
    """Spectral radii (k,) of the sampled loop at configurations (k, n); below 1 is stable. See SampledLoop.radii."""
    checked_times(sample_period, delay)
    return linearize(law, configurations, plant).radii(sample_period, delay)


def check(
    law: StaticLaw,
    sample_period: float,
    delay: float = 0.0,
    configurations: ArrayLike | None = None,
    plant: Plant | None = None,
) -> SampledCheck:
    """Judge the law sampled every sample_period [s] with a loop delay [s]; see SampledCheck and this module.

    configurations (k, n) [rad]: 1024 sampled ones when none are given (64 for another law than v-dPBC, which has no
    closed form here). Of more than 48 the closed form picks the
    worst, margins are searched for on these, and all are looked at again just within the margins (for delays that
    make at most MOST_STATES states). plant: what the law really drives, when its robot differs.
    Raises StateError for times that are not positive (delay: negative) or shapes that do not fit.
    """
    checked_times(sample_period, delay)
    q_l, plant = looked_at(law, configurations), plant or Plant(law.robot)
    if not isinstance(law, TrackingLaw) or len(q_l) <= FEW or plant.robot.n != law.robot.n:
        return _judged(linearize(law, q_l, plant), sample_period, delay)
    everywhere = closed_form(law, q_l, plant)
    few = everywhere.critical(sample_period, delay, KEPT)
    for _ in range(ROUNDS):
        found = _judged(linearize(law, q_l[few], plant), sample_period, delay)
        missed = np.setdiff1d(_unstable(everywhere, found), few)
        if not len(missed):
            break
        few = np.append(few, missed)
    return replace(found, configurations=len(q_l))


def _judged(loop: SampledLoop, sample_period: float, delay: float) -> SampledCheck:
    radii = loop.radii(sample_period, delay)
    worst = int(np.argmax(radii))
    stable = bool(radii[worst] < 1)
    return SampledCheck(
        stable=stable,
        spectral_radius=float(radii[worst]),
        configuration=loop.configurations[worst],
        delay_margin=_delay_margin(loop, sample_period, delay, stable),
        lowest_stable_rate=_lowest_stable_rate(loop, 1 / sample_period, delay, stable),
        sample_period=sample_period,
        delay=delay,
        configurations=len(loop.configurations),
    )


def _unstable(everywhere: SampledLoop, found: SampledCheck) -> Indices:
    """The worst of those that are unstable just within the margins that were found."""
    T, (_, n, states) = found.sample_period, everywhere.F.shape
    late = min(found.delay_margin - WITHIN, (MOST_STATES - states) // n)
    loops = [(T, late * T)] if late > 0 else []
    if found.lowest_stable_rate is not None:
        loops.append((1 / (found.lowest_stable_rate * (1 + WITHIN)), found.delay))
    worst = [_largest(everywhere.radii(*times)) for times in loops]
    return np.unique(np.concatenate([np.arange(0), *worst]))


def _largest(radii: Array) -> Indices:
    """Indices of the largest that are not below 1."""
    worst = np.argsort(-radii, kind="stable")[:KEPT]
    return worst[radii[worst] >= 1]


def _delay_margin(loop: SampledLoop, T: float, delay: float, stable: bool) -> float:
    """[samples], to 0.01; scanned from the given delay on, or from zero."""
    start = delay / T if stable else 0.0
    delays = np.append(np.arange(start, LONGEST_DELAY, 0.25), max(start, LONGEST_DELAY))
    margin = _last_stable(lambda samples: bool(loop.radii(T, samples * T).max() < 1), delays, tolerance=0.01)
    return 0.0 if margin is None else margin


def _lowest_stable_rate(loop: SampledLoop, rate: float, delay: float, stable: bool) -> float | None:
    """[Hz], to 0.2 %; scanned downwards in steps of 3 % from the given rate, or of 10 % from the highest."""
    highest = max(rate, min(HIGHEST_RATE, MOST_SAMPLES_OF_DELAY / delay) if delay else HIGHEST_RATE)
    start, end, step = (rate, LOWEST_RATE, 1.03) if stable else (highest, rate, 1.1)
    logarithms = np.append(np.arange(np.log(start), np.log(end), -np.log(step)), np.log(min(start, end)))
    lowest = _last_stable(lambda log: bool(loop.radii(float(np.exp(-log)), delay).max() < 1), logarithms, 0.002)
    return None if lowest is None else float(np.exp(lowest))


def _last_stable(stable: Callable[[float], bool], points: Array, tolerance: float) -> float | None:
    """The end of the stable stretch that begins at points[0], found among the points, then by bisection."""
    good = None
    for point in points:
        if not stable(point):
            return None if good is None else _bisect(stable, good, float(point), tolerance)
        good = float(point)
    return good


def _bisect(stable: Callable[[float], bool], good: float, bad: float, tolerance: float) -> float:
    while abs(bad - good) > tolerance:
        middle = (good + bad) / 2
        good, bad = (middle, bad) if stable(middle) else (good, middle)
    return good


def checked_times(sample_period: float, delay: float) -> None:
    """Raise StateError unless the sample period [s] is positive and the delay [s] is not negative."""
    if not (np.isfinite(sample_period) and sample_period > 0):
        raise StateError(f"sample_period is {sample_period} s; expected a positive finite number")
    if not (np.isfinite(delay) and delay >= 0):
        raise StateError(f"delay is {delay} s; expected 0 or more")
