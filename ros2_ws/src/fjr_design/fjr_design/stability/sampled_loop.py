# SPDX-License-Identifier: Apache-2.0
"""Check the stability of the sampled closed loop by the spectral radius of its linearised one-sample map.

The map contains the plant under held efforts, the law with its controller state (disturbance observer, integral action,
Smith predictor), the velocity observer, the sensors, hold and delay.

The proof of the law is in continuous time and covers neither hold nor delay. This check does, locally: it linearises
at equilibria of sampled configurations. Motion adds Coriolis terms of the order of dq_l, which are neglected; they are
small compared with K_d / M and the elastic modes.

Modes may be too fast for a loop, whatever its gains. A wrist that carries no tool oscillates fast on its spring:

    omega_i = sqrt(K_ii / m_i)      m_i: least inertia that joint i carries while the others move freely
    omega_i (T / 2 + delay) < pi/2  hold and delay lag by less than 90 degrees

Velocity feedback damps an oscillation up to this lag and drives it beyond. Without delay the bound is the Nyquist
frequency pi / T. Far beyond, a late loop can be stable in a narrow band, whose alias has the right phase.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fjr_core.errors import StateError
from fjr_core.law.interfaces import SampledLaw, StaticLaw, check_law
from fjr_core.law.linearized import Equilibria, Indices, equilibria_at, plant_matrices
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.model.port_hamiltonian import Plant
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array, instance
from fjr_core.numerics.one_line import one_line
from fjr_core.stability.linear_controller import Sensing
from fjr_core.stability.linearization import SampledLoop, checked_times, closed_form, linearize, loop_configurations
from fjr_core.urdf.typical_joints import least_free_inertia

FEW = 48  # up to so many configurations, margins are searched at all of them
KEPT = 16  # configurations of the largest radius at each screened delay, at which margins are searched
LONGEST_DELAY = 20.0  # samples; largest reported margin
WITHIN = 0.02  # samples below the delay margin, and fraction above the lowest rate, at which all are checked again
MOST_STATES = 64  # of plant and delayed efforts: limits the delay at which all configurations are checked
WITH_STATE = 4  # configurations of each order of `_worst_of`, at which a controller with a state is checked
RATES_WITH_STATE = 4  # the first of these, at which the lowest stable rate is searched
LATEST = 64  # samples; largest delay that is checked
MOST_LATE = 5.0  # samples; largest delay at which the worst configurations of an unstable loop are selected
ROUNDS = 8  # checks of all configurations
SQUARINGS = 14  # of a map
HIGHEST_RATE = 1e5  # Hz; highest sample rate considered
LOWEST_RATE = 1.0  # Hz
RK4_REACH = 2.7  # rad: largest stable product of step and frequency for the Runge-Kutta method of order 4
MOST_SAMPLES_OF_DELAY = 10  # rates at which the given delay exceeds this many samples are not considered


@dataclass(frozen=True, eq=False)
class SampledCheck:
    """Stability of a sampled loop.

    stable: spectral_radius < 1 at every checked configuration. spectral_radius: the largest, at the configuration (n,)
    [rad]. delay_margin [samples]: the largest total delay such that all delays between the given one and this are
    stable; if the given one is unstable, counted from zero; 0 if no delay is stable; at most LONGEST_DELAY.
    lowest_stable_rate [Hz]: the lowest sample rate such that all rates between it and the given one are stable; if the
    given one is unstable, the rate above which all are, up to HIGHEST_RATE; None: no such rate, or not searched. Delay
    [s] and parameters of the controller, robust.hold included, stay the same at other rates. configurations: number of
    checked configurations. closely (c, n) [rad]: those at which the margins were searched.
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

    __repr__ = one_line


def check(
    law: SampledLaw,
    sample_period: float,
    delay: float = 0.0,
    configurations: ArrayLike | None = None,
    plant: Plant | None = None,
    sensing: Sensing | None = None,
    lowest_rate: bool = True,
) -> SampledCheck:
    """Check the law sampled every sample_period [s] with a loop delay [s]; see SampledCheck and this module.

    law: a static law, or one with a controller state (robust.law.sampled_law). configurations (k, n) [rad]; None: 1024
    sampled ones (64 for another law than v-dPBC, which has no closed form here). plant: the controlled plant if it
    differs from the model of the law. sensing: measurements of the law; None: the state of the plant. lowest_rate:
    search the lowest stable rate, which takes most of the time; without it a loop with a controller state is checked
    where the static loop is worst at half the rate.
    Of more than 48 configurations the closed form of the static loop selects the worst, at which margins are searched.
    A static loop is then checked at all just within the margins, for delays up to MOST_STATES states; others are not.
    Raises StateError for a sample period that is not positive, a negative delay or one over LATEST, and wrong shapes.
    """
    sample_period, delay = checked_times(sample_period, delay)
    if delay > LATEST * sample_period:
        raise StateError(f"the loop's delay is {delay:g} s; expected at most {LATEST} samples of {sample_period:g} s")
    check_law(law)
    q_l, plant, sensing = loop_configurations(law, configurations), plant or Plant(law.robot), sensing or Sensing()
    instance("plant", plant, Plant, StateError, "a plant, e.g. fjr.Plant(robot)")
    static = isinstance(law, StaticLaw)
    if len(q_l) > (FEW if static else 2 * WITH_STATE) and plant.robot.n == law.robot.n:
        below, own = law.static, equilibria_at(law.robot, q_l)
        if isinstance(below, TrackingLaw) and sensing.plain:
            everywhere = closed_form(own, below.gains, equilibria_at(plant.robot, q_l))
        else:
            everywhere = linearize(below, q_l, plant, sensing)
        found = _of_many(below, everywhere, plant, sensing, sample_period, delay, lowest_rate)
        if static:
            return found
        q_l = q_l[_worst_of(everywhere, found, own)]
    searched = slice(None if static else RATES_WITH_STATE)
    return _checked(linearize(law, q_l, plant, sensing), sample_period, delay, lowest_rate, searched)


