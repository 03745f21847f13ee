# SPDX-License-Identifier: Apache-2.0
"""Gains tuned for uncertainties: one compiled loop for all gains, constraints, search, coordinates of all laws."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import fjr_core as fjr
from design.batch.test_batch import loop_of
from fjr_core.config import ros_yaml
from fjr_core.config.scenario import Scenario, parse_scenario
from fjr_core.errors import GainsError, ParameterError, StateError
from fjr_core.extensions.law_registry import LAWS
from fjr_design.batch import ClosedLoop, Draws, draws
from fjr_design.studies.compare_run import tuned_law
from fjr_design.studies.coordinates import RULE, SCENARIO, SearchCoordinates, coordinates
from fjr_design.studies.sections import section
from fjr_design.studies.suite import LawChoice
from fjr_design.studies.sweep import Sweep
from fjr_design.studies.tune import (
    FIGURES,
    GOAL,
    INFEASIBLE,
    OF_SCENARIO,
    SUCCESS,
    Figures,
    Goal,
    Point,
    Score,
    TuningStudy,
    search,
    with_better_start,
)
from fjr_design.tuning.equal_bandwidth import baseline_target
from fjr_design.uncertainty.posterior import IDENTIFIED, LINEAR, LOG, Estimate, Identification

VARY: dict[str, Any] = {
    "stiffness": {"log_uniform": [0.5, 2.0]},
    "link_inertia": {"uniform": [0.8, 1.2]},
    "delay": 1e-3,
    "position_noise": 1e-3,
    "velocity_noise": 0.1,
}


def text(**changes: Any) -> str:
    """Return the stiff joint of the paper with other parameters."""
    return ros_yaml.dump({"/**": {"ros__parameters": changes}})


def scenario(**changes: Any) -> Scenario:
    return parse_scenario("joint", text(**changes))


def study(goal: Goal | None = None, changes: dict[str, Any] | None = None, **numbers: Any) -> TuningStudy:
    vary = {name: draws.read(name, given) for name, given in VARY.items()}
    sweep = Sweep("joint", text(**(changes or {})), 1, vary, duration=0.3, settle_after=0.1, seed=3)
    return TuningStudy(sweep, goal or Goal(), **{"draws": 8, "candidates": 20, "fresh": 16, **numbers})


def paper_loop(gains: fjr.Gains) -> ClosedLoop:
    return loop_of(fjr.single_link(stiffness=31.0), gains, 0.2, settle_after=0.05)


def test_other_gains_give_the_results_of_a_loop_built_with_them() -> None:
    slower = replace(fjr.PAPER_GAINS, Lambda_l=3.0, K_md=0.2)
    draws = Draws(3, stiffness=[0.5, 1.0, 2.0], delay=1e-3, velocity_noise=0.01)
    built = paper_loop(slower)
    other = paper_loop(fjr.PAPER_GAINS).with_law(built.law)
    assert np.array_equal(other.run(draws).rms, built.run(draws).rms)
    assert not np.array_equal(other.run(draws).rms, paper_loop(fjr.PAPER_GAINS).run(draws).rms)


def test_a_law_of_another_form_is_refused() -> None:
    robust = coordinates(scenario(robust={"residual_gain": [20.0]})).controller([0.0] * 7)[0]
    with pytest.raises(StateError, match="expected a TrackingLaw with"):
        study().sweep.loop.with_law(robust)


@cache
def of_law(law: str) -> tuple[Scenario, SearchCoordinates]:
    given = scenario(law={"type": law})
    return given, coordinates(given)


@pytest.mark.parametrize("law", LAWS)
def test_every_law_starts_at_its_gains_in_the_scenario_and_every_coordinate_changes_them(law: str) -> None:
    given, space = of_law(law)
    start = space.controller(np.zeros(len(space)))[0].gain_values
    assert start == pytest.approx(given.sampled_law.gain_values, rel=1e-9)
    for step in 0.1 * np.eye(len(space)):
        assert not np.allclose(space.controller(step)[0].gain_values, start, rtol=1e-4)


@pytest.mark.parametrize("law", LAWS)
def test_a_parameter_file_of_any_point_gives_its_gains(law: str) -> None:
    _, space = of_law(law)
    point = 0.05 * np.arange(1, 1 + len(space))
    written = scenario(**ros_yaml.tree_of(space.values(point)))
    assert written.sampled_law.gain_values == pytest.approx(space.controller(point)[0].gain_values, rel=1e-12)


def test_v_dpbc_may_start_at_the_rule_of_equal_bandwidth() -> None:
    given = scenario(robust={"residual_gain": [20.0]})
    ruled = tuned_law(LawChoice("tuned", "v_dpbc", retune=True), given, baseline_target(given)).gains
    space = coordinates(given, RULE)
    assert list(space.values(np.zeros(7))["gains.K_md"]) == pytest.approx(np.ravel(ruled["K_md"]))
    assert list(space.values(np.zeros(7))["robust.residual_gain"]) == [20.0]


@pytest.mark.parametrize(("changes", "better"), [({"gains": {"K_md": [1e-5]}}, RULE), ({}, None)])
def test_the_search_starts_where_the_cost_is_less(changes: dict[str, Any], better: str | None) -> None:
    given = study(changes=changes)
    each = {start: replace(given, start=start) for start in (SCENARIO, RULE)}
    costs = {start: one.score(one.origin, one.run(one.origin, 0, 8)).cost for start, one in each.items()}
    chosen = with_better_start(given).start
    assert costs[chosen] == min(costs.values())
    assert chosen == (better or chosen)


def test_the_search_starts_at_the_gains_of_the_scenario_where_the_rule_has_none(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refused(*_: object, **__: object) -> None:
        raise GainsError("no gains are stable")

    lqr = study(changes={"law": {"type": "lqr", "tuned": False, "natural_frequency": 10.0}})
    assert with_better_start(lqr).start == SCENARIO
    monkeypatch.setattr("fjr_design.studies.coordinates.tune", refused)
    assert with_better_start(study()).start == SCENARIO


def test_the_gains_of_the_scenario_run_also_in_a_search_that_starts_elsewhere() -> None:
    given, elsewhere = study(), replace(study(), start=RULE)
    own = elsewhere.run(OF_SCENARIO, 0, 4)
    assert np.array_equal(own["rms"], given.run(given.origin, 0, 4)["rms"])
    assert not np.array_equal(own["rms"], elsewhere.run(elsewhere.origin, 0, 4)["rms"])
    assert TuningStudy.from_text(elsewhere.text).run(OF_SCENARIO, 0, 4)["rms"] == pytest.approx(own["rms"])
    assert elsewhere.score(OF_SCENARIO, own) == given.score(given.origin, own)


def test_robust_gains_and_the_observer_bandwidth_are_coordinates_that_change_the_runs() -> None:
    changes = {"robust": {"residual_gain": [20.0]}, "measurement": {"velocity": "observer"}}
    given = study(changes=changes)
    names = [axis.name for axis in given.coordinates.axes]
    assert names[-2:] == ["robust.residual_gain", "measurement.observer_bandwidth"]
    start = given.run(np.zeros(8), 0, 4)["rms"]
    for step in np.eye(8)[-2:]:
        assert not np.allclose(given.run(step, 0, 4)["rms"], start, rtol=1e-3)


def test_a_point_without_gains_is_refused() -> None:
    given = study(changes={"law": {"type": "torque_feedback"}})
    heavier = [0.0, 0.0, 3.0]  # M_theta above M_m
    assert given.score(heavier, given.run(heavier, 0, 4)) == given.goal.refused()
    assert given.goal.refused().cost > INFEASIBLE


def test_candidates_run_the_plants_of_a_posterior() -> None:
    known = [("joint_stiffness", 25.0), ("effort_delay", 1.5e-3)]
    estimates = tuple(Estimate(name, "joint1", "", v, 0.9 * v, 1.1 * v, v, IDENTIFIED) for name, v in known)
    mean, covariance = np.array([np.log(25.0), 1.5e-3]), np.diag([0.1, 2e-4]) ** 2
    posterior = Identification(("joint1",), estimates, (0, 1), (LOG, LINEAR), mean, covariance).as_dict()
    sweep = Sweep("joint", text(), 1, {}, duration=0.3, settle_after=0.1, posterior=posterior)
    known_goal = Goal({"rms": 1.0}, quantile=0.9, limits={"effort_peak": 30.0})
    given = TuningStudy.from_text(TuningStudy(sweep, known_goal, 8, 20, 16).text)
    assert TuningStudy.from_text(given.text).text == given.text
    runs, columns = given.run([0.0] * 6, 2, 6), sweep.part(2, 6)
    assert np.array_equal(runs["rms"], columns["rms.joint1"])
    assert np.array_equal(runs[SUCCESS], columns["success"])
    assert len(set(columns["stiffness.joint1"])) == 4


def test_search_selection_and_validation_share_no_run() -> None:
    given = study()
    stages = [set(range(*runs)) for runs in given.stages]
    assert [len(stage) for stage in stages] == [8, 32, 16]
    assert len(set.union(*stages)) == 56


def runs(rms: Sequence[float], success: Sequence[bool], noise: float = 1.0) -> Figures:
    found = {name: np.ones(len(rms)) for name in FIGURES}
    return {**found, "rms": np.array(rms), "effort_noise": np.full(len(rms), noise), SUCCESS: np.array(success)}


def test_cost_is_the_logarithm_of_quantiles_and_constraints_rank_first() -> None:
    goal = Goal({"rms": 1.0, "effort_noise": 0.5}, quantile=0.5, success=0.75, limits={"effort_noise": 2.0})
    good = goal.score(runs([1.0, 2.0, 3.0, np.inf], [True, True, True, False]))
    assert good.cost == pytest.approx(np.log(2.0))
    assert good.feasible
    lost = goal.score(runs([1e-6] * 4, [True, True, False, False]))
    worse = goal.score(runs([1e-6] * 4, [True, False, False, False]))
    noisy = goal.score(runs([1e-6] * 4, [True] * 4, noise=3.0))
    assert [each.violation for each in (lost, worse, noisy)] == pytest.approx([0.25, 0.5, 0.5])
    assert good.cost < INFEASIBLE < lost.cost < worse.cost


def test_the_delay_margin_is_that_of_the_check() -> None:
    given = study(Goal(delay_margin=3.0))
    margin = fjr.check(fjr.TrackingLaw(fjr.single_link(stiffness=31.0), fjr.PAPER_GAINS), 1e-3).delay_margin
    point = [0.0] * 6
    found = given.run(point, 0, 2)
    assert given.score(point, found).violation == 0
    beyond = study(Goal(delay_margin=margin + 1.0))
    assert beyond.score(point, found).violation > 0


class Bowl:
    """A study with a closed form: the distance from `bottom`, with an optional constraint z_0 <= `most`."""

    def __init__(self, bottom: Sequence[float], most: float = np.inf) -> None:
        self.bottom, self.most = np.array(bottom), most
        self.origin, self.candidates = (0.0,) * len(bottom), 400
        self.stages = (0, 8), (8, 40), (40, 50)
        self.sweep = SimpleNamespace(seed=5)

    def score(self, z: Point, _: Figures) -> Score:
        violation = max(0.0, float(z[0]) - self.most)
        distance = float(np.sum(np.square(z - self.bottom) * np.arange(1, 1 + len(z)) ** 2))
        return Score({}, 1.0, violation, INFEASIBLE * (1 + violation) if violation else distance)


def found(bowl: Bowl) -> np.ndarray:
    return np.array(search(bowl, lambda points, _: [{}] * len(points))[1])  # type: ignore[arg-type]


def test_search_finds_the_minimum_of_a_bowl_and_leaves_the_global_generator_alone() -> None:
    before = np.random.get_state()[1].copy()
    assert found(Bowl([1.0, -0.5, 0.2])) == pytest.approx([1.0, -0.5, 0.2], abs=1e-2)
    assert np.array_equal(np.random.get_state()[1], before)


def test_search_ends_on_an_active_constraint() -> None:
    z = found(Bowl([1.0, -0.5], most=0.5))
    assert z[0] <= 0.5
    assert z == pytest.approx([0.5, -0.5], abs=0.05)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"minimise": {"speed": 1.0}}, "'minimise': has 'speed'; expected some of rms"),
        ({"minimise": {"rms": 0.0}}, "'minimise': has 0.0 as 'rms'; expected 1e-12 to 1e[+]12"),
        ({"minimise": {}}, "has {} as 'minimise'; expected some of rms"),
        ({"quantile": 1.5}, "has 1.5 as 'quantile'; expected 0 to 1"),
        ({"delay_margin": -1.0}, "has -1.0 as 'delay_margin'; expected 0 to 20"),
        ({"limits": {"rms": float("nan")}}, "'limits': has nan as 'rms'"),
    ],
)
def test_goals_out_of_range_are_refused(change: dict[str, Any], words: str) -> None:
    with pytest.raises(ParameterError, match=words):
        section(change, GOAL)
