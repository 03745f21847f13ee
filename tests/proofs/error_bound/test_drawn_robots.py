# SPDX-License-Identifier: Apache-2.0
"""Robots drawn from stated errors, against another simulation of the same robots, and what `fjr check` says of them."""

from __future__ import annotations

import re
from itertools import product

import numpy as np
import pytest
from numpy.typing import ArrayLike

from bench.error_bound import UncertainLoop
from fjr_core.config.scenario import Scenario
from fjr_design.batch.draws import uniform
from fjr_msgs_py.scenarios import library
from fjr_proofs.check_rows import errors_bounded
from fjr_proofs.error_bound import drawn_robots as module
from fjr_proofs.error_bound.drawn_robots import SEED, drawn_robots

PLACE = np.array([0.05, 0.0, 0.1])  # m, of the payload
FREQUENCY = 10 * np.pi  # rad/s
DURATION = 1.2  # s: a period of the reference, and a second
ROBOTS = 40  # in place of 299
ERRORS: list[dict[str, ArrayLike]] = [
    {"payload": 0.2, "stiffness": 0.1, "gravity": 0.05, "motor_inertia": 0.1, "link_damping": 0.3},
    {"payload_mass": 0.2, "payload_position": [0.02, 0.0, 0.03], "link_mass": [0.2, 0.1], "motor_damping": 0.5},
    {"payload": 0.3, "payload_mass": 0.5},
]
ONE_NUMBER = ("payload", "gravity", "payload_mass")


@pytest.fixture(scope="module")
def two_link() -> Scenario:
    swing = {"amplitude": [0.05, 0.05], "frequency": [FREQUENCY, FREQUENCY], "offset": [0.3, 0.0]}
    return library.load("two_link", [f"reference.{name}:={value}" for name, value in swing.items()])


def joint(*settings: str) -> Scenario:
    """Return the paper's joint along a fast motion."""
    return library.load("paper_k31", [f"reference.frequency:=[{FREQUENCY}]", "reference.amplitude:=[0.05]", *settings])


@pytest.mark.parametrize("errors", ERRORS, ids=" ".join)
def test_the_largest_errors_are_those_of_another_simulation(
    two_link: Scenario, errors: dict[str, ArrayLike], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The loop has no delay: the engines differ in the efforts that are in transit at the start."""
    monkeypatch.setattr(module, "ROBOTS", ROBOTS)
    found = drawn_robots(two_link, errors, 0.0, PLACE)
    assert found is not None
    assert found.unstable == 0
    widths = {name: 1 if name in ONE_NUMBER else 3 if name == "payload_position" else 2 for name in errors}
    shares = np.hstack([2 * uniform(name, SEED, 0, ROBOTS, width) - 1 for name, width in widths.items()])
    loop = UncertainLoop(two_link.law, two_link.reference, two_link.sample_period, 0.0, errors, 0.0, DURATION, PLACE)
    assert found.largest == pytest.approx(loop.peaks(shares)[1].max(axis=0), rel=1e-4)


def test_the_worst_corner_is_that_of_all_corners(two_link: Scenario, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "ROBOTS", ROBOTS)
    errors: dict[str, ArrayLike] = {"link_mass": [0.2, 0.1], "stiffness": 0.1, "payload_mass": 0.2}
    found = drawn_robots(two_link, errors, 0.0, PLACE)
    assert found is not None
    loop = UncertainLoop(two_link.law, two_link.reference, two_link.sample_period, 0.0, errors, 0.0, DURATION, PLACE)
    corners = loop.peaks(np.array(list(product((-1.0, 1.0), repeat=5))))[1]
    joint = int(np.argmax(found.largest))
    assert found.corner == pytest.approx(corners[np.argmax(corners[:, joint])], rel=1e-4)
    assert found.corner[joint] > 1.1 * found.largest[joint]


@pytest.mark.parametrize(
    "errors", [{"payload": 0.1, "link_torque": 0.1}, {"payload_mass": 0.1, "gravity": 0.1}, {"gravity_direction": 0.1}]
)
def test_other_errors_are_not_drawn(two_link: Scenario, errors: dict[str, ArrayLike]) -> None:
    assert drawn_robots(two_link, errors, 0.0, PLACE) is None


def test_a_bound_that_is_not_proven_is_followed_by_drawn_robots() -> None:
    scenario, errors = joint(), {"payload": 0.1}
    found = errors_bounded(scenario, errors, 0.0, prove=False)
    said = re.match(r"\|q_l - q_ld\| at most (\S+) mrad", found.rows["    299 drawn robots"])
    assert said is not None
    largest = 1e3 * max(found.values["drawn"]["largest"].values())
    assert largest <= float(said[1]) <= 1.01 * largest
    assert f"at the samples of {found.values['drawn']['seconds']:.3g} s" in found.rows["    299 drawn robots"]
    assert found.values["drawn"]["corner"]["joint1"] >= 1e-3 * largest
    assert found.rows["    worst corner found"].endswith(
        "rad (joint1), of robots with every parameter at an end of its error"
    )
    assert "drawn" not in errors_bounded(scenario, errors, 0.0, prove=True).values


def test_unstable_loops_are_counted(two_link: Scenario) -> None:
    found = errors_bounded(two_link, {"motor_inertia": 0.9, "stiffness": 0.9}, 8.0, prove=False)
    assert found.values["drawn"]["unstable"] > 0
    assert found.rows["    worst corner found"].startswith("an unstable loop")
    assert found.rows["    299 drawn robots"].startswith(f"{found.values['drawn']['unstable']} with an unstable loop")


def test_what_a_proof_leaves_out_of_the_scenario_is_named() -> None:
    friction, late = "imperfections.motor_coulomb_friction", "imperfections.command_delay:=0.001"
    scenario = joint("limits.effort:=[0.5]", f"{friction}:=[0.3]", late)
    row = errors_bounded(scenario, {"payload": 0.1}, None).rows["error bound"]
    assert row.endswith(f"one sample of delay, without {friction} and effort limits; proven")
    heavier = joint("imperfections.payload_mass:=2.0")
    for errors in ({"payload_mass": 0.1}, {"payload_mass": 0.1, "link_torque": 1e4}):  # bounded, not bounded
        row = errors_bounded(heavier, errors, None).rows["error bound"]
        assert ", without imperfections.payload_mass" in row
