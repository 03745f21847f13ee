# SPDX-License-Identifier: Apache-2.0
"""Synthesise gains for a convergence rate and a sampled loop: scaled by inertia and stiffness, then checked.

    K_ld = beta s M      M: mean of M_l over the configurations, s: smallest number with s M >= M_l at all of them
    Lambda_l = c beta    Pi_l = (c beta)^2 M
    Lambda_m = c beta    Pi_m = g K             K_md = c beta M_m

K_ld limits the sample period: where the inertia is small it damps at a rate K_ld / M_l >> beta. It is therefore no
larger than the rate requires and proportional to M. Pi_m near K keeps the elastic mode of the error dynamics,
sqrt(K^2 / (Pi_m M_l)), near that of the robot, so that the law does not act against the springs with delayed effort.
c is the largest of a few values for which the loop has the required decay; g is the value that then tolerates the
longest delay.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fjr_core.errors import GainsError
from fjr_core.files import importing
from fjr_core.law.gains import Gains, relative_eigenvalues
from fjr_core.law.linearized import Equilibria, Indices, equilibria_at
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.model.configuration_sampling import RATE_CONFIGURATIONS, checked_configurations
from fjr_core.model.robot import Robot
from fjr_core.motions.domain import Domain
from fjr_core.numerics.checks import Array, positive
from fjr_core.numerics.one_line import at_least
from fjr_core.stability.linearization import SampledLoop, checked_times, closed_form

from ..stability.sampled_loop import FEW, late_spring
from ..uncertainty.drawn_loops import DrawnLoops, DrawnPlants, in_common

SPEED_FACTORS = (2.0, 1.4, 1.0)  # c: ratio of Lambda and K_md M_m^-1 to the rate
COUPLING = (1.0, 1.1, 1.2, 1.35, 1.5)  # g = Pi_m / K
REQUIRED_DELAYS = (0.5, 0.25, 0.0)  # samples beyond the given delay at which the loop must decay
DESIRED_DELAYS = (0.75, 1.0, 1.5, 2.0, 3.0)  # samples beyond; the more of them the loop tolerates, the better
LEAST_DECAY = 0.5  # fraction of the rate that the sampled loop must keep
HALVINGS = 16  # of an unreachable rate in the search of a reachable one
LARGEST_PRODUCT = 30.0  # beta times the sample period; no loop decays by e^-15 per sample
DRAWN_AT = 3  # configurations of the largest radius, at each screened delay, for drawn plants
SCREENED_AT = 100  # configurations, about as many, of which the worst for some drawn plants are added
STEP_DOWN, STEPS_DOWN = 0.7, 6  # in the search of a rate that is stable with all drawn plants
GOAL = 0.98  # attained / proven inertia at which the search of a proven s ends
KEPT = 12  # configurations of the largest radius at each screened delay, at which gains are compared


def synthesize(
    robot: Robot,
    beta: float,
    sample_period: float,
    delay: float = 0.0,
    configurations: ArrayLike | None = None,
    joints: Sequence[str] = (),
    plants: DrawnPlants | None = None,
    domain: Domain | None = None,
) -> Gains:
    """Return gains with block rates of at least beta [1/s] for a loop of sample_period [s] and delay [s].

    configurations (k, n) [rad]: where rate and sampled loop are checked, preferably those of the planned motion; None:
    the 1024 of `check` within the limits of the robot, so that law.rate().beta >= beta and check(...) is stable. At
    these configurations the sampled loop decays at least at beta / 2 with the given delay and with a quarter and half a
    sample more. There is no guarantee between the configurations.
    domain: positions on which s M >= M_l is proven (package fjr_proofs), so that law.proven_rate(domain) is at
    least beta but for the gap of its own search.
    plants: drawn plants with which the loop is to be stable, too, at the most critical configurations.
    Raises GainsError if no gains of this family meet these conditions, with the largest reachable rate, and with the
    joint (one of `joints`, their names) whose spring is too fast for the loop.
    """
    sample_period, delay = checked_times(sample_period, delay)
    beta = positive("beta", beta, GainsError, "1/s")
    task = gain_search(robot, sample_period, delay, configurations, domain)
    gains = replace(task, plants=plants).best(beta)
    if gains is None and plants is not None and (own := task.best(beta)) is not None:
        lost = task.lost(own, plants)
        why = f" ({in_common(plants, lost, joints)})" if lost.any() and not lost.all() else ""
        raise GainsError(
            f"beta = {beta:g} 1/s is out of reach for all {len(plants)} drawn plants{why}; "
            f"{_reachable_by_all(task, plants, beta)}"
        )
    if gains is None:
        raise GainsError(
            f"beta = {beta:g} 1/s is out of reach at {1 / sample_period:g} Hz with a delay of {delay:g} s; "
            f"{_reachable(task, beta, joints)}"
        )
    return gains


@dataclass(frozen=True, eq=False)
class GainSearch:
    """Equilibria of a robot, its M and s (see the module), and the loop."""

    equilibria: Equilibria
    M: Array
    s: float
    sample_period: float
    delay: float
    plants: DrawnPlants | None = None

    def best(self, beta: float) -> Gains | None:
        """Return the fastest gains with the required decay and the coupling of the longest delay; None if none exist.

        Gains are compared at a few of the worst configurations and then checked at all; failing configurations join
        the few.
        """
        if beta * self.sample_period > LARGEST_PRODUCT:
            return None
        few = self.critical(beta)
        while (gains := self._best_at(few, beta)) is not None:
            missed = self._too_slow(self._loop(self.equilibria, gains), beta)
            if missed is None or not len(missed):
                return gains
            few = np.append(few, missed)
        return None

    def critical(self, beta: float) -> Indices:
        """Return indices of the equilibria that are critical for the slowest gains; all if they are few."""
        k = len(self.equilibria.q_l)
        if k <= FEW:
            return np.arange(k)
        slowest = next(self._candidates(beta, SPEED_FACTORS[-1]))
        return self._loop(self.equilibria, slowest).critical(self.sample_period, self.delay, KEPT)

    def reaches(self, beta: float) -> bool:
        """Return whether any gains have the required decay at all equilibria."""
        return beta * self.sample_period <= LARGEST_PRODUCT and any(
            self._too_slow(self._loop(self.equilibria, gains), beta) is None
            for c in SPEED_FACTORS[::-1]
            for gains in self._candidates(beta, c)
        )

    def _best_at(self, few: Indices, beta: float) -> Gains | None:
        equilibria = self.equilibria.at(few)
        for c in SPEED_FACTORS:
            ranked = [(self._rank(self._loop(equilibria, gains), beta), gains) for gains in self._candidates(beta, c)]
            for rank, gains in sorted(ranked, key=lambda pair: pair[0], reverse=True):
                if rank[0] and (self.plants is None or not self.lost(gains, self.plants).any()):
                    return gains
        return None

    def lost(self, gains: Gains, plants: DrawnPlants) -> NDArray[np.bool_]:
        """Return which drawn plants (k,) are unstable where the loop is worst for its own model or for some of them."""
        law, T = TrackingLaw(self.equilibria.robot, gains), self.sample_period
        count = len(self.equilibria.q_l)
        screened = np.arange(0, count, max(1, count // SCREENED_AT))
        worst = screened[DrawnLoops(law, self.equilibria.at(screened), T, self.delay).worst(plants)]
        own = self._loop(self.equilibria, gains).critical(T, self.delay, DRAWN_AT)
        return DrawnLoops(law, self.equilibria.at(np.union1d(own, worst)), T, self.delay).unstable(plants)

    def _candidates(self, beta: float, c: float) -> Iterator[Gains]:
        K = self.equilibria.K
        for g in COUPLING:
            yield Gains(
                Lambda_l=c * beta,
                Pi_l=(c * beta) * (c * beta) * self.M,
                K_ld=beta * self.s * self.M,
                Lambda_m=c * beta,
                Pi_m=g * (K if K.ndim == 2 else K.mean(axis=0)),
                K_md=c * beta * self.equilibria.robot.M_m,
            )

    def _loop(self, equilibria: Equilibria, gains: Gains) -> SampledLoop:
        return closed_form(equilibria, gains.checked(equilibria.robot.n))

    def _decays(self, loop: SampledLoop, samples: float) -> Array:
        """Return the decay rates (k,) [1/s] of the loop at the given delay plus `samples`."""
        T = self.sample_period
        return np.asarray(-np.log(loop.radii(T, self.delay + samples * T)) / T)

    def _too_slow(self, loop: SampledLoop, beta: float) -> Indices | None:
        """Return where the loop decays too slowly at a required delay, the worst first; None: nowhere."""
        for samples in REQUIRED_DELAYS:
            decays = self._decays(loop, samples)
            if not decays.min() >= LEAST_DECAY * beta:
                worst = np.argsort(decays, kind="stable")[:KEPT]
                return worst[~(decays[worst] >= LEAST_DECAY * beta)]
        return None

    def _rank(self, loop: SampledLoop, beta: float) -> tuple[int, float]:
        """Return the number of tolerated delays and the lowest decay rate [1/s] there; 0 without the required decay."""
        if self._too_slow(loop, beta) is not None:
            return 0, 0.0
        decays = [float(self._decays(loop, samples).min()) for samples in REQUIRED_DELAYS]
        for samples in DESIRED_DELAYS:
            decay = float(self._decays(loop, samples).min())
            if not decay > 0:
                break
            decays.append(decay)
        return len(decays), min(decays)


def gain_search(
    robot: Robot, sample_period: float, delay: float, configurations: ArrayLike | None, domain: Domain | None = None
) -> GainSearch:
    """Return the search of gains for several rates; the arguments are those of `synthesize`."""
    equilibria = equilibria_at(robot, checked_configurations(robot, configurations))
    inertias = list(equilibria.M_l)
    M = np.mean(inertias if configurations is not None else inertias[:RATE_CONFIGURATIONS], axis=0)
    M[np.abs(M) < np.sqrt(1e-24 * np.outer(np.diag(M), np.diag(M)))] = 0.0  # rounding, of joints without coupling
    if configurations is None:
        inertias += [np.asarray(vertex) for vertex in robot.links.M_l_vertices or ()]
    s = max(float(relative_eigenvalues(M_l, M)[-1]) for M_l in inertias)
    if domain is not None:
        prover = importing.module("fjr_proofs.verification.inertia_bounds")
        s = max(s, prover.largest_inertia(robot, M, domain, GOAL).bound)
    return GainSearch(equilibria, M, s, sample_period, delay)


def _reachable_by_all(task: GainSearch, plants: DrawnPlants, beta: float) -> str:
    """Describe the first of a few lower rates at which the loop is stable with all plants."""
    whole = replace(task, plants=plants)
    rates = [beta * STEP_DOWN**i for i in range(1, STEPS_DOWN + 1)]
    found = next((rate for rate in rates if whole.best(rate) is not None), None)
    if found is None:
        return f"so are all rates down to {rates[-1]:.3g} 1/s; expected narrower intervals of the parameters"
    return f"expected at most {at_least(found, 3)} 1/s, or narrower intervals of the parameters"


def _reachable(task: GainSearch, beta: float, joints: Sequence[str]) -> str:
    """Describe the largest reachable rate below beta to 5 %, searched at the worst configurations, and its cause."""
    beta = min(beta, LARGEST_PRODUCT / task.sample_period)
    reason = late_spring(task.equilibria, task.sample_period, task.delay, joints)
    late, remedy = reason and f": {reason}", "a faster loop or fewer configurations"
    few = replace(task, equilibria=task.equilibria.at(task.critical(beta)))
    rates = [beta / 2**k for k in range(1, HALVINGS + 1)]
    low = next((rate for rate in rates if few.reaches(rate)), None)
    if low is None:
        return f"so are all rates down to {rates[-1]:.3g} 1/s{late or f'; expected {remedy}'}"
    high = 2 * low
    while high > 1.05 * low:
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if few.reaches(middle) else (low, middle)
    while task.best(low) is None:
        low *= 0.95
    return f"expected at most {at_least(low, 3)} 1/s{late or f', {remedy}'}"
