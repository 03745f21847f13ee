# SPDX-License-Identifier: Apache-2.0
"""Prove a convergence rate on a domain of joint positions (docs/proof.md).

The block of sigma_l has the rate beta if D_l + K_ld - beta M_l(q_l) >= 0 for every q_l of the domain, i.e. for
M_l(q_l) <= (D_l + K_ld) / beta. The other blocks have closed forms.
"""

from __future__ import annotations

from dataclasses import dataclass

from fjr_core.law.gains import CheckedGains
from fjr_core.law.rate import Rate, rate_with
from fjr_core.model.robot import Robot
from fjr_core.motions.domain import GOAL, MOST_BOXES, Domain, joint_range
from fjr_core.numerics.checks import Array

from ..verification.branch_and_bound import Watch, unwatched
from ..verification.inertia_bounds import RelativeInertia, largest_inertia

SHARE = 40
"""The largest inertia, for eq. (50) only, takes at most 1 / SHARE of the boxes."""


@dataclass(frozen=True, eq=False)
class RateProof:
    """A proven rate, its domain, and the bound M_l(q_l) <= inertia.bound (D_l + K_ld) with its boxes."""

    rate: Rate
    domain: Domain
    inertia: RelativeInertia


def proof_of_rate(
    robot: Robot,
    gains: CheckedGains,
    domain: Domain | None = None,
    goal: float = GOAL,
    most_boxes: int = MOST_BOXES,
    samples: Array | tuple[()] = (),
    watch: Watch = unwatched,
) -> RateProof:
    """Return the proven rate of a robot on a domain, by default the joint range; see TrackingLaw.proven_rate.

    samples (k, n) [rad, m]: configurations of small rates, if known. watch: see verification.branch_and_bound.
    """
    domain = domain or joint_range(robot)
    inertia = largest_inertia(robot, robot.D_l + gains.K_ld, domain, goal, most_boxes, samples, watch)
    largest = largest_inertia(robot, 1.0, domain, goal, 1 + most_boxes // SHARE, samples)
    return RateProof(rate_with(robot, gains, inertia.bound, inertia.attained, largest.bound), domain, inertia)
