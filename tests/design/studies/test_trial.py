# SPDX-License-Identifier: Apache-2.0
"""Laws in a comparison: margins against independent results, independence of runs, motion demand, tuned laws."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.config.scenario import parse_scenario
from fjr_core.errors import ParameterError
from fjr_design.batch import ClosedLoop
from fjr_design.stability.sampled_loop import check
from fjr_design.studies.compare_run import tuned_law
from fjr_design.studies.suite import LawChoice
from fjr_design.studies.trial import (
    IMPERFECTIONS,
    PARTS,
    ROUNDS,
    STEPS,
    Direction,
    Metrics,
    RobustnessMargin,
    Trial,
    directions,
    margin,
    motion_demand,
)
from fjr_design.tuning.equal_bandwidth import baseline_target

T = 1e-3
ALL = directions(list(IMPERFECTIONS))


def trial(amplitude: float = 0.5, stiffness: float = 31.0, tracks: float = 0.1, duration: float = 3.0) -> Trial:
    robot = fjr.single_link(stiffness=stiffness)
    reference = fjr.Sine(amplitude=amplitude, frequency=2.0)
    law = fjr.TrackingLaw(robot, fjr.PAPER_GAINS)
    loop = ClosedLoop(robot, law, reference, robot.state(0.0, 0.0, 0.0, 0.0), duration, T, settle_after=1.0)
    return Trial(loop, motion_demand(robot, reference), tracks=tracks)


def resolution(direction: Direction) -> float:
    """Return the largest logarithmic ratio of neighbouring levels in the finest scan."""
    ladder = direction.ladder(STEPS)[1:]
    return float(np.max(np.abs(np.log(ladder[1:] / ladder[:-1])))) / (PARTS + 1) ** ROUNDS


@pytest.mark.parametrize("direction", ALL, ids=lambda direction: direction.name)
@pytest.mark.parametrize("place", [0.1, 0.37, 0.5, 0.93])
def test_the_search_finds_a_margin_anywhere(direction: Direction, place: float) -> None:
    ladder = direction.ladder(STEPS)
    begin = max(ladder[0], ladder[1])
    edge = float(np.exp((1 - place) * np.log(begin) + place * np.log(direction.end)))
    less = direction.is_down
    found = margin(direction, lambda levels: (np.array(levels) >= edge) if less else (np.array(levels) <= edge))
    level, beyond = found.level, found.beyond
    assert level is not None
    assert beyond is not None
    assert (beyond < edge <= level) if less else (level <= edge < beyond)
    assert abs(np.log(beyond / level)) < resolution(direction) * 1.01


def test_levels_beyond_a_failing_one_are_ignored() -> None:
    direction = next(d for d in ALL if d.name == "delay up to")
    gap = margin(direction, lambda levels: np.array([not 1e-3 < level < 4e-3 for level in levels]))
    assert gap.level == pytest.approx(1e-3, rel=0.02)


def test_no_margin_and_full_range_are_reported() -> None:
    for direction in ALL:
        nominal = 1.0 if direction.imperfection.is_factor else 0.0
        assert margin(direction, lambda levels: np.zeros(len(levels), dtype=bool)) == RobustnessMargin(None, nominal)
        everything = margin(direction, lambda levels: np.ones(len(levels), dtype=bool))
        assert everything == RobustnessMargin(direction.end, None)


def test_all_levels_of_a_scan_are_evaluated_at_once() -> None:
    asked = []

    def track(levels: Sequence[float]) -> np.ndarray:
        asked.append(len(levels))
        return np.array([level < 2 for level in levels])

    margin(next(d for d in ALL if d.name == "stiffness up to"), track)
    assert asked == [STEPS + 1, *[PARTS + 2] * ROUNDS]


@pytest.mark.parametrize("stiffness", [31.0, 10.0])
def test_delay_margin_is_that_of_the_linearised_loop(stiffness: float) -> None:
    """For small motions about equilibrium, the spectral radius of the SampledLoop gives the margin."""
    robot = fjr.single_link(stiffness=stiffness)
    known = check(fjr.TrackingLaw(robot, fjr.PAPER_GAINS), T, configurations=np.zeros((1, 1)))
    small = trial(amplitude=1e-3, stiffness=stiffness, tracks=0.9, duration=6.0)
    found = small.margins(directions(["delay"]))["delay up to"].level
    assert found == pytest.approx(known.delay_margin * T, rel=0.03)


@cache
def alone(name: str) -> Metrics:
    return trial().metrics([{} if name == "nominal" else {name: LEVELS[name]}])[0]


LEVELS = {
    "stiffness": 0.7, "inertia": 1.3, "delay": 2e-3, "noise": 1e-3, "friction": 0.3, "load": 0.2, "hardening": 0.5,
    "hysteresis": 0.3,
}  # fmt: skip


@pytest.mark.parametrize("name", list(IMPERFECTIONS))
def test_every_imperfection_changes_the_run_unless_at_its_nominal_level(name: str) -> None:
    nominal, off = trial().metrics([{}, {name: IMPERFECTIONS[name].nominal}])
    assert nominal == off
    assert alone(name)["rms"] > 2 * nominal["rms"]


def test_cell_does_not_depend_on_other_cells() -> None:
    names = ["nominal", *IMPERFECTIONS]
    together = trial().metrics([{} if name == "nominal" else {name: LEVELS[name]} for name in names])
    backwards = trial().metrics([{} if name == "nominal" else {name: LEVELS[name]} for name in reversed(names)])
    assert together == [alone(name) for name in names]
    assert together == backwards[::-1]


def test_margin_requires_tracking() -> None:
    """A stricter tracking level can only reduce margins; a level below the nominal error leaves none."""
    some = directions(["stiffness", "delay", "load"])
    loose, strict, none = (trial(tracks=level).margins(some) for level in (0.1, 0.01, 1e-7))
    for direction in some:
        far = [
            abs(np.log(e[direction.name].level / max(direction.imperfection.nominal, 1e-9))) for e in (loose, strict)
        ]  # type: ignore[operator]
        assert far[0] >= far[1]
    assert all(edge.level is None for edge in none.values())


def test_curves_contain_every_evaluated_level() -> None:
    one = trial()
    edge = one.margins(directions(["load"]))["load up to"]
    levels, cells = one.curve("load")
    assert edge.level in levels
    assert edge.beyond in levels
    assert np.all(np.diff(levels) > 0)
    assert all(cell["tracks"] == (level <= edge.level) for level, cell in zip(levels, cells, strict=True))


def test_motion_demand_of_a_pendulum() -> None:
    """RMS of a sin(w t) is a / sqrt 2; torque: M_l ddq + D_l dq + m g l sin q, here in closed form."""
    robot, a, w = fjr.single_link(stiffness=31.0), 0.7, 2 * np.pi
    found = motion_demand(robot, fjr.Sine(amplitude=a, frequency=w))
    t = np.linspace(0.0, 1.0, 1001)[:-1]
    q, dq, ddq = a * np.sin(w * t), a * w * np.cos(w * t), -a * w**2 * np.sin(w * t)
    torque = 0.031 * ddq + 0.2 * dq + 0.8 * np.sin(q)
    assert found.motion == pytest.approx([a / np.sqrt(2)], rel=1e-3)
    assert found.torque == pytest.approx([np.sqrt(np.mean(torque**2))], rel=1e-3)
    assert found.friction_rate == pytest.approx(found.torque[0] / 0.004, rel=1e-9)


def test_constant_reference_is_refused() -> None:
    with pytest.raises(ParameterError, match="is at rest"):
        motion_demand(fjr.single_link(stiffness=31.0), fjr.Sine(amplitude=0.0, frequency=1.0, offset=0.3))


def test_the_error_of_a_slide_counts_by_its_own_motion() -> None:
    """An error of 3 mm is large for a motion of 10 mm, but would be small beside the one radian of the other joint."""
    robot = replace(fjr.planar_two_link(), prismatic=(True, False))
    reference = fjr.Sine(amplitude=[0.01, 1.0], frequency=0.5)
    beta, M_l = 20.0, robot.M_l([0.0, 0.0])
    law = fjr.TrackingLaw(robot, fjr.Gains(beta, beta**2 * M_l, beta * M_l, beta, robot.K, beta * robot.M_m))
    loop = ClosedLoop(robot, law, reference, robot.state(*np.zeros((4, 2))), 3.0, T, settle_after=1.0)
    demand = motion_demand(robot, reference)
    assert demand.motion == pytest.approx(np.array([0.01, 1.0]) / np.sqrt(2), rel=2e-3)
    one = Trial(loop, demand)
    run = {"load": 0.5}
    error, found = one.loop.run(one.draws([run])).rms[0], one.metrics([run])[0]
    assert found["relative"] == pytest.approx(
        np.sqrt(((error[0] * np.sqrt(2) / 0.01) ** 2 + 2 * error[1] ** 2) / 2), rel=2e-3
    )
    assert not found["tracks"]
    with pytest.raises(
        ParameterError, match=r"the reference is at rest for 60 s at all joints in m; expected a motion"
    ):
        motion_demand(robot, fjr.Sine(amplitude=[0.0, 1.0], frequency=0.5))


def test_commands_are_saturated_at_the_limit() -> None:
    free = trial()
    limited = Trial(free.loop, free.demand, effort_limit=np.array([0.5]))
    assert free.metrics([{}])[0]["effort_peak"] > 1.0
    assert limited.metrics([{}])[0]["effort_peak"] == 0.5


@pytest.mark.parametrize("inertia", [0.3, 1.0])
def test_strongest_friction_is_integrated_without_chatter(inertia: float) -> None:
    """Steps four times as fine give the same run."""
    one = trial()
    draws = one.draws([{"friction": IMPERFECTIONS["friction"].highest, "inertia": inertia}])
    found, known = one.loop.run(draws), replace(one.loop, inner_steps=16).run(draws)
    assert found.rms == pytest.approx(known.rms, rel=1e-2)
    assert found.effort_rms == pytest.approx(known.effort_rms, rel=1e-2)


def test_a_comparison_has_the_law_with_its_options_beside_the_tuned_laws() -> None:
    scenario = parse_scenario("s", "/**: {ros__parameters: {joints: [joint1], limits: {effort: [20.0]}}}")
    target = baseline_target(scenario)
    own = tuned_law(LawChoice("mine", "own_code:Wrapped"), scenario, target)
    assert own.tuning == "not tuned: bandwidth 1 times the target, peak effort 1 times the target"
    chosen = tuned_law(LawChoice("mine", "own_code:Pd", options={"K_p": 5.0}), scenario, target)
    assert chosen.gains == {"K_p": 5.0}
    assert "bandwidth 0." in chosen.tuning
    with pytest.raises(fjr.FjrError, match=r"Pd takes .*unexpected keyword argument 'K'"):
        tuned_law(LawChoice("mine", "own_code:Pd", options={"K": 5.0}), scenario, target)
