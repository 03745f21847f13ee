# SPDX-License-Identifier: Apache-2.0
"""The pieces of a reference cover its whole period, and every sample leads from one piece to a listed one."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from fjr_proofs.sampled_contraction.pieces import final_radii, number_of_pieces, transitions_of, ultimate_radius

H = 1e-3


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
