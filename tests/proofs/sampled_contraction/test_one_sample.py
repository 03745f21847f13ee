# SPDX-License-Identifier: Apache-2.0
"""The error system is the plant under a held effort, seen in the errors of the law; bounds of one sample of it hold.

They hold for solutions that SciPy integrates, in any metric and for every delay.
"""

from __future__ import annotations

import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.numerics.intervals import Interval
from fjr_proofs.sampled_contraction.error_system import ErrorSystem
from fjr_proofs.sampled_contraction.one_sample import OneSample, PiecewiseMetric
from fjr_proofs.sampled_contraction.proof import source
from fjr_proofs.verification.taylor_models import NUMBER, TaylorModels
from proofs.sampled_contraction.loops import CUBIC, derivatives, errors, joint, one_sample, state, two_link

LAWS = {"joint": joint(), "cubic": joint(CUBIC), "two links": two_link()}
STEP = 1e-5


def reference_of(law: fjr.TrackingLaw) -> fjr.Sine:
    return fjr.Sine([0.5, 0.7][: law.robot.n], [2.0, 3.0][: law.robot.n], 0.3)


@pytest.mark.parametrize("name", LAWS)
def test_field_is_the_derivative_of_the_errors_along_the_plant(name: str) -> None:
    law = LAWS[name]
    system, plant, reference, n = ErrorSystem(law), fjr.Plant(law.robot), reference_of(law), law.robot.n
    rng = np.random.default_rng(2)
    for t in rng.uniform(0, 6, 5):
        chi = rng.uniform(-0.2, 0.2, 5 * n)
        x = state(system, chi, reference, t)
        assert errors(law, x, reference.jets(t)) == pytest.approx(chi[: 4 * n], abs=1e-12)
        held = law.command(x, reference.jets(t)) + chi[4 * n :]
        moved = [plant.step(x, held, dt) for dt in (-STEP, STEP)]
        ends = [
            np.append(errors(law, y, jets), held - law.command(y, jets))
            for y, jets in zip(moved, reference.jets(np.array([t - STEP, t + STEP])), strict=True)
        ]
        expected = (ends[1] - ends[0]) / (2 * STEP)
        found = system.field.function(chi, derivatives(reference, t)).full().ravel()
        assert found == pytest.approx(expected, rel=1e-6, abs=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("name", LAWS)
def test_jacobian_and_curvature_enclose_differences_of_the_field(name: str) -> None:
    law = LAWS[name]
    system, reference, m = ErrorSystem(law), reference_of(law), 5 * law.robot.n
    rng = np.random.default_rng(4)
    chi, t, radius = rng.uniform(-0.1, 0.1, m), 1.3, 1e-3
    box = Interval(chi[:, None], np.full((m, 1), radius))
    models = TaylorModels.sines(reference, np.array([t]), radius, 7, NUMBER).values
    jets = Interval(models[..., 0].T, models[..., 1].T)
    D, (H, by_time) = system.jacobian.on_intervals(box, jets)[0], system.curvature(box, jets)

    def slope(at: np.ndarray, when: float) -> np.ndarray:
        d = 1e-6 * np.eye(m)
        at_jets = derivatives(reference, when)
        columns = [
            system.field.function(at + e, at_jets).full() - system.field.function(at - e, at_jets).full() for e in d
        ]
        return np.hstack(columns)[system.pattern] / 2e-6

    for _ in range(10):
        inside, when = chi + radius * rng.uniform(-1, 1, m), t + radius * rng.uniform(-1, 1)
        there, centre = slope(inside, when), slope(chi, t)
        tolerance = 1e-6 * np.abs(centre).max()
        assert np.all(np.abs(there - D.mid[:, 0]) <= D.rad[:, 0] + tolerance)
        change = inside - chi
        expected = np.tensordot(change, H.mid[:, :, 0], axes=1) + (when - t) * by_time.mid[:, 0]
        reach = np.tensordot(np.abs(change), H.rad[:, :, 0], axes=1) + abs(when - t) * by_time.rad[:, 0]
        assert np.all(np.abs(there - centre - expected) <= reach + tolerance)


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
    metric, after = PiecewiseMetric.of(weighted), PiecewiseMetric.of(1.1 * weighted)
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
