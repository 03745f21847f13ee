# SPDX-License-Identifier: Apache-2.0
"""Bounds of one sample hold for solutions that SciPy integrates, in any metric and for every delay."""

from __future__ import annotations

import numpy as np
import pytest

import fjr_core as fjr
from fjr_proofs.sampled_contraction.error_system import ErrorSystem
from fjr_proofs.sampled_contraction.metric import Metric, source
from fjr_proofs.sampled_contraction.one_sample import OneSample
from proofs.sampled_contraction.loops import CUBIC, joint, one_sample, two_link

H = 1e-3
CASES = {
    "joint": (joint(), fjr.Sine(1.0, 2.0), 0.5, (0.0, 1.0)),
    "joint without delay": (joint(), fjr.Sine(1.0, 2.0), 2.0, (0.0, 0.0)),
    "cubic": (joint(CUBIC), fjr.Sine(1.0, 2.0), 0.1, (0.3, 0.5)),
    "two links": (two_link(), fjr.Sine([0.5, 0.7], [2.0, 3.0], [0.3, 0.0]), 0.003, (0.0, 1.0)),
    "two links, one delay": (two_link(), fjr.Sine([0.5, 0.7], [2.0, 3.0], [0.3, 0.0]), 0.003, (0.7, 0.7)),
    "two links without delay": (two_link(), fjr.Sine([0.5, 0.7], [2.0, 3.0], [0.3, 0.0]), 0.01, (0.0, 0.0)),
}


@pytest.mark.parametrize("name", CASES)
def test_pairs_of_solutions_and_the_centre_move_within_the_bounds(name: str) -> None:
    law, reference, radius, (least, longest) = CASES[name]
    rng, n = np.random.default_rng(8), law.robot.n
    sample = OneSample(ErrorSystem(law), reference, H, least, longest)
    index = np.array([0, 700, 1900])
    s, centre = sample.states, np.zeros((3, 5 * n))
    centre[:, :s] = 1e-4 * rng.standard_normal((3, s))
    q_l = reference.jets(H * index)[:, 0]
    weighted = source(law, q_l, H, 1e3 if longest else None)
    metric, after = Metric.of(weighted), Metric.of(1.1 * weighted)
    pieces, next_centre = sample.pieces(index, centre), 0.5 * centre
    rho = sample.factors(pieces, metric, after, radius)
    moved = sample.displacement(pieces, after, next_centre)
    reached = sample.flow(pieces, metric.extent(radius)).reached[: 4 * n]
    assert np.all(np.isfinite(rho))
    assert np.all(rho < 1.5)
    closest = 0.0
    for k in (0, 1, 2):
        for _ in range(3):
            t, tau = H * (index[k] + rng.uniform()), H * rng.choice([least, rng.uniform(least, longest), longest])
            y = rng.standard_normal((2, s))
            y *= radius / np.linalg.norm(y, axis=1)[:, None]
            starts = np.zeros((3, 5 * n))
            starts[:2, :s] = y @ metric.V[k].T
            first, second, third = (
                one_sample(sample.system, centre[k] + start, reference, t, H, tau)[:s] for start in starts
            )
            bound = rho[k] * np.linalg.norm(metric.W[k] @ (starts[0] - starts[1])[:s])
            seen = np.linalg.norm(after.W[k] @ (first - second))
            assert seen <= bound
            assert np.linalg.norm(after.W[k] @ (third - next_centre[k, :s])) <= moved[k]
            closest = max(closest, seen / bound)
        start = centre[k] + starts[0]
        between = one_sample(sample.system, start, reference, t, H / 2, min(tau, H / 2)) - centre[k]
        assert np.all(np.abs(between[: 4 * n]) <= reached[:, k])
    assert closest > 0.5
