# SPDX-License-Identifier: Apache-2.0
"""Gains from a robot, a wanted rate and the loop it will run in: scaled by inertia and stiffness, then checked.

    K_ld = beta s M      M the mean of M_l over the configurations, s the least with s M >= M_l at all of them
    Lambda_l = c beta    Pi_l = (c beta)^2 M
    Lambda_m = c beta    Pi_m = g K             K_md = c beta M_m

K_ld is what sampling pays for: where the arm is light it damps at a rate of K_ld / M_l >> beta. So it is no larger
than the wanted rate needs, and has the shape of M. Pi_m near K keeps the elastic mode of the error dynamics,
sqrt(K^2 / (Pi_m M_l)), where the robot has it, so that the law need not fight the springs with delayed effort.
c is the largest of a few for which the loop is sure, g that which then bears the longest delay.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ..control.vdpbc.gains import Gains, relative_eigenvalues
from ..control.vdpbc.linearized import feedback
from ..errors import GainsError
from ..numerics.checks import Array
from ..robot.configuration_sampling import RATE_CONFIGURATIONS, checked_configurations
from ..robot.equilibrium import Indices, RestPoints, plant_matrices, rest_points
from ..robot.robot import Robot
from ..stability.linearization import SampledLoop, in_error_coordinates
from ..stability.sampled_loop import FEW, checked_times

QUICKNESS = (2.0, 1.4, 1.0)  # c, what Lambda and K_md have more than the wanted rate
COUPLING = (1.0, 1.1, 1.2, 1.35, 1.5)  # g = Pi_m / K
SURE = (0.5, 0.25, 0.0)  # samples of delay beyond the given one at which the loop must decay
WISHED = (0.75, 1.0, 1.5, 2.0, 3.0)  # samples beyond, of which it shall bear as many as it can
LEAST_DECAY = 0.5  # of the wanted rate, which the sampled loop must keep
HALVINGS = 16  # of a rate out of reach, in search of one within
QUICKEST = 30.0  # beta times the sample period; no loop decays by e^-15 a sample
KEPT = 12  # configurations of the largest radius at each screened delay: there gains are compared


def synthesize(
    robot: Robot,
    beta: float,
    sample_period: float,
    delay: float = 0.0,
    configurations: ArrayLike | None = None,
) -> Gains:
    """Gains with block rates of at least beta [1/s] for a loop of sample_period [s] and delay [s].

    Rates and sampled loop hold at the configurations (k, n) [rad], at best those where the robot will move; when
    none are given, at the 1024 of `check` within the robot's limits: then law.rate().beta >= beta and check(...)
    is stable. There the sampled loop decays at half of beta or faster at the given delay and at a quarter and half a
    sample more; between the configurations nothing is promised.
    Raises GainsError when no gains of this family do, with the largest rate that is within reach.
    """
    checked_times(sample_period, delay)
    if not (np.isfinite(beta) and beta > 0):
        raise GainsError(f"beta is {beta} 1/s; expected a positive finite number")
    task = _task(robot, sample_period, delay, configurations)
    gains = task.best(beta)
    if gains is None:
        raise GainsError(
            f"beta = {beta:g} 1/s is out of reach at {1 / sample_period:g} Hz with a delay of {delay:g} s; "
            f"{_reachable(task, beta)}"
        )
    return gains


@dataclass(frozen=True, eq=False)
class _Task:
    """A robot at rest points, its M and s (see the module), and the loop."""

    rest: RestPoints
    M: Array
    s: float
    sample_period: float
    delay: float

    def best(self, beta: float) -> Gains | None:
        """The quickest gains that are sure, with the coupling that bears the longest delay; None when none is sure.

        Compared at the worst few configurations, then looked at everywhere; where that fails is added to the few.
        """
        few = self.critical(beta)
        while (gains := self._best_at(few, beta)) is not None:
            missed = self._missed(gains, beta)
            if not len(missed):
                return gains
            few = np.append(few, missed)
        return None

    def critical(self, beta: float) -> Indices:
        """Indices of the rest points that decide about the plainest gains; all when they are few."""
        k = len(self.rest.q_l)
        if k <= FEW or beta * self.sample_period > QUICKEST:
            return np.arange(k)
        plainest = next(self._candidates(beta, QUICKNESS[-1]))
        return self._loop(self.rest, plainest).critical(self.sample_period, self.delay, KEPT)

    def reaches(self, beta: float) -> bool:
        """Whether any gains are sure at all rest points."""
        return beta * self.sample_period <= QUICKEST and any(
            self._unsure(self._loop(self.rest, gains), beta) is None
            for c in QUICKNESS[::-1]
            for gains in self._candidates(beta, c)
        )

    def _best_at(self, few: Indices, beta: float) -> Gains | None:
        if beta * self.sample_period > QUICKEST:
            return None
        rest = self.rest.at(few)
        for c in QUICKNESS:
            ranked = [(self._rank(self._loop(rest, gains), beta), gains) for gains in self._candidates(beta, c)]
            rank, gains = max(ranked, key=lambda pair: pair[0])
            if rank[0]:
                return gains
        return None

    def _candidates(self, beta: float, c: float) -> Iterator[Gains]:
        for g in COUPLING:
            yield Gains(
                Lambda_l=c * beta,
                Pi_l=(c * beta) * (c * beta) * self.M,
                K_ld=beta * self.s * self.M,
                Lambda_m=c * beta,
                Pi_m=g * self.rest.robot.K,
                K_md=c * beta * self.rest.robot.M_m,
            )

    def _loop(self, rest: RestPoints, gains: Gains) -> SampledLoop:
        checked = gains.checked(rest.robot.n)
        return in_error_coordinates(rest, checked, *plant_matrices(rest), feedback(rest, checked))

    def _decays(self, loop: SampledLoop, samples: float) -> Array:
        """Rates (k,) [1/s] at which the loop decays, `samples` later than the given delay."""
        T = self.sample_period
        return np.asarray(-np.log(loop.radii(T, self.delay + samples * T)) / T)

    def _unsure(self, loop: SampledLoop, beta: float) -> Indices | None:
        """Where the loop decays too slowly at a sure delay, the worst first; None: nowhere."""
        for samples in SURE:
            decays = self._decays(loop, samples)
            if not decays.min() >= LEAST_DECAY * beta:
                worst = np.argsort(decays, kind="stable")[:KEPT]
                return worst[~(decays[worst] >= LEAST_DECAY * beta)]
        return None

    def _missed(self, gains: Gains, beta: float) -> Indices:
        unsure = self._unsure(self._loop(self.rest, gains), beta)
        return np.zeros(0, dtype=np.intp) if unsure is None else unsure

    def _rank(self, loop: SampledLoop, beta: float) -> tuple[int, float]:
        """How many of the delays the loop bears, and the least rate [1/s] at which it decays there; 0: not sure."""
        if self._unsure(loop, beta) is not None:
            return 0, 0.0
        decays = [float(self._decays(loop, samples).min()) for samples in SURE]
        for samples in WISHED:
            decay = float(self._decays(loop, samples).min())
            if not decay > 0:
                break
            decays.append(decay)
        return len(decays), min(decays)


def _task(robot: Robot, sample_period: float, delay: float, configurations: ArrayLike | None) -> _Task:
    rest = rest_points(robot, checked_configurations(robot, configurations))
    inertias = list(rest.M_l)
    M = np.mean(inertias if configurations is not None else inertias[:RATE_CONFIGURATIONS], axis=0)
    if configurations is None:
        inertias += [np.asarray(vertex) for vertex in robot.links.M_l_vertices or ()]
    s = max(float(relative_eigenvalues(M_l, M)[-1]) for M_l in inertias)
    return _Task(rest, M, s, sample_period, delay)


def _reachable(task: _Task, beta: float) -> str:
    """The largest rate below beta that has gains, to 5 %, in words; searched for at the worst configurations."""
    beta = min(beta, QUICKEST / task.sample_period)
    few = replace(task, rest=task.rest.at(task.critical(beta)))
    rates = [beta / 2**k for k in range(1, HALVINGS + 1)]
    low = next((rate for rate in rates if few.reaches(rate)), None)
    if low is None:
        return f"nor is any down to {rates[-1]:.3g} 1/s; expected a faster loop or fewer configurations"
    high = 2 * low
    while high > 1.05 * low:
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if few.reaches(middle) else (low, middle)
    while task.best(low) is None:
        low *= 0.95
    return f"expected at most {low:.3g} 1/s, a faster loop or fewer configurations"
