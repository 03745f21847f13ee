# SPDX-License-Identifier: Apache-2.0
"""Proven rates of sampled loops: pairs of simulated motions approach as fast; absent beyond the delay margin."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import fjr_core as fjr
from bench.build import chain_urdf, joint_names
from bench.error_bound import on_reference
from fjr_core.numerics.checks import Array
from fjr_proofs.error_bound import SampledContraction, sampled_contraction
from fjr_proofs.error_bound.cells import cells_of
from fjr_proofs.error_bound.linear_loop import CellModels, peak_gains
from proofs.error_bound.test_error_bound import STILL, joint, two_link

H = 1e-3
FAST_SINE = fjr.Sine(0.1, 25.0)  # a period of 251.3 samples
SHORT = fjr.Sine([0.1, 0.1], [10.0, 10.0], [0.3, 0.0])
PAPER, TWO_LINKS = joint(), two_link()
CHANGING = (0.0, 1.0)  # samples, between which a delay changes from sample to sample
MEAN = (0.5, 0.5)


def late_runs(law: fjr.TrackingLaw, reference: fjr.Sine, starts: Array, delays: Array, period: float) -> Array:
    """Return the states (k + 1, runs, 4n) at the samples of runs from `starts`; delays (k,) of efforts [samples]."""
    plant, states = fjr.Plant(law.robot), [np.array(starts)]
    held = [law.command(x, reference.jets(0.0)) for x in starts]
    for k, late in enumerate(delays):
        now = [law.command(x, reference.jets(period * k)) for x in states[-1]]
        x = states[-1]
        for efforts, duration in ((held, late * period), (now, (1 - late) * period)):
            if duration:
                x = np.array([plant.step(each, u, duration) for each, u in zip(x, efforts, strict=True)])
        states.append(x)
        held = now
    return np.array(states)


def paper_scaled(scale: float, stiffness: float) -> fjr.TrackingLaw:
    gains = fjr.Gains(10.0 * scale, 20.0 * scale, 0.6 * scale, 15.0 * scale, 60.0 * scale, 0.3 * scale)
    return fjr.TrackingLaw(fjr.single_link(stiffness=stiffness), gains)


@cache
def contraction(law: fjr.TrackingLaw, reference: fjr.Sine, delays: tuple[float, float]) -> SampledContraction:
    """Return what is proven of a loop at 1 kHz."""
    found = sampled_contraction(law, reference, H, delays)
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("law", "delays"),
    [
        pytest.param(PAPER, MEAN, id="a constant delay"),
        pytest.param(PAPER, CHANGING, id="delays that change"),
        pytest.param(paper_scaled(0.7, 50.0), (0.4, 0.4), id="smaller gains", marks=pytest.mark.full),
        pytest.param(paper_scaled(1.3, 20.0), CHANGING, id="larger gains", marks=pytest.mark.full),
    ],
)
def test_pairs_of_motions_in_the_tube_approach_at_the_proven_rate(
    law: fjr.TrackingLaw, delays: tuple[float, float]
) -> None:
    found = contraction(law, FAST_SINE, delays)
    assert found.rate > 0.5 * law.rate().beta
    check_pairs(law, FAST_SINE, found.rate, 0.1 * found.tube[0], delays, seed=0)


def test_delays_that_change_leave_larger_errors_than_their_mean() -> None:
    changing, constant = (contraction(PAPER, FAST_SINE, delays) for delays in (CHANGING, MEAN))
    assert np.all(changing.offset > 1.1 * constant.offset)


def check_pairs(
    law: fjr.TrackingLaw,
    reference: fjr.Sine,
    rate: float,
    size: float,
    delays: tuple[float, float],
    seed: int,
    period: float = H,
) -> None:
    """Check that two motions, with the same delays from sample to sample, approach at a rate from sample 100 to 600."""
    n, rng = law.robot.n, np.random.default_rng(seed)
    x0 = law.robot.state(*on_reference(law.robot, reference)[:4])
    q, dq = x0[: 2 * n], law.robot.velocities(x0)
    apart = size * rng.uniform(-1, 1, (2, n))
    starts = np.array([law.robot.state(*np.split(q + np.tile(e, 2), 2), *dq) for e in apart])
    states = late_runs(law, reference, starts, rng.uniform(*delays, 600), period)
    distances = [np.linalg.norm(np.concatenate([x[0, : 2 * n] - x[1, : 2 * n]])) for x in (states[100], states[600])]
    assert rate <= 1.02 * np.log(distances[0] / distances[1]) / (500 * period)


@pytest.mark.full
def test_two_links_contract_on_a_tube_about_a_short_motion() -> None:
    found = contraction(TWO_LINKS, SHORT, CHANGING)
    assert found.rate > TWO_LINKS.rate().beta
    assert np.all(found.tube < 0.1)
    check_pairs(TWO_LINKS, SHORT, found.rate, 0.5 * found.tube.min(), CHANGING, seed=1)


def test_three_joints_of_a_description_contract() -> None:
    robot = fjr.robot_from_urdf(chain_urdf(3), joint_names(3), stiffness=2000.0, motor_inertia=0.3)
    M, B = np.diag(robot.M_l(np.full(3, 0.5))), np.diag(robot.M_m)
    law = fjr.TrackingLaw(robot, fjr.Gains(4.0, 16.0 * M, 8.0 * M, 6.0, np.diag(robot.K), 8.0 * B), compile=True)
    reference, period = fjr.Sine(0.02, 4 * np.pi, [0.2, 0.4, 0.3]), 4e-3
    found = sampled_contraction(law, reference, period)
    assert found is not None
    assert found.rate > 3.0
    check_pairs(law, reference, found.rate, 0.5 * found.tube.min(), (0.0, 0.0), seed=2, period=period)


@pytest.mark.parametrize(
    ("law", "reference"),
    [
        pytest.param(PAPER, fjr.Sine(0.3, 4 * np.pi), id="500 samples a period", marks=pytest.mark.full),
        pytest.param(PAPER, FAST_SINE, id="samples beside the period"),
        pytest.param(TWO_LINKS, SHORT, id="two links", marks=pytest.mark.full),
    ],
)
def test_starts_on_the_corners_of_the_tube_end_below_the_offset(law: fjr.TrackingLaw, reference: fjr.Sine) -> None:
    """The delay changes from sample to sample; without it the largest error that remains would be smaller."""
    found, n = contraction(law, reference, CHANGING), law.robot.n
    x0 = law.robot.state(*on_reference(law.robot, reference)[:4])
    q, dq = x0[: 2 * n], law.robot.velocities(x0)
    corners = found.tube * np.stack(np.meshgrid(*[[-1.0, 1.0]] * n), axis=-1).reshape(-1, n)
    starts = np.array([law.robot.state(*np.split(q + np.tile(corner, 2), 2), *dq) for corner in corners])
    samples = np.arange(1400, 1601)
    states = late_runs(law, reference, starts, np.random.default_rng(3).uniform(0.0, 1.0, samples[-1]), H)
    errors = np.abs(states[samples, :, :n] - reference.jets(H * samples)[:, None, 0])
    assert np.all(errors.max(axis=(0, 1)) < found.offset)
    assert np.any(errors.max(axis=(0, 1)) > 0.02 * found.offset)


def test_a_delay_beyond_the_margin_is_not_proven() -> None:
    law, period = joint(), 5e-3
    margin = fjr.check(law, period, configurations=FAST_SINE.configurations(16)).delay_margin
    assert 0 < margin < 1
    assert sampled_contraction(law, FAST_SINE, period, (margin + 0.02, margin + 0.02)) is None
    assert sampled_contraction(law, FAST_SINE, period, (0.6 * margin, 0.6 * margin)) is not None


@pytest.mark.parametrize("K_ld", [0.6, 0.3])
def test_a_reference_at_rest_is_proven_at_the_rate_of_the_linear_loop(K_ld: float) -> None:
    law = fjr.TrackingLaw(fjr.single_link(), replace(fjr.PAPER_GAINS, K_ld=K_ld))
    found = sampled_contraction(law, STILL, H)
    linear = -np.log(fjr.check(law, H, configurations=[[0.0]]).spectral_radius) / H
    assert found is not None
    assert 0.7 * linear < found.rate <= linear
    assert found.offset[0] < 1e-12


def test_the_tube_of_a_linear_loop_ends_at_the_largest_that_is_searched() -> None:
    found = sampled_contraction(joint(gravity=0.0), FAST_SINE, H)
    assert found is not None
    assert 1.0 < found.tube[0] < 5.0


def test_gains_that_are_unstable_as_sampled_are_not_proven() -> None:
    hard = fjr.TrackingLaw(fjr.single_link(), replace(fjr.PAPER_GAINS, K_md=30.0))
    assert sampled_contraction(hard, FAST_SINE, H) is None


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((joint(), fjr.Spline([0.0, 1.0], [[0.0], [1.0]]), H), "expected sines"),
        ((two_link(), fjr.Sine(0.1, [1.0, np.sqrt(2)]), H), "neither a common period nor an end within 60 s"),
        ((joint(), FAST_SINE, H, (0.5, 1.5)), "delay is 0.5 to 1.5 samples; expected within 0 and 1"),
        ((joint(), FAST_SINE, H, 1.5), "delay is 1.5 to 1.5 samples; expected within 0 and 1"),
        ((joint(), FAST_SINE, H, (0.0, 0.5, 1.0)), r"delays has shape \(3,\); expected a scalar or \(2,\)"),
    ],
)
def test_what_the_proof_does_not_cover_is_refused(arguments: tuple[Any, ...], words: str) -> None:
    with pytest.raises(fjr.FjrError, match=words):
        sampled_contraction(*arguments)


# Peak gains in closed form: geometric series, and a direct sum for matrices that change.

T = 0.01
CELLS = cells_of(fjr.Sine(1.0, 2 * np.pi), T, verified=True)  # 100 cells of one sample
ALL = np.arange(CELLS.count)


def models(loop: np.ndarray, torque: np.ndarray, effort: np.ndarray, output: np.ndarray) -> CellModels:
    """Return models (c, ..) whose torque acts alike during a sample."""
    return CellModels(loop, torque, torque, 0 * torque, effort, output)


@pytest.mark.parametrize("a", [0.9, -0.9])
@pytest.mark.parametrize("blocks", [3, 40])
def test_gains_of_a_scalar_loop_are_geometric_series(a: float, blocks: int) -> None:
    """1 + |a| + |a|^2 + .., however few of its terms are summed."""
    loop, torque, effort, output = (np.full((CELLS.count, 1, 1), value) for value in (a, 3.0, 0.5, 2.0))
    gains = peak_gains(models(loop, torque, effort, output), CELLS, T, blocks, ALL)
    whole = 1 / (1 - abs(a))
    state = [3.0 * T * whole, 0.5 * whole]
    assert gains[0, :2] == pytest.approx(state, rel=1e-8)
    assert gains[1, :2] == pytest.approx(2 * np.array(state), rel=1e-8)


def test_a_sum_over_changing_matrices_is_that_of_the_worst_end() -> None:
    rng = np.random.default_rng(0)
    S, m, n = 3, 2, 1
    loop = 0.4 * rng.uniform(-1, 1, (CELLS.count, S, S))
    torque, effort = rng.uniform(-1, 1, (CELLS.count, S, m)), rng.uniform(-1, 1, (CELLS.count, S, n))
    gains = peak_gains(models(loop, torque, effort, loop), CELLS, T, 60, ALL)
    sums = np.zeros((CELLS.count, S, m + n))
    for final in ALL:
        X = np.eye(S)
        for lag in range(200):
            i = (final - lag) % CELLS.count
            sums[final] += np.abs(np.hstack([T * X @ torque[i], X @ effort[i]]))
            X = X @ loop[i]
    assert gains[:S, : m + n] == pytest.approx(sums.max(axis=0), rel=1e-6)


def test_a_loop_that_does_not_contract_has_no_gains() -> None:
    one = np.ones((CELLS.count, 1, 1))
    assert np.all(np.isinf(peak_gains(models(one, one, one, one), CELLS, T, 10, ALL)))
