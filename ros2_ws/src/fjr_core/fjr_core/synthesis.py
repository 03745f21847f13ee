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
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .checks import Array
from .configurations import LOOP_CONFIGURATIONS, RATE_CONFIGURATIONS, checked_configurations
from .errors import GainsError
from .gains import Gains, relative_eigenvalues
from .linear_loop import in_error_coordinates
from .rest import RestPoints, feedback, plant_matrices, rest_points
from .robot import Robot
from .sampled_loop import checked_times

QUICKNESS = (2.0, 1.4, 1.0)  # c, what Lambda and K_md have more than the wanted rate
COUPLING = (1.0, 1.1, 1.2, 1.35, 1.5)  # g = Pi_m / K
SURE = (0.0, 0.25, 0.5)  # samples of delay beyond the given one at which the loop must decay
WISHED = (0.75, 1.0, 1.5, 2.0, 3.0)  # samples beyond, of which it shall bear as many as it can
LEAST_DECAY = 0.5  # of the wanted rate, which the sampled loop must keep
HALVINGS = 8  # of a rate out of reach, in search of one within


def synthesize(
    robot: Robot,
    beta: float,
    sample_period: float,
    delay: float = 0.0,
    configurations: ArrayLike | None = None,
) -> Gains:
    """Gains with block rates of at least beta [1/s] for a loop of sample_period [s] and delay [s].

    Rates and sampled loop hold at the configurations (k, n) [rad], at best those where the robot will move; when
    none are given, at sampled ones within the robot's limits: then law.rate().beta >= beta and check(...).stable.
    The sampled loop decays at half of beta or faster at every delay up to half a sample more than the given one.
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
        """The quickest gains that are sure, with the coupling that bears the longest delay; None when none is sure."""
        for c in QUICKNESS:
            ranked = [(self._rank(gains, beta), gains) for gains in self._candidates(beta, c)]
            rank, gains = max(ranked, key=lambda pair: pair[0])
            if rank[0]:
                return gains
        return None

    def _candidates(self, beta: float, c: float) -> Iterator[Gains]:
        for g in COUPLING:
            yield Gains(
                Lambda_l=c * beta,
                Pi_l=(c * beta) ** 2 * self.M,
                K_ld=beta * self.s * self.M,
                Lambda_m=c * beta,
                Pi_m=g * self.rest.robot.K,
                K_md=c * beta * self.rest.robot.M_m,
            )

    def _rank(self, gains: Gains, beta: float) -> tuple[int, float]:
        """How many of the delays the loop bears, and the least rate [1/s] at which it decays there; 0: not sure."""
        T, checked = self.sample_period, gains.checked(self.rest.robot.n)
        loop = in_error_coordinates(self.rest, checked, *plant_matrices(self.rest), feedback(self.rest, checked))
        decays: list[float] = []
        for samples in (*SURE, *WISHED):
            decay = float(-np.log(loop.radii(T, self.delay + samples * T).max()) / T)
            if samples in SURE and not decay >= LEAST_DECAY * beta:
                return 0, 0.0
            if not decay > 0:
                break
            decays.append(decay)
        return len(decays), min(decays)


def _task(robot: Robot, sample_period: float, delay: float, configurations: ArrayLike | None) -> _Task:
    q_l = checked_configurations(robot, configurations, RATE_CONFIGURATIONS)
    inertias = [robot.M_l(q) for q in q_l]
    M = np.mean(inertias, axis=0)
    if configurations is None:
        inertias += robot.links.M_l_vertices or ()
        q_l = q_l[:LOOP_CONFIGURATIONS]
    s = max(float(relative_eigenvalues(M_l, M)[-1]) for M_l in inertias)
    return _Task(rest_points(robot, q_l), M, s, sample_period, delay)


def _reachable(task: _Task, beta: float) -> str:
    """The largest rate below beta that has gains, to 5 %, in words."""
    low = next((beta / 2**k for k in range(1, HALVINGS + 1) if task.best(beta / 2**k)), None)
    if low is None:
        return f"nor is any down to {beta / 2**HALVINGS:.3g} 1/s; expected a faster loop or fewer configurations"
    high = 2 * low
    while high > 1.05 * low:
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if task.best(middle) else (low, middle)
    return f"expected at most {low:.3g} 1/s, a faster loop or fewer configurations"
