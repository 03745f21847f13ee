# SPDX-License-Identifier: Apache-2.0
"""The prolonged system, its differential storage, and convergence of virtual solutions."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

import fjr_core as fjr
from core.oracles.cases import LOOP_NAMES, LOOPS, Arm, GainSet, Point, cubic, linear, planar, random_point, single
from core.oracles.oracle import inverse, jacobian, stencil
from core.oracles.properties import TOLERANCE, closed_form, coordinate_steps, loop_of, metric, residual
from fjr_core.errors import StateError
from fjr_core.numerics.symbolic import NumericFunction
from fjr_design.stability.contraction import Contraction, Measured, contraction, scattered
from fjr_design.stability.prolonged_system import ProlongedSystem

loops = pytest.mark.parametrize(("arm", "gains"), LOOPS, ids=LOOP_NAMES)
seeds = pytest.mark.parametrize("seed", range(3))


def direction(arm: Arm, seed: int) -> np.ndarray:
    return np.random.default_rng(40 + seed).uniform(-1, 1, 4 * arm.n) * np.repeat([1, 1, 0.1, 0.05], arm.n)


@loops
@seeds
def test_the_prolonged_system_is_the_closed_loop_and_its_derivative(arm: Arm, gains: GainSet, seed: int) -> None:
    """Equations (38) and (28) agree with differences of VirtualSystem.derivative and TrackingLaw.effort."""
    loop, p, delta = loop_of(arm, gains), random_point(arm, seed), direction(arm, seed)

    def field(x_v: np.ndarray) -> np.ndarray:
        return loop.virtual.derivative(x_v, p.x, loop.law.effort(x_v, p.x, p.jets))

    dx_v, d_delta = NumericFunction(ProlongedSystem(loop.law).function)(p.x_v, p.x, delta, p.jets)
    assert residual(dx_v, field(p.x_v)) <= TOLERANCE
    assert residual(d_delta, stencil(lambda s: field(p.x_v + s * delta), 0.03)) <= TOLERANCE


def storage_by_hand(arm: Arm, gains: GainSet, p: Point, delta: np.ndarray) -> float:
    """Return delta_e' P delta_e / 2 with Theta by differences."""
    loop = loop_of(arm, gains)
    Theta = jacobian(lambda y: loop.errors(y, p.x, p.jets), p.x_v, coordinate_steps(loop, p))
    delta_e = Theta @ delta
    return float(delta_e @ metric(loop, p)[0] @ delta_e) / 2


@loops
@seeds
def test_differential_storage_is_that_of_the_error_variation(arm: Arm, gains: GainSet, seed: int) -> None:
    p, delta = random_point(arm, seed), direction(arm, seed)
    W = ProlongedSystem(loop_of(arm, gains).law).storage(p.x_v, p.x, delta, p.jets)[0]
    assert pytest.approx(storage_by_hand(arm, gains, p, delta), rel=1e-8) == W


@loops
@seeds
def test_rate_of_the_differential_storage_is_exact(arm: Arm, gains: GainSet, seed: int) -> None:
    """dW/dt along plant, virtual closed loop and variation, by differences, for any u of the plant."""
    loop, p, delta = loop_of(arm, gains), random_point(arm, seed), direction(arm, seed)
    system = ProlongedSystem(loop.law)
    dx = loop.plant.derivative(p.x, p.u)
    dx_v, d_delta = NumericFunction(system.function)(p.x_v, p.x, delta, p.jets)
    fastest = float(np.max(np.abs([dx[: 2 * arm.n], dx_v[: 2 * arm.n]])))

    def along(s: float) -> float:
        return system.storage(p.x_v + s * dx_v, p.x + s * dx, delta + s * d_delta, p.jets + s * p.djets)[0]

    W, dW = system.storage(p.x_v, p.x, delta, p.jets)
    measured = float(stencil(along, 0.004 / max(1.0, fastest)))
    assert abs(measured - dW) <= 1e-8 * (abs(dW) + W)
    assert dW <= -2 * loop.law.rate().beta * W * (1 - 1e-9)