def _of_many(
    law: SampledLaw,
    everywhere: SampledLoop,
    plant: Plant,
    sensing: Sensing,
    sample_period: float,
    delay: float,
    lowest_rate: bool,
) -> SampledCheck:
    """Check a static loop at its worst configurations and at those that violate its margins."""
    q_l, late = everywhere.configurations, delay
    if everywhere.at(np.arange(1)).radii(sample_period, delay)[0] >= 1:
        late = min(delay, MOST_LATE * sample_period)
    few = everywhere.critical(sample_period, late, KEPT)
    for _ in range(ROUNDS):
        exact = sensing.plain and plant.robot is law.robot
        loop = everywhere.at(few) if exact else linearize(law, q_l[few], plant, sensing)
        found = _checked(loop, sample_period, delay, lowest_rate)
        missed = np.setdiff1d(_unstable(everywhere, found), few)
        if not len(missed):
            break
        few = np.append(few, missed)
    return replace(found, configurations=len(q_l) if late == delay else len(few))


def _worst_of(everywhere: SampledLoop, found: SampledCheck, own: Equilibria) -> Indices:
    """Return indices of configurations at which to check a loop with a controller state, the worst first.

    They are the worst of the static loop, as given and at its margins, and those where the joints carry the least
    inertia relative to its mean: the gains of integral action are the same everywhere, so they act most there.
    """
    T, delay = found.sample_period, found.delay
    late = min(max(found.delay_margin, delay / T + 0.5), MOST_LATE)
    slowest = 1 / found.lowest_stable_rate if found.lowest_stable_rate else 2 * T
    inertia = np.diagonal(own.M_l, axis1=1, axis2=2)
    orders = [np.argsort(-everywhere.radii(*times)) for times in ((T, delay), (slowest, delay), (T, late * T))]
    orders.append(np.argsort((inertia / inertia.mean(axis=0)).sum(axis=1)))
    ranked = np.stack(orders, axis=1)[:WITH_STATE].ravel()
    return ranked[np.sort(np.unique(ranked, return_index=True)[1])]


def _checked(
    loop: SampledLoop, sample_period: float, delay: float, lowest_rate: bool, searched: slice = slice(None)
) -> SampledCheck:
    """Check a loop at all its configurations; search the lowest rate at some of them."""
    radii = loop.radii(sample_period, delay)
    at_rates = loop if searched == slice(None) else loop.at(np.arange(len(radii))[searched])
    worst = int(np.argmax(radii))
    stable = bool(radii[worst] < 1)
    return SampledCheck(
        stable=stable,
        spectral_radius=float(radii[worst]),
        configuration=loop.configurations[worst],
        delay_margin=_delay_margin(loop, sample_period, delay, stable),
        lowest_stable_rate=_lowest_stable_rate(at_rates, 1 / sample_period, delay, stable) if lowest_rate else None,
        sample_period=sample_period,
        delay=delay,
        configurations=len(loop.configurations),
        closely=loop.configurations,
    )


