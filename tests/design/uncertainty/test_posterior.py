# SPDX-License-Identifier: Apache-2.0
"""Plants of a study drawn from the posterior of an identification: correlated, and the same for each run number."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fjr_core as fjr
from fjr_core import ParameterError
from fjr_design.batch import Draws, draws, parametric_robot
from fjr_design.batch.parametric_robot import WHOLE, ParametricPlant
from fjr_design.studies import sweep
from fjr_design.studies.suite import uncertainties
from fjr_design.studies.sweep import Sweep
from fjr_design.uncertainty.posterior import (
    IDENTIFIED,
    LINEAR,
    LOG,
    NONNEGATIVE,
    UNKNOWN,
    Estimate,
    Identification,
    PosteriorDraws,
    drawn_plants,
)
from fuzzing import refused

SCENARIO = """
/**:
  ros__parameters:
    joints: [joint1]
    robot: {model: single_link, link_inertia: [0.031], gravity_torque: [0.8], joint_stiffness: [31.0],
            motor_inertia: [0.004], link_damping: [0.2], motor_damping: [0.007]}
"""
DEVIATIONS = np.array([0.1, 0.05, 0.02, 2e-4])
CORRELATION = 0.8  # of stiffness and motor inertia


def identification(joint: str = "joint1") -> Identification:
    """Return an identification whose stiffness, motor inertia, friction and delay are known, its damping is not."""
    kinds = {"joint_stiffness": 30.0, "motor_inertia": 0.005, "link_coulomb_friction": 0.1, "effort_delay": 1e-3}
    estimates = [
        Estimate(name, joint, "", value, 0.9 * value, 1.1 * value, value, IDENTIFIED) for name, value in kinds.items()
    ]
    estimates.append(Estimate("link_damping", joint, "", 0.2, 0.0, 1.0, 0.2, UNKNOWN))
    correlation = np.eye(4)
    correlation[0, 1] = correlation[1, 0] = CORRELATION
    mean = np.array([np.log(30.0), np.log(0.005), 0.1, 1e-3])
    covariance = correlation * np.outer(DEVIATIONS, DEVIATIONS)
    coordinates = (LOG, LOG, NONNEGATIVE, LINEAR)
    return Identification((joint,), tuple(estimates), (0, 1, 2, 3), coordinates, mean, covariance)


def study(**given: Any) -> Sweep:
    return Sweep("mine", SCENARIO, 2000, {}, 0.1, settle_after=0.0, posterior=identification().as_dict(), **given)


@pytest.fixture(scope="module")
def whole() -> Any:
    return study().draws(0, 2000)


def test_draws_have_the_means_deviations_and_correlation_of_the_posterior(whole: Any) -> None:
    stiffness, inertia = (np.log(whole.values[name][:, 0]) for name in ("stiffness", "motor_inertia"))
    assert stiffness.mean() == pytest.approx(np.log(30.0 / 31.0), abs=0.01)
    assert inertia.mean() == pytest.approx(np.log(0.005 / 0.004), abs=0.01)
    assert [stiffness.std(), inertia.std()] == pytest.approx(DEVIATIONS[:2].tolist(), rel=0.06)
    assert np.corrcoef(stiffness, inertia)[0, 1] == pytest.approx(CORRELATION, abs=0.03)
    assert whole.values["coulomb_l"][:, 0].std() == pytest.approx(0.02, rel=0.06)
    assert whole.values["delay"].mean() == pytest.approx(1e-3, rel=0.02)


def test_a_run_draws_the_same_plant_whichever_runs_accompany_it(whole: Any) -> None:
    part = study().draws(700, 703)
    for name in ("stiffness", "motor_inertia", "coulomb_l", "delay"):
        assert np.array_equal(part.values[name], whole.values[name][700:703])


def test_what_is_not_identifiable_is_not_drawn(whole: Any) -> None:
    assert np.all(whole.values["link_damping"] == 1.0)
    columns = [each.column for each in study().drawn]
    assert columns == ["stiffness.joint1", "motor_inertia.joint1", "coulomb_l.joint1", "delay"]


TWO = fjr.planar_two_link(stiffness=[31.0, 20.0])
K, CUBIC, TURNS = np.array([40.0, 18.0]), np.array([500.0, 300.0]), np.array([0.05, 0.01])
"""Stiffness, cubic stiffness and smoothing velocity of an identification of two joints."""


def hardening() -> Identification:
    rows = {"joint_stiffness": K, "cubic_stiffness": CUBIC, "friction_smoothing_velocity": TURNS}
    named = [(name, joint, value) for name, row in rows.items() for joint, value in zip("ab", row, strict=True)]
    estimates = tuple(Estimate(*each[:2], "", each[2], 0.0, 9e9, each[2], IDENTIFIED) for each in named)
    mean = np.concatenate([np.log(K), CUBIC, np.log(TURNS)])
    covariance = np.diag([0.1, 0.1, 50.0, 30.0, 0.1, 0.1]) ** 2
    return Identification(
        ("a", "b"), estimates, (0, 1, 2, 3, 4, 5), (LOG,) * 2 + (NONNEGATIVE,) * 2 + (LOG,) * 2, mean, covariance
    )


@pytest.mark.parametrize("own", [None, CUBIC])
def test_springs_of_a_draw_have_the_stiffness_and_the_curve_of_the_posterior(own: Any) -> None:
    """The file of an identified robot has the curve, too: what is drawn beside it is the difference."""
    robot, identified = replace(TWO, cubic=own), hardening()
    drawn = PosteriorDraws(identified, robot, ("a", "b"))
    table, given = identified.draws(200, 3, widest=draws.WIDEST), Draws(200, **drawn.drawn(3, 0, 200))
    parts = {name: given.columns(name, 2) for name in parametric_robot.NAMES}
    torque = ParametricPlant(robot, WHOLE).functions_as_c[f"{WHOLE}_torque"]
    zeta = np.array([0.2, -0.3])
    deflected = np.concatenate([np.zeros(2), zeta, np.zeros(2)])
    found = [torque(deflected, row).full().ravel()[:2] for row in parametric_robot.vector(parts)]
    np.testing.assert_allclose(found, table[:, :2] * zeta + table[:, 2:4] * zeta**3, rtol=1e-9)
    for column in drawn.columns["cubic"]:
        assert abs(column.distribution.share(given.columns("cubic", 2)[:, column.entry]).mean() - 0.5) < 0.1


def test_a_number_of_the_whole_run_is_the_largest_of_the_joints() -> None:
    drawn = PosteriorDraws(hardening(), TWO, ("a", "b"))
    given = Draws(200, **drawn.drawn(3, 0, 200))
    (column,) = drawn.columns["smoothing"]
    assert (column.column, column.entry) == ("smoothing", 0)
    values = given.columns("smoothing", 2)[:, column.entry]
    np.testing.assert_allclose(values, hardening().draws(200, 3, widest=draws.WIDEST)[:, 4:].max(axis=1), rtol=1e-12)
    assert np.histogram(column.distribution.share(values), 4, (0, 1))[0].min() > 30


@pytest.mark.parametrize("matrix", ["K", "M_m", "D_l", "D_m"])
def test_a_robot_whose_joints_are_coupled_has_no_drawn_plants(matrix: str) -> None:
    """An identification has a value for each joint, and a draw would lose what is off the diagonal."""
    coupled = replace(TWO, **{matrix: np.diag(np.diag(getattr(TWO, matrix))) + 1e-3 * np.array([[1, 1], [1, 1]])})
    assert len(drawn_plants(hardening(), TWO, 3, 0)) == 3
    refused(ParameterError, lambda: drawn_plants(hardening(), coupled, 3, 0), f"{matrix} of the robot couples")


def test_marginal_shares_of_the_draws_are_uniform(whole: Any) -> None:
    (marginal,) = (each.distribution for each in study().drawn if each.name == "stiffness")
    shares = marginal.share(whole.values["stiffness"][:, 0])
    assert np.histogram(shares, 10, (0, 1))[0].min() > 140


def test_the_text_of_a_study_keeps_the_posterior() -> None:
    again = Sweep.from_text(study().text)
    assert np.array_equal(again.draws(3, 5).values["stiffness"], study().draws(3, 5).values["stiffness"])
    columns = again.part(0, 2)
    assert columns["stiffness.joint1"] == pytest.approx(study().draws(0, 2).values["stiffness"][:, 0])
    assert "delay" in columns


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            {"posterior": identification("elbow").as_dict()},
            "is of joints elbow; expected those of the scenario, joint1",
        ),
        ({"vary": {"stiffness": draws.read("stiffness", 1.1)}}, "'stiffness', which the posterior draws"),
    ],
)
def test_a_posterior_that_does_not_fit_is_refused(given: dict[str, Any], message: str) -> None:
    values = {"vary": {}, "posterior": identification().as_dict()} | given
    with pytest.raises(ParameterError, match=message):
        Sweep("mine", SCENARIO, 10, duration=0.1, **values)


def test_a_sweep_file_names_the_posterior(tmp_path: Path) -> None:
    (tmp_path / "identification.json").write_text(json.dumps(identification().as_dict()), encoding="utf-8")
    (tmp_path / "joint.yaml").write_text(SCENARIO)
    document = {"scenario": "joint.yaml", "posterior": "identification.json"}
    found = sweep.described(tmp_path / "mine.yaml", document, {}, {})
    assert found.posterior == identification().as_dict()
    with pytest.raises(ParameterError, match="expected 'posterior', or 'vary'"):
        sweep.read({"scenario": "paper_k31"})


@pytest.mark.parametrize(
    "values", [[], {}, {"joints": ["a"]}, {**identification().as_dict(), "free": [0]}, {"free": 1}]
)
def test_a_file_that_is_no_identification_is_refused(values: object) -> None:
    with pytest.raises(ParameterError, match="expected"):
        Identification.from_dict(values)


def test_a_deviation_under_its_former_name_is_drawn_as_before_and_reported_once_but_not_by_workers(
    capsys: pytest.CaptureFixture[str],
) -> None:
    given = {"uniform": [0.0, 1.0]}
    checked = uncertainties("tune", {"vary": {"external": given}})["vary"]
    said = capsys.readouterr().err
    assert "'external' under 'vary' is deprecated; use 'link_torque'" in said
    assert said.count("deprecated") == 1
    vary = draws.varied(json.loads(json.dumps(checked)))  # as a worker reads it
    assert capsys.readouterr().err == ""
    assert vary == draws.varied({"link_torque": given}) == draws.varied({"external": given})
    assert draws.stream("link_torque") == draws.stream("external")
    with pytest.raises(ParameterError, match="'external' beside its new name 'link_torque'"):
        draws.varied({"external": given, "link_torque": given})