@loops
def test_norm_in_metric_coordinates_is_that_of_P(arm: Arm, gains: GainSet) -> None:
    loop, p = loop_of(arm, gains), random_point(arm, 1)
    system, e = ProlongedSystem(loop.law), loop.errors(p.x_v, p.x, p.jets)
    M = closed_form(loop, p)[0]
    parts = zip(np.split(e, 4), (gains.Pi_l, gains.Pi_m, inverse(M), inverse(arm.M_m)), strict=True)
    assert np.sum(system.in_metric(e, p.x) ** 2) == pytest.approx(sum(part @ P @ part for part, P in parts), rel=1e-12)
    np.testing.assert_array_equal(system.errors(p.x_v, p.x, p.jets), e)


def along_a_run(arm: Arm, gains: fjr.Gains, duration: float = 1.5, m: int = 5) -> Contraction:
    """Return virtual solutions along a run of the law at 1 kHz."""
    law = fjr.TrackingLaw(arm.robot, gains)
    reference = fjr.Sine(np.linspace(1.0, 0.6, arm.n), np.linspace(1.0, 1.7, arm.n))
    x0 = arm.robot.state(*(np.full(arm.n, value) for value in (0.5, 0.5, 0.0, 0.0)))
    run = fjr.simulate(fjr.Plant(arm.robot), law, reference, x0, duration, sample_period=1e-3)
    return contraction(law, reference, Measured(run.t, run.x, run.u), scattered(law, x0, m, 0.5))


RUNS = {
    "Table 1, k = 31": (single(31.0), fjr.PAPER_GAINS),
    "Table 1, k = 3.1": (single(3.1), fjr.PAPER_GAINS),
    "cubic": (single(31.0), cubic(1).gains),
    "two links": (planar("31", 31.0), linear(2).gains),
}


@pytest.mark.parametrize(("arm", "gains"), RUNS.values(), ids=RUNS)
def test_distances_stay_below_their_exponential_bound(arm: Arm, gains: fjr.Gains) -> None:
    found = along_a_run(arm, gains)
    relative = found.distance / found.distance[0]
    assert relative.shape == (len(found.t), len(list(combinations(range(5), 2))))
    assert found.proven
    rounding = 1e-11
    assert np.all(relative <= found.bound[:, None] * (1 + 1e-6) + rounding)
    assert np.max(relative[-1]) < 1e-4
    assert np.all(found.W[0] * found.bound[:, None] ** 2 * (1 + 1e-6) + rounding * found.W[0] >= found.W)
    assert np.nanmin(found.rate[found.bound > 1e-4]) >= found.beta * (1 - 1e-9)


def test_integrated_storage_agrees_with_its_exact_rate() -> None:
    assert along_a_run(single(31.0), fjr.PAPER_GAINS, duration=0.3).balance < 5e-3


def test_virtual_solutions_converge_to_the_measured_one_up_to_the_hold() -> None:
    found = along_a_run(single(31.0), fjr.PAPER_GAINS)
    assert np.all(found.to_measured[0] > 0.1)
    assert np.all(found.to_measured[-1] < 1e-2)


def test_progress_is_reported() -> None:
    progress: list[float] = []
    law, reference = fjr.TrackingLaw(fjr.single_link(), fjr.PAPER_GAINS), fjr.Sine(1.0, 1.0)
    run = fjr.simulate(fjr.Plant(law.robot), law, reference, np.zeros(4), 0.01, sample_period=1e-3)
    starts = scattered(law, run.x[0], 2, 0.1)
    contraction(law, reference, Measured(run.t, run.x, run.u), starts, on_progress=progress.append)
    np.testing.assert_allclose(progress, run.t[1:])


def test_inconsistent_input_is_refused() -> None:
    law, reference = fjr.TrackingLaw(fjr.single_link(), fjr.PAPER_GAINS), fjr.Sine(1.0, 1.0)
    with pytest.raises(StateError, match="two increasing instants"):
        Measured(np.zeros(2), np.zeros((2, 4)), np.zeros((2, 1)))
    measured = Measured(np.arange(3) * 1e-3, np.zeros((3, 4)), np.zeros((3, 1)))
    with pytest.raises(StateError, match="starts have shape"):
        contraction(law, reference, measured, np.zeros((1, 4)))
