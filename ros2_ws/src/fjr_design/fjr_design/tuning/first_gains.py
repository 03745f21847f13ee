# SPDX-License-Identifier: Apache-2.0
"""Find gains for an arm of which nothing but the model is known: a few rates, the fastest that is robust first."""

from __future__ import annotations

from dataclasses import dataclass

from fjr_core.errors import GainsError
from fjr_core.law.gains import Gains
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array
from fjr_core.stability.sampled_loop import SampledCheck, check

from .gain_synthesis import GainSearch, gain_search

ALONG, EVERYWHERE = "along the reference", "everywhere"
TRIALS = (
    (6.0, ALONG),
    (4.0, ALONG),
    (2.5, ALONG),
    (1.5, ALONG),
    (1.0, ALONG),
    (1.0, EVERYWHERE),
    (0.3, EVERYWHERE),
)
"""Rate [1/s] and where it holds, in the order of the trials."""
DELAY_MARGIN = 0.4  # samples; gains that tolerate it everywhere end the search


@dataclass(frozen=True, eq=False)
class FirstGains:
    """Gains of a rate beta [1/s], where it holds, and the check of the sampled loop in the whole range."""

    gains: Gains
    beta: float
    where: str
    check: SampledCheck


def first_gains(robot: Robot, sample_period: float, configurations: Array, delay: float = 0.0) -> FirstGains:
    """Return the first gains whose loop tolerates DELAY_MARGIN in the whole range, else the most tolerant ones.

    configurations (k, n) [rad]: of the reference. delay [s]: of the loop. Raises GainsError if no trial is stable in
    the whole range.
    """
    best: FirstGains | None = None
    searches: dict[str, GainSearch] = {}
    for beta, where in TRIALS:
        if where not in searches:
            searches[where] = gain_search(robot, sample_period, delay, configurations if where == ALONG else None)
        gains = searches[where].best(beta)
        if gains is None:
            continue
        found = check(TrackingLaw(robot, gains), sample_period, delay)
        if found.stable and (best is None or found.delay_margin > best.check.delay_margin):
            best = FirstGains(gains, beta, where, found)
        if best is not None and best.check.delay_margin >= DELAY_MARGIN:
            return best
    if best is None:
        raise GainsError(
            f"no gains of {TRIALS[0][0]:g} to {TRIALS[-1][0]:g} 1/s are stable at {1 / sample_period:g} Hz in "
            "the whole range of the joints; expected narrower ranges, where the inertia varies less, or fewer joints"
        )
    return best