def _unstable(everywhere: SampledLoop, found: SampledCheck) -> Indices:
    """Return the worst configurations that are unstable just within the margins found."""
    T, (_, states, n) = found.sample_period, everywhere.B.shape
    late = min(found.delay_margin - WITHIN, (MOST_STATES - states) // n)
    loops = [(T, late * T)] if late > 0 else []
    if found.lowest_stable_rate is not None:
        loops.append((1 / (found.lowest_stable_rate * (1 + WITHIN)), found.delay))
    unstable: list[Indices] = [np.arange(0)]
    for times in loops:
        lost = np.flatnonzero(~contracting(everywhere.one_sample_map(*times)))
        unstable.append(lost[np.argsort(-everywhere.at(lost).radii(*times), kind="stable")[:KEPT]])
    return np.unique(np.concatenate(unstable))


def _delay_margin(loop: SampledLoop, T: float, delay: float, stable: bool) -> float:
    """Return the delay margin [samples] to 0.01, scanned upwards from the given delay, or from zero if unstable."""
    start = delay / T if stable else 0.0
    delays = np.append(np.arange(start, LONGEST_DELAY, 0.25), max(start, LONGEST_DELAY))
    return _last_stable(lambda samples: loop.one_sample_map(T, samples * T), delays, tolerance=0.01) or 0.0


def _lowest_stable_rate(loop: SampledLoop, rate: float, delay: float, stable: bool) -> float | None:
    """Return the lowest stable rate [Hz] to 0.2 %.

    Scanned downwards in steps of 3 % from the given rate, or of 10 % from the highest if unstable.
    """
    highest = max(rate, min(HIGHEST_RATE, MOST_SAMPLES_OF_DELAY / delay) if delay else HIGHEST_RATE)
    start, end, step = (rate, LOWEST_RATE, 1.03) if stable else (highest, rate, 1.1)
    logarithms = np.append(np.arange(np.log(start), np.log(end), -np.log(step)), np.log(min(start, end)))
    lowest = _last_stable(lambda log: loop.one_sample_map(float(np.exp(-log)), delay), logarithms, 0.002)
    return None if lowest is None else float(np.exp(lowest))


def _last_stable(maps: Callable[[float], Array], points: Array, tolerance: float) -> float | None:
    """Return the end of the stable interval that starts at points[0], by scanning the points, then by bisection."""
    good = None
    for point in map(float, points):
        if contracting(maps(point)).all():
            good = point
            continue
        while good is not None and abs(point - good) > tolerance:
            middle = (good + point) / 2
            good, point = (middle, point) if contracting(maps(middle)).all() else (good, middle)
        break
    return good


def contracting(maps: Array) -> NDArray[np.bool_]:
    """Return which maps M (k, N, N) have a spectral radius below 1.

    A power of M that contracts, |M^(2^j)| < 1, shows it: repeated squaring decides thousands of maps in the time of a
    few hundred spectral radii. The maps that it does not decide get their eigenvalues.
    """
    stable, open_, power = np.zeros(len(maps), dtype=bool), np.arange(len(maps)), maps
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(SQUARINGS):
            norm = np.linalg.norm(power, axis=(1, 2))
            stable[open_[norm < 1]] = True
            rest = ~(norm < 1) & (norm < 1e30)
            open_, power = open_[rest], power[rest]
            if not len(open_):
                break
            power = power @ power
    left = np.flatnonzero(~stable & np.isfinite(maps).all(axis=(1, 2)))
    stable[left] = np.abs(np.linalg.eigvals(maps[left])).max(axis=1) < 1
    return stable


def fastest_mode(robot: Robot, configurations: Array) -> float:
    """Return the largest |eigenvalue| [rad/s] of the plant, linearised at link positions (k, n) [rad]."""
    A, _ = plant_matrices(equilibria_at(robot, configurations))
    return float(np.abs(np.linalg.eigvals(A)).max())


def least_steps(frequency: float, sample_period: float) -> int:
    """Return the fewest steps per sample [s] with which rk4 is stable for a mode of this frequency [rad/s]."""
    return max(1, int(np.ceil(frequency * sample_period / RK4_REACH)))


def lag_limit(sample_period: float, delay: float) -> float:
    """Return the frequency [rad/s] at which the hold of sample_period [s] and a delay [s] lag by 90 degrees."""
    return float(np.pi / (sample_period + 2 * delay))


def late_spring(points: Equilibria, sample_period: float, delay: float = 0.0, joints: Sequence[str] = ()) -> str:
    """Return a sentence about the fastest spring if it is beyond `lag_limit`, else an empty text.

    A spring with a curve has its stiffest tangent at the equilibria. joints: names; without them the sentence has the
    number of the joint from 1.
    """
    robot, inertia, limit = points.robot, least_free_inertia(points.M_l), lag_limit(sample_period, delay)
    frequency = np.sqrt(np.diag(robot.K) * points.hardening.max(axis=0) / inertia)
    i = int(np.argmax(frequency))
    if frequency[i] < limit:
        return ""
    late, carried = f" and a delay of {delay:g} s lag" if delay else " lags", f"{inertia[i]:.3g} kg m^2"
    return (
        f"the spring of joint {repr(joints[i]) if joints else i + 1} with the inertia that it carries "
        f"({robot.units[i].of(carried)}) oscillates at {frequency[i]:.4g} rad/s, and beyond {limit:.4g} rad/s the hold "
        f"at {1 / sample_period:g} Hz{late} by more than 90 degrees; expected more inertia (that of the tool in the "
        "URDF), a softer spring, the joint locked, or a faster loop"
    )
