# SPDX-License-Identifier: Apache-2.0
"""Proven rates equal the closed forms, are never above a rate that an adversarial search finds, and are close to it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import differential_evolution

import fjr_core as fjr
from core.oracles.chains import arm7, random_chain, scaled_gains
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.model.robot import JointLimits
from fjr_core.motions.domain import Domain, tube

CHAINS = [(1 + k % 7, k) for k in range(20)]


def law_of(n: int, seed: int) -> TrackingLaw:
    """Return v-dPBC for a random chain: ranges up to the circle, gains in the shape of the inertia at one position."""
    links, rng = random_chain(n, seed).links, np.random.default_rng((n, seed, 3))
    half = np.array([0.4 if body.prismatic else rng.uniform(0.3, np.pi) for body in links.bodies])
    middle, free = rng.uniform(-1, 1, n), np.full(n, np.inf)
    limits = JointLimits(middle - half, middle + half, free, free)
    M = links.M_l(middle).full()
    one = np.eye(n)
    prismatic = tuple(body.prismatic for body in links.bodies)
    robot = fjr.Robot(links, one, 1e3 * one, 0.1 * np.diag(np.diag(M)), 0 * one, one, limits, prismatic)
    K_ld = 5 * (M + np.diag(np.diag(M)) * rng.uniform(0, 1))
    gains = fjr.Gains(Lambda_l=500.0, Pi_l=20.0, K_ld=K_ld, Lambda_m=500.0, Pi_m=60.0, K_md=500.0)
    return TrackingLaw(robot, gains)


def smallest_rate(law: TrackingLaw) -> float:
    """Return the smallest rate that a global search over the joint range finds."""
    limits = law.robot.limits
    assert limits is not None
    found = differential_evolution(
        lambda q: law.rate([q]).beta,
        list(zip(limits.lower, limits.upper, strict=True)),
        seed=0,
        popsize=5,
        maxiter=10 * law.robot.n,
        tol=1e-8,
    )
    return float(found.fun)


def test_proven_rates_are_never_above_those_of_an_adversarial_search_and_close_to_them() -> None:
    laws = [law_of(*chain) for chain in CHAINS]
    proven = np.array([law.proven_rate(goal=0.9, most_boxes=200).beta for law in laws])
    found = np.array([smallest_rate(law) for law in laws])
    assert np.all(proven > 0)
    assert np.all(proven <= found)
    assert np.median(proven / found) >= 0.8


def test_rates_of_closed_forms_are_proven_with_their_value() -> None:
    for robot in (fjr.single_link(), fjr.planar_two_link()):
        law = fjr.TrackingLaw(robot, fjr.Gains(30.0, 20.0, 0.6, 30.0, 60.0, 0.3))
        exact, proven = law.rate(), law.proven_rate(goal=1 - 1e-8)
        assert exact.proven
        assert proven.proven
        for name in ("beta", "beta_paper", "beta_sigma_l"):
            assert getattr(exact, name) * (1 - 1e-6) <= getattr(proven, name) <= getattr(exact, name)


def test_rate_of_the_arm_is_proven_in_a_tube_around_a_motion() -> None:
    arm = arm7()
    law = fjr.TrackingLaw(arm.robot, scaled_gains(arm).gains)
    reference = fjr.Sine(0.3, np.pi, offset=[0.0, 0.5, 0.2, -1.2, -0.2, 0.8, 0.4])
    proven = law.proven_rate(tube(reference, 0.05), most_boxes=3)
    q_ld = reference.jets(np.linspace(0, 2, 50))[:, 0]
    inside = np.random.default_rng(0).uniform(q_ld - 0.05, q_ld + 0.05)
    assert proven.proven
    assert 0.5 * law.rate(q_ld).beta < proven.beta <= law.rate(inside).beta
    assert law.rate().proven is False


def test_an_early_end_returns_the_number_that_is_proven_by_then() -> None:
    law = law_of(3, 3)
    rates = [law.proven_rate(goal=0.99, most_boxes=boxes) for boxes in (1, 20, 400)]
    assert rates[0].beta <= rates[1].beta <= rates[2].beta
    assert all(each.beta <= (each.attained or 0) for each in rates)


@pytest.mark.parametrize("bad", [Domain(np.ones(2), np.zeros(2)), Domain(np.zeros(3), np.ones(3))])
def test_a_bad_domain_is_refused(bad: Domain) -> None:
    with pytest.raises(fjr.StateError, match="expected"):
        fjr.TrackingLaw(fjr.planar_two_link(), fjr.PAPER_GAINS).proven_rate(bad)


def test_a_tube_contains_the_reference_and_its_radius() -> None:
    for reference in (
        fjr.Sine([0.3, 0.2], [1.0, 2.0]),
        fjr.Sine([0.3, 0.2], [1.0, np.sqrt(2)]),
        fjr.PointToPoint([0.0, 1.0], [1.0, -1.0], 1.0, 2.0),
    ):
        domain = tube(reference, 0.1)
        for q in reference.jets(np.linspace(0, 40, 400))[:, 0]:
            for corner in (q - 0.1, q + 0.1):
                assert np.all((domain.lower <= corner) & (corner <= domain.upper))
                near = [domain.lower, domain.upper] if domain.near is None else domain.near
                boxes = np.reshape(near, (-1, 2, 2))
                assert np.any(np.all((boxes[:, 0] <= corner) & (corner <= boxes[:, 1]), axis=1))
