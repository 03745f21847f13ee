# SPDX-License-Identifier: Apache-2.0
"""Proven rates of sampled loops: below the simulated ones, absent beyond the delay margin, and wired to the gains.

The pieces of a reference cover its whole period, and every sample leads from one piece to a listed one.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import fjr_core as fjr
from fjr_proofs.sampled_contraction.proof import (
    final_radii,
    number_of_pieces,
    sampled_contraction,
    transitions_of,
    ultimate_radius,
)
from proofs.sampled_contraction.loops import FAST_SINE, errors, joint, two_link

H = 1e-3


def distance(law: fjr.TrackingLaw, reference: fjr.Sine, starts: list[np.ndarray], delay: float) -> np.ndarray:
    """Return the distances (k,) in V of two simulated solutions, 0.1 and 0.6 s after the start."""
    plant = fjr.Plant(law.robot)
    runs = [fjr.simulate(plant, law, reference, x, 0.6, H, 1e-3 / 8, delay * H) for x in starts]
    blocks = (law.gains.Pi_l, law.gains.Pi_m, law.robot.M_l(np.zeros(law.robot.n)), law.robot.M_m)
    roots = np.sqrt(np.concatenate([np.diag(block) for block in blocks]))
    ends = [[errors(law, run.x[k], run.jets[k]) for run in runs] for k in (100, 600)]
    return np.array([np.linalg.norm(roots * (a - b)) for a, b in ends])


@settings(max_examples=4, deadline=None, derandomize=True)
@given(
    scale=st.floats(0.6, 1.5),
    stiffness=st.floats(15.0, 60.0),
    delay=st.sampled_from([0.0, 0.4, 1.0]),
    seed=st.integers(0, 99),
)
def test_proven_rate_is_at_most_that_of_simulated_solutions(
    scale: float, stiffness: float, delay: float, seed: int
) -> None:
    gains = fjr.Gains(10.0 * scale, 20.0 * scale, 0.6 * scale, 15.0 * scale, 60.0 * scale, 0.3 * scale)
    law, rng = joint(gains, stiffness), np.random.default_rng(seed)
    found = sampled_contraction(law, FAST_SINE, H, (0.0, delay))
    assert found is not None
    assert found.rate > 0.5 * law.rate().beta
    start = law.robot.state(0.0, 0.0, 3.0, 3.0)
    starts = [start + 0.02 * rng.uniform(-1, 1, 4) * [1.0, 1.0, 0.1, 0.02] for _ in range(2)]
    early, late = distance(law, FAST_SINE, starts, delay)
    assert found.rate <= 1.02 * np.log(early / late) / 0.5


@pytest.mark.parametrize("delay", [0.0, 1.0])
def test_simulated_errors_end_below_the_proven_offset(delay: float) -> None:
    law = joint()
    found = sampled_contraction(law, FAST_SINE, H, (0.0, delay))
    assert found is not None
    run = fjr.simulate(
        fjr.Plant(law.robot), law, FAST_SINE, law.robot.state(0.0, 0.0, 3.0, 3.0), 2.5, H, H / 8, delay * H
    )
    seen = np.abs(run.x[1500:, 0] - run.jets[1500:, 0, 0]).max()
    assert 0.1 * found.offset[0] < seen < found.offset[0] < found.tube[0]


def test_rate_falls_with_the_delay_and_changes_with_a_gain() -> None:
    rates = [
        sampled_contraction(joint(replace(fjr.PAPER_GAINS, K_ld=K_ld)), FAST_SINE, H, (0.0, delay)).rate  # type: ignore[union-attr]
        for K_ld, delay in ((0.6, 0.0), (0.6, 1.0), (0.3, 0.0))
    ]
    assert rates[0] > 1.001 * rates[1]
    assert rates[0] != pytest.approx(rates[2], rel=1e-3)


@pytest.mark.parametrize("period", [5e-3, 6e-3])
def test_a_delay_beyond_the_margin_is_not_proven(period: float) -> None:
    law = joint()
    configurations = FAST_SINE.configurations(16)
    margin = fjr.check(law, period, configurations=configurations).delay_margin
    assert 0 < margin < 1
    assert sampled_contraction(law, FAST_SINE, period, (margin + 0.02, margin + 0.02)) is None
    assert sampled_contraction(law, FAST_SINE, period, (0.0, 0.6 * margin)) is not None


def test_a_reference_at_rest_is_proven_at_the_rate_of_the_linear_loop() -> None:
    law, reference = joint(), fjr.Sine(0.0, 1.0, 0.4)
    found = sampled_contraction(law, reference, H)
    linear = -np.log(fjr.check(law, H, configurations=[[0.4]]).spectral_radius) / H
    assert found is not None
    assert 0.7 * linear < found.rate <= linear
    assert found.offset[0] < 1e-12


def test_the_tube_of_a_linear_loop_ends_at_the_largest_that_is_searched() -> None:
    law = fjr.TrackingLaw(fjr.single_link(gravity_torque=0.0), fjr.PAPER_GAINS)
    found = sampled_contraction(law, FAST_SINE, H)
    assert found is not None
    assert 1.0 < found.tube[0] < 5.0


def test_gains_that_are_unstable_as_sampled_are_not_proven() -> None:
    hard = replace(fjr.PAPER_GAINS, K_md=30.0)
    assert sampled_contraction(joint(hard), FAST_SINE, H) is None


def test_two_links_contract_on_a_tube_about_a_short_motion() -> None:
    law = two_link()
    found = sampled_contraction(law, fjr.Sine([0.1, 0.1], [10.0, 10.0], [0.3, 0.0]), H)
    assert found is not None
    assert found.rate > law.rate().beta
    assert np.all((found.offset < found.tube) & (found.tube < 0.1))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((joint(), fjr.Spline([0.0, 1.0], [[0.0], [1.0]]), H), "expected sines"),
        ((two_link(), fjr.Sine(0.1, [1.0, np.sqrt(2)]), H), "expected a common period"),
        ((joint(), fjr.Sine(0.1, 0.01), H), "expected 3 to 30000"),
        ((joint(), fjr.Sine(0.1, 3500.0), H), "has 2 samples in its period"),
        ((joint(), FAST_SINE, H, (0.5, 1.5)), "delay is 0.5 to 1.5 samples; expected within 0 and 1"),
    ],
)
def test_what_the_proof_does_not_cover_is_refused(arguments: tuple[Any, ...], words: str) -> None:
    with pytest.raises(fjr.FjrError, match=words):
        sampled_contraction(*arguments)


@pytest.mark.parametrize("samples", [3, 17, 500, 29_999])
@pytest.mark.parametrize("excess", [-1e-15, 0.0, 1e-15, 5e-13, 0.3, 0.999])
def test_pieces_cover_the_period_in_spite_of_rounding(samples: int, excess: float) -> None:
    period = samples * H * (1 + excess / samples if abs(excess) > 0.1 else 1 + excess)
    pieces = number_of_pieces(period, H)
    assert pieces * Fraction(H) >= Fraction(period)
    assert (pieces - 2) * Fraction(H) < Fraction(period)


@pytest.mark.parametrize("rest", [Fraction(1, 1000), Fraction(1, 2), Fraction(1)])
def test_every_sample_of_many_periods_is_a_listed_transition(rest: Fraction) -> None:
    pieces = 7
    period = pieces - 1 + rest
    visited = [int(k % period) for k in range(5000)]
    listed = set(zip(*(each.tolist() for each in transitions_of(pieces)), strict=True))
    assert set(zip(visited[:-1], visited[1:], strict=True)) <= listed


def test_solutions_end_in_the_final_balls_after_periods_of_either_length() -> None:
    rng = np.random.default_rng(0)
    rho, displacement = rng.uniform(0.5, 0.95, 9), rng.uniform(0.0, 1.0, 9)
    before, after = transitions_of(8)
    radii = final_radii(rho, displacement)
    bound, piece = 10 * ultimate_radius(rho, displacement), 0
    for k in range(3000):
        choices = np.flatnonzero(before == piece)
        transition = rng.choice(choices)
        bound, piece = rho[transition] * bound + displacement[transition], int(after[transition])
        assert k < 500 or bound <= radii[piece] * (1 + 1e-9)
