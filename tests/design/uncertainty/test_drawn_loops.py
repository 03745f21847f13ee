# SPDX-License-Identifier: Apache-2.0
"""Sampled loops with drawn plants: as the check of one plant, and what a number of draws shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.law.linearized import equilibria_at
from fjr_core.robust.law import Robust, sampled_law
from fjr_core.stability.linear_controller import Sensing, controller
from fjr_core.stability.linearization import on_plant
from fjr_design.stability.sampled_loop import contracting
from fjr_design.tuning.gain_synthesis import gain_search
from fjr_design.uncertainty.drawn_loops import (
    DrawnLoops,
    DrawnPlants,
    draws_needed,
    in_common,
    largest_share,
)

ROBOT = fjr.planar_two_link()
CONFIGURATIONS = np.array([[0.0, 0.0], [0.5, -1.0], [1.0, 2.0]])
T = 1e-3


def drawn(count: int, spread: float, delay: float = 0.0) -> DrawnPlants:
    rng = np.random.default_rng(5)
    factors = np.exp(spread * rng.standard_normal((4, count, 2)))
    own = [np.diag(each) for each in (ROBOT.K, ROBOT.M_m, ROBOT.D_l, ROBOT.D_m)]
    return DrawnPlants(*(f * d for f, d in zip(factors, own, strict=True)), delay * rng.random(count))


LAWS = {
    "static": (lambda law: law, Sensing()),
    "integral action and observer": (lambda law: sampled_law(law, Robust(integral_gain=2.0)), Sensing(bandwidth=200.0)),
    "torque sensors": (lambda law: law, Sensing(by_torque=True)),
}


@pytest.mark.parametrize("name", LAWS)
def test_each_drawn_loop_has_the_radius_of_the_check_of_its_plant(name: str) -> None:
    wrapped, sensing = LAWS[name]
    gains = fjr.synthesize(ROBOT, 5.0, T, configurations=CONFIGURATIONS)
    law = wrapped(fjr.TrackingLaw(ROBOT, gains))
    own, plants = equilibria_at(ROBOT, CONFIGURATIONS), drawn(6, 0.3, delay=2.5e-3)
    loops = DrawnLoops(law, own, T, 0.4e-3, sensing)
    radii, at = loops.radii(plants), controller(law, own, sensing)
    for k in range(len(plants)):
        matrices = (np.diag(getattr(plants, part)[k]) for part in ("stiffness", "motor_inertia", "link_damping"))
        K, M_m, D_l = matrices
        robot = replace(ROBOT, K=K, M_m=M_m, D_l=D_l, D_m=np.diag(plants.motor_damping[k]))
        expected = on_plant(at, own, equilibria_at(robot, CONFIGURATIONS), sensing).radii(T, 0.4e-3 + plants.delay[k])
        assert radii[k] == pytest.approx(expected, rel=1e-6)
    assert np.array_equal(loops.unstable(plants), radii.max(axis=1) >= 1)


def test_maps_contract_if_their_spectral_radius_is_below_one() -> None:
    rng = np.random.default_rng(1)
    maps = rng.standard_normal((200, 6, 6))
    radii = np.abs(np.linalg.eigvals(maps)).max(axis=1)
    wanted = np.repeat([0.5, 0.999, 0.9999999, 1.0000001, 1.1], 40)
    maps *= (wanted / radii)[:, None, None]
    assert np.array_equal(contracting(maps), wanted < 1)


def test_gains_are_stable_for_all_drawn_plants_or_refused() -> None:
    plants = drawn(60, 0.25)
    gains = fjr.synthesize(ROBOT, 5.0, T, configurations=CONFIGURATIONS, plants=plants)
    loops = DrawnLoops(fjr.TrackingLaw(ROBOT, gains), equilibria_at(ROBOT, CONFIGURATIONS), T, 0.0)
    assert not loops.unstable(plants).any()
    late = replace(plants.at(slice(0, 2)), delay=np.full(2, 0.03))
    assert gain_search(ROBOT, T, 0.0, CONFIGURATIONS).best(5.0) is not None
    with pytest.raises(fjr.GainsError, match="out of reach for all 2 drawn plants"):
        fjr.synthesize(ROBOT, 5.0, T, configurations=CONFIGURATIONS, plants=late)


def test_gains_hold_where_drawn_plants_are_worst_not_only_where_their_own_model_is() -> None:
    where, rng = np.random.default_rng(2).uniform(-3, 3, (150, 2)), np.random.default_rng(1)
    plants = drawn(40, 0.0)
    plants = replace(plants, motor_inertia=plants.motor_inertia * 4 ** rng.uniform(-1, 1, (40, 2)))
    search = gain_search(ROBOT, T, 0.0, where)
    gains = search.best(5.0)
    assert gains is not None
    lost = search.lost(gains, plants)
    everywhere = DrawnLoops(fjr.TrackingLaw(ROBOT, gains), equilibria_at(ROBOT, where), T, 0.0)
    worst_of_model = [int(np.argmax(everywhere.radii(drawn(1, 0.0))[0]))]
    there = DrawnLoops(fjr.TrackingLaw(ROBOT, gains), equilibria_at(ROBOT, where[worst_of_model]), T, 0.0)
    assert 0 < there.unstable(plants).sum() < lost.sum()
    assert np.array_equal(lost, everywhere.unstable(plants))


def test_the_parameter_in_which_lost_draws_differ_is_named() -> None:
    plants = drawn(60, 0.1, delay=1e-4)
    lost = plants.motor_inertia[:, 1] > np.quantile(plants.motor_inertia[:, 1], 0.9)
    assert "motor inertia of b" in in_common(plants, lost, ("a", "b"))
    assert "delay: " in in_common(plants, plants.delay > 9e-5)


def test_4603_draws_of_which_none_is_lost_show_one_in_a_thousand_with_99_percent() -> None:
    assert draws_needed(1e-3) == 4603
    assert largest_share(0, 4603) == pytest.approx(1e-3, rel=1e-3)
    assert (1 - largest_share(0, 4603)) ** 4603 == pytest.approx(0.01)
    assert largest_share(5, 1000) > largest_share(4, 1000) > 4e-3


def test_draws_lost_at_a_rate_are_lost_at_every_faster_one() -> None:
    """Then the same draws serve all rates of a search, which stops at the first that none loses.

    It is wrong only if the slowest of the rates that lose more than the share loses no draw: one chance in a hundred,
    however many rates are tried. With other draws each try would have its own.
    """
    plants = drawn(1000, 0.1, delay=10e-3)
    lost = []
    for beta in (9.0, 8.5, 8.0, 7.0, 6.0):
        law = fjr.TrackingLaw(ROBOT, fjr.synthesize(ROBOT, beta, 2 * T, configurations=CONFIGURATIONS))
        lost.append(DrawnLoops(law, equilibria_at(ROBOT, CONFIGURATIONS), 2 * T, 0.0).unstable(plants))
    assert lost[0].sum() > lost[1].sum() > lost[2].sum() > 0 == lost[4].sum()
    assert not any((slower & ~faster).any() for faster, slower in zip(lost, lost[1:], strict=False))
