# SPDX-License-Identifier: Apache-2.0
"""The loop as it is run, linearised at rest and judged by the spectral radius of its one-sample map.

The map holds everything that runs: the plant under held efforts, the law with its controller state (momentum residual,
integral, prediction), the velocity observer, the sensors, hold and delay.

The proof of the law is in continuous time. A hold and a delay are what it does not cover, and what this does:
locally, about rest at sampled configurations. The speed of motion is left out: it adds Coriolis terms of the size
of dq_l, small beside K_d / M and the elastic modes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ..control.sampled_law import SampledLaw
from ..control.static_law import StaticLaw
from ..control.vdpbc.law import TrackingLaw
from ..errors import StateError
from ..numerics.checks import Array
from ..robot.equilibrium import Indices
from ..robot.port_hamiltonian import Plant
from .linear_controller import Sensing
from .linearization import SampledLoop, as_static, closed_form, linearize, looked_at, without_state

FEW = 48  # configurations of which all are looked at closely
KEPT = 16  # configurations of the largest radius at each screened delay: there margins are searched for
LONGEST_DELAY = 20.0  # samples; no margin above is reported
WITHIN = 0.02  # samples within the delay margin, and part above the lowest rate, where all are looked at again
MOST_STATES = 64  # of plant and waiting efforts: the longest delay at which all are looked at
WITH_STATE = 8  # configurations, about, at which a controller with a state is looked at: the worst of the static loop
RATES_WITH_STATE = 3  # the first of these, at which its lowest stable rate is searched for
MOST_LATE = 5.0  # samples of delay at which the worst are picked
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
    The delay [s] and all parameters of the controller stay the same at other rates, robust.hold too. configurations:
    how many were looked at; closely (c, n) [rad]: those on which the margins were searched for.
    """

    stable: bool
    spectral_radius: float
    configuration: Array
    delay_margin: float
    lowest_stable_rate: float | None
    sample_period: float
    delay: float
    configurations: int
    closely: Array


def spectral_radius(
    law: StaticLaw | SampledLaw,
    sample_period: float,
    delay: float = 0.0,
    configurations: ArrayLike | None = None,
    plant: Plant | None = None,
    sensing: Sensing | None = None,
) -> Array:
    """Spectral radii (k,) of the sampled loop at configurations (k, n); below 1 is stable. See SampledLoop.radii."""
    checked_times(sample_period, delay)
    return linearize(law, configurations, plant, sensing).radii(sample_period, delay)


def check(
    law: StaticLaw | SampledLaw,
    sample_period: float,
    delay: float = 0.0,
    configurations: ArrayLike | None = None,
    plant: Plant | None = None,
    sensing: Sensing | None = None,
) -> SampledCheck:
    """Judge the law sampled every sample_period [s] with a loop delay [s]; see SampledCheck and this module.

    law: a static law, or one with a state (robust.sampled_law). configurations (k, n) [rad]: 1024 sampled ones when
    none are given (64 for another law than v-dPBC, which has no closed form here). Of more than 48 the closed form of
    the static loop picks the worst, and margins are searched for on these. A static loop is then looked at everywhere
    just within the margins (for delays that make at most MOST_STATES states). A loop with a controller state is judged
    on about WITH_STATE of the worst only. plant: what the law really drives, when its robot differs. sensing: what
    the law gets of the plant; None: its state.
    Raises StateError for times that are not positive (delay: negative) or shapes that do not fit.
    """
    checked_times(sample_period, delay)
    law, sensing = as_static(law), sensing or Sensing()
    q_l, plant, below = looked_at(law, configurations), plant or Plant(law.robot), without_state(law)
    with_state = not isinstance(law, StaticLaw) or not sensing.plain
    most = WITH_STATE if with_state else FEW
    if len(q_l) <= most or plant.robot.n != law.robot.n:
        return _judged(linearize(law, q_l, plant, sensing), sample_period, delay)
    if not isinstance(below, TrackingLaw):
        few = _evenly(len(q_l), WITH_STATE) if with_state else np.arange(len(q_l))
        return replace(_judged(linearize(law, q_l[few], plant, sensing), sample_period, delay), configurations=len(few))
    everywhere = closed_form(below, q_l, plant)
    static = _of_many(below, everywhere, plant, sample_period, delay)
    if not with_state:
        return static
    few = _worst_of(everywhere, static)
    found = _judged(linearize(law, q_l[few], plant, sensing), sample_period, delay)
    return replace(found, configurations=len(few))


def _of_many(
    law: TrackingLaw, everywhere: SampledLoop, plant: Plant, sample_period: float, delay: float
) -> SampledCheck:
    """Judge a static loop on the worst configurations of its closed form, and on those that they miss."""
    q_l, few = everywhere.configurations, everywhere.critical(sample_period, delay, KEPT)
    for _ in range(ROUNDS):
        found = _judged(linearize(law, q_l[few], plant), sample_period, delay)
        missed = np.setdiff1d(_unstable(everywhere, found), few)
        if not len(missed):
            break
        few = np.append(few, missed)
    return replace(found, configurations=len(q_l))


def _worst_of(everywhere: SampledLoop, found: SampledCheck) -> Indices:
    """Indices of the worst configurations of a static loop as given and at its margins, the worst of each first."""
    T, delay = found.sample_period, found.delay
    late = min(max(found.delay_margin, delay / T + 0.5), MOST_LATE)
    slowest = 1 / (found.lowest_stable_rate or 1 / T)
    orders = [np.argsort(-everywhere.radii(*times)) for times in ((T, delay), (slowest, delay), (T, late * T))]
    ranked = np.stack(orders, axis=1)[: WITH_STATE // 2].ravel()
    return ranked[np.sort(np.unique(ranked, return_index=True)[1])]


def _evenly(k: int, most: int) -> Indices:
    """Up to `most` of k indices, evenly, the first and the last among them."""
    return np.unique(np.linspace(0, k - 1, min(k, most)).round().astype(np.intp))


def _judged(loop: SampledLoop, sample_period: float, delay: float) -> SampledCheck:
    radii = loop.radii(sample_period, delay)
    at_rates = loop if loop.with_state is None else loop.at(np.arange(len(radii))[:RATES_WITH_STATE])
    worst = int(np.argmax(radii))
    stable = bool(radii[worst] < 1)
    return SampledCheck(
        stable=stable,
        spectral_radius=float(radii[worst]),
        configuration=loop.configurations[worst],
        delay_margin=_delay_margin(loop, sample_period, delay, stable),
        lowest_stable_rate=_lowest_stable_rate(at_rates, 1 / sample_period, delay, stable),
        sample_period=sample_period,
        delay=delay,
        configurations=len(loop.configurations),
        closely=loop.configurations,
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
