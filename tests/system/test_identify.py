# SPDX-License-Identifier: Apache-2.0
"""`fjr identify`: from the bag of a run to a robot file that is a scenario, too, to JSON, a page, and its posterior."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from fjr_core.config import ros_yaml
from fjr_core.config.scenario import load_scenario
from fjr_core.errors import ParameterError
from fjr_design.uncertainty.posterior import IDENTIFIED, LINEAR, LOG, UNKNOWN, WEAK, Estimate, Identification
from fjr_identification.cli.identify import unconfirmed
from fjr_identification.estimation.validation import HoldOut
from fjr_identification.excitation import optimal_design
from fjr_identification.page import autocorrelation, groups
from fjr_identification.robot_file import IdentifiedRobot, nominal_robot
from fjr_msgs_py.console.ending import Exit
from system.browser import Browser
from system.executables import fjr_here, fjr_json, scenario, sets
from system.shared_runs import shared_run

pytestmark = pytest.mark.system
GUESSED = """\
/**:
  ros__parameters:
    joints: [joint1]
    robot:
      model: single_link
      joint_stiffness: [24.0]
      motor_inertia: [0.006]
      guesses: {joint_stiffness: [24.0], motor_inertia: [0.006]}
"""
KR300 = Path(__file__).parents[2] / "examples" / "kr300"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of an identification from a run of the paper's joint, with the output of the command."""
    folder = tmp_path_factory.mktemp("identification")
    (folder / "joint.yaml").write_text(GUESSED)
    run = str(shared_run(tmp_path_factory, "paper_k31"))
    said = fjr_here(
        "identify", run, "--robot", str(folder / "joint.yaml"), "--hold-out", run, "--output", str(folder / "out")
    )
    (folder / "out" / "said").write_text(said)
    return folder / "out"


def test_guesses_are_replaced_by_values_with_intervals(folder: Path) -> None:
    text = (folder / "robot.yaml").read_text()
    scenario = load_scenario(folder / "robot.yaml")
    assert scenario.warnings == ()
    assert scenario.robot_warnings == ()
    assert scenario.robot.K[0, 0] == pytest.approx(31.0, rel=1e-3)
    assert scenario.robot.M_m[0, 0] == pytest.approx(0.004, rel=1e-2)
    assert "# joint_stiffness of joint1: 31 N m/rad, 3" in text
    assert ", identified\n" in text


def test_robot_yaml_is_a_robot_file_that_brings_friction_and_no_gains(folder: Path) -> None:
    own = folder / "own.yaml"
    own.write_text(
        "/**:\n  ros__parameters:\n    robot: {file: robot.yaml}\n    imperfections: {motor_coulomb_friction: [0.5]}\n"
    )
    values = load_scenario(own)
    whole = load_scenario(folder / "robot.yaml")
    assert pytest.approx(whole.robot.K) == values.robot.K
    assert values.plant_values["imperfections.motor_coulomb_friction"] == (0.5,)
    assert values.controller_values["gains.Lambda_l"] != whole.controller_values["gains.Lambda_l"]
    assert values.warnings == ()
    key = "imperfections.link_coulomb_friction"
    assert values.plant_values[key] == whole.plant_values[key]


def test_a_robot_file_says_where_friction_turns_over_and_robot_yaml_what_was_found(tmp_path: Path) -> None:
    path = tmp_path / "joint.yaml"
    for section in ("/**", "/**/fjr_plant"):
        stated = "imperfections: {friction_smoothing_velocity: [VALUE]}"
        other = f"    {stated}\n" if section == "/**" else f"{section}:\n  ros__parameters:\n    {stated}\n"
        path.write_text(GUESSED + other.replace("VALUE", "0.002"))
        assert nominal_robot(path).smoothing == pytest.approx([0.002])
        path.write_text(GUESSED + other.replace("VALUE", "0.0"))
        with pytest.raises(ParameterError, match="friction_smoothing_velocity"):
            nominal_robot(path)
    path.write_text(GUESSED)
    level = Estimate("motor_coulomb_friction", "joint1", "N m", 0.1, 0.09, 0.11, 0.0, IDENTIFIED)
    turn = Estimate("friction_smoothing_velocity", "joint1", "rad/s", 3e-3, 2e-3, 4e-3, 0.01, IDENTIFIED)
    falls = replace(level, name="stribeck_velocity", unit="rad/s", value=0.05)
    grows = replace(level, name="motor_load_friction", unit="", value=0.03)
    steepest = (0.1 + 0.03 * 0.8) / 0.006 / 2e5  # level under the weight, by the inertia and the largest rate
    for found, written in ((3e-3, 3e-3), (1e-6, steepest)):
        estimates = (level, falls, grows, replace(turn, value=found))
        known = Identification(("joint1",), estimates, (), (), np.zeros(0), np.zeros((0, 0)))
        text = IdentifiedRobot(nominal_robot(path), known).file(tmp_path, ["a record"], "robot.yaml").text
        assert "# friction_smoothing_velocity of joint1: " in text
        (tmp_path / "robot.yaml").write_text(text)
        values = load_scenario(tmp_path / "robot.yaml").plant_values
        assert values["imperfections.friction_smoothing_velocity"] == pytest.approx((written,), rel=1e-5)
        assert [values[f"imperfections.{side}_stribeck_velocity"] for side in ("link", "motor")] == [(0.05,), (0.05,)]
        assert values["imperfections.motor_load_friction"] == (0.03,)


def test_json_has_the_posterior_and_names_records_robot_and_hold_out(folder: Path) -> None:
    values = json.loads((folder / "identification.json").read_text())
    found = Identification.from_dict(values)
    assert found.value("joint_stiffness") == pytest.approx([31.0], rel=1e-3)
    assert found.draws(5, seed=1).shape == (5, len(found.estimates))
    assert values["robot"].endswith("joint.yaml")
    assert [Path(each).name for each in values["records"]] == ["paper_k31"]
    assert list(values["hold_out"]) == values["records"]  # paths: two records may have one name
    assert 0 <= values["hold_out"][values["records"][0]][0][0] < 0.01
    said = (folder / "said").read_text()
    assert "parameters identified" in said
    assert "share of the deflection that a model leaves unexplained" in said
    assert f"fjr check {folder / 'robot.yaml'}" in said


def test_hold_out_that_rigid_joints_explain_better_is_reported(capsys: pytest.CaptureFixture[str]) -> None:
    shares = np.array([[0.1, 0.3, 0.9], [2.0, 0.4, 2.1], [np.nan] * 3])
    sentences = unconfirmed([HoldOut("b.csv", ("a1", "a2", "a3"), shares)])
    assert [each.partition(" is ")[0] for each in sentences] == ["hold-out b.csv: the deflection of a2"]
    assert sentences[0] in capsys.readouterr().err


def test_page_draws_fit_residuals_and_autocorrelation(folder: Path, browser: Browser) -> None:
    kinds = ("fit-0", "residual-q_l", "residual-q_m", "autocorrelation-q_l", "autocorrelation-q_m")
    browser.draws(folder / "identification.html", [f"record-0-{kind}" for kind in kinds])
    assert browser.value("document.querySelectorAll('.interval i').length") == 12


ARM = """/**:
  ros__parameters:
    joints: [shoulder, elbow]
    robot: {model: planar_two_link, joint_stiffness: [60.0, 40.0], motor_inertia: [0.02, 0.01],
            guesses: {joint_stiffness: [60.0, 40.0]}}
"""
ESTIMATES = (
    Estimate("joint_stiffness", "shoulder", "N m/rad", 41.0, 40.0, 42.0, 60.0, IDENTIFIED),
    Estimate("joint_stiffness", "elbow", "N m/rad", 40.0, 4.0, 400.0, 40.0, UNKNOWN, "it stands still; move it"),
    Estimate("motor_inertia", "shoulder", "kg m^2", 0.03, 0.01, 0.06, 0.02, WEAK, "it accelerates too little"),
    Estimate("motor_coulomb_friction", "shoulder", "N m", 0.3, 0.2, 0.4, 0.0, IDENTIFIED),
    Estimate("effort_delay", "shoulder", "s", 5e-4, 4e-4, 6e-4, 0.0, IDENTIFIED),
    Estimate("effort_delay", "elbow", "s", 8e-4, -4e-4, 2e-3, 0.0, WEAK, "excite more"),
    Estimate("offset", "shoulder", "rad", 1e-3, 9e-4, 1.1e-3, 0.0, IDENTIFIED),
)


@pytest.fixture
def made() -> Identification:
    free = (0, 2, 3, 4, 5, 6)
    coordinates = (LOG, LOG, LINEAR, LINEAR, LINEAR, LINEAR)
    return Identification(("shoulder", "elbow"), ESTIMATES, free, coordinates, np.zeros(6), np.eye(6))


def test_file_keeps_the_prior_and_the_guess_of_what_is_not_identifiable(tmp_path: Path, made: Identification) -> None:
    (tmp_path / "arm_robot.yaml").write_text(ARM)
    nominal = nominal_robot(tmp_path / "arm_robot.yaml")
    assert nominal.name == "arm"
    file = IdentifiedRobot(nominal, made).file(tmp_path, ["a.csv"], "robot.yaml")
    values = ros_yaml.values_for("fjr_plant", ros_yaml.parse(file.text))
    assert values["robot.joint_stiffness"] == [41.0, 40.0]
    assert values["robot.guesses.joint_stiffness"] == [0.0, 40.0]
    assert values["robot.motor_inertia"] == [0.03, 0.01]
    assert values["imperfections.motor_coulomb_friction"] == [0.3, 0.0]
    assert values["imperfections.command_delay"] == 5e-4
    lag = Estimate("actuator_lag", "shoulder", "s", 2e-4, 1e-4, 3e-4, 0.0, IDENTIFIED)
    lags = IdentifiedRobot(nominal, replace(made, estimates=(*ESTIMATES, lag)))
    values = ros_yaml.values_for("fjr_plant", ros_yaml.parse(lags.file(tmp_path, ["a.csv"], "robot.yaml").text))
    assert values["imperfections.actuator_lag"] == [2e-4, 0.0]
    assert values["imperfections.command_delay"] == pytest.approx(3e-4)
    assert (
        "elbow: 40 N m/rad, not identifiable from these records, kept as given (it stands still; move it)" in file.text
    )
    assert "motor_inertia of shoulder: 0.03 kg m^2, 0.01 to 0.06, weakly identified (it acc" in file.text
    assert "#   offset of shoulder: 0.001 rad, 0.0009 to 0.0011, identified" in file.text
    (tmp_path / "robot.yaml").write_text(file.text)
    scenario = load_scenario(tmp_path / "robot.yaml")
    assert scenario.robot_warnings == (
        "joint stiffness of joint elbow is a guess; replace it by a measured or data-sheet value "
        "in robot.joint_stiffness",
    )
    assert scenario.loop_delay == pytest.approx(5e-4)


def test_reflected_inertia_replaces_the_gear_ratio(tmp_path: Path, made: Identification) -> None:
    nominal = nominal_robot(KR300 / "kr300.yaml")
    assert nominal.name == ElementTree.parse(KR300 / "kr300.urdf").getroot().get("name")
    none = Identification(nominal.joints, (), (), (), np.zeros(0), np.zeros((0, 0)))
    values = IdentifiedRobot(nominal, none).values(tmp_path)
    assert "robot.gear_ratio" not in values
    assert values["robot.motor_inertia"] == pytest.approx(np.diag(nominal.robot.M_m), rel=1e-5)
    assert (tmp_path / str(values["robot.urdf"])).is_file()


def test_rows_of_the_page_show_interval_value_and_prior(made: Identification) -> None:
    rows = dict(groups(made))["Joint stiffness"]
    assert [row.joint for row in rows] == ["shoulder", "elbow"]
    assert rows[0].left < rows[0].middle == 50.0 < rows[0].left + rows[0].width
    assert rows[0].prior_at == pytest.approx(50 * (1 + np.log(60 / 41) / np.log(4)), abs=0.01)
    assert (rows[1].width, rows[1].colour) == (0.0, "no")


def test_autocorrelation_of_coloured_noise_with_gaps_is_its_closed_form() -> None:
    rng, a = np.random.default_rng(5), 0.8
    noise, series = rng.standard_normal(40_000), np.zeros(40_000)
    for k in range(1, len(series)):
        series[k] = a * series[k - 1] + noise[k]
    series[rng.random(len(series)) < 0.3] = np.nan
    assert autocorrelation(series, 8) == pytest.approx(a ** np.arange(9), abs=0.05)


# Commands that use the posterior.


@pytest.fixture
def posterior(tmp_path: Path) -> Path:
    """Write the posterior of the paper's joint, with a damping that is not identifiable."""
    values = {"joint_stiffness": 31.0, "motor_inertia": 0.004}
    estimates = [Estimate(k, "joint1", "", v, 0.9 * v, 1.1 * v, v, IDENTIFIED) for k, v in values.items()]
    estimates.append(Estimate("link_damping", "joint1", "", 0.2, 0.0, 1.0, 0.2, UNKNOWN, "the joint stands still"))
    mean, covariance = np.log(list(values.values())), np.array([[4e-4, 1e-4], [1e-4, 4e-4]])
    found = Identification(("joint1",), tuple(estimates), (0, 1), (LOG, LOG), mean, covariance)
    path = tmp_path / "identification.json"
    path.write_text(json.dumps(found.as_dict()), encoding="utf-8")
    return path


def test_gains_are_confirmed_on_fresh_draws_of_the_posterior(posterior: Path) -> None:
    shown = fjr_here("gains", "paper_k31", "--beta", "5", "--from", f"{posterior}", "--json")
    values, _ = json.JSONDecoder().raw_decode(shown)
    assert (values["fresh_draws"], values["lost_draws"], values["confidence"]) == (4603, 0, 0.99)
    assert values["largest_lost_share"] == pytest.approx(1e-3, rel=1e-3)
    assert values["not_drawn"] == ["link_damping of joint1"]
    assert "not identifiable, so not drawn: link_damping of joint1" in shown
    shown = fjr_here("gains", "two_link", "--beta", "5", "--from", f"{posterior}", code=Exit.NOT_UNDERSTOOD)
    assert "is of joints joint1; expected those of the scenario" in shown


def test_late_robots_of_an_identification_lose_the_integral_where_the_arm_is_lightest(tmp_path: Path) -> None:
    """Of two_link with this gain, one that acts 2.3 ms late is unstable with its elbow folded, and only there."""
    values = {"joint_stiffness": (40.0, 25.0), "effort_delay": (2.3e-3, 2.3e-3)}
    joints = ("shoulder", "elbow")
    estimates = [
        Estimate(name, joint, "", value, 0.9 * value, 1.1 * value, value, IDENTIFIED)
        for name, each in values.items()
        for joint, value in zip(joints, each, strict=True)
    ]
    mean, free = np.log([each.value for each in estimates]), tuple(range(4))
    found = Identification(joints, tuple(estimates), free, (LOG,) * 4, mean, 1e-4 * np.eye(4))
    path = tmp_path / "identification.json"
    path.write_text(json.dumps(found.as_dict()), encoding="utf-8")
    command = ("gains", "two_link", "--beta", "8", "--everywhere", "--from", f"{path}")
    assert "0 of 4,603 robots" in fjr_here(*command)
    shown = fjr_here(*command, "--set", "robust.integral_gain:=[20.0, 20.0]", code=Exit.FAILED)
    assert "4603 of 4,603 robots drawn afresh from the identification are unstable" in shown


def test_a_sweep_draws_from_the_posterior_next_to_it(posterior: Path, tmp_path: Path) -> None:
    study = tmp_path / "study.yaml"
    study.write_text("{scenario: paper_k31, posterior: identification.json, runs: 20, duration: 1.5}", encoding="utf-8")
    shown = fjr_here("sweep", f"{study}", "--output", f"{tmp_path / 'sweeps'}")
    assert "of 20 runs succeed" in shown
    assert "stiffness.joint1" in shown


# The motion that `fjr excite` writes, which the controller can follow within its limits.


DURATION = 3.0


@pytest.fixture
def short_search(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(optimal_design, "STARTS", 1)
    monkeypatch.setattr(optimal_design, "STEPS", 25)


@pytest.mark.usefixtures("short_search")
def test_the_written_scenario_follows_its_motion_from_rest(tmp_path: Path) -> None:
    target = tmp_path / "moves.yaml"
    values = fjr_json("excite", "two_link", "--duration", f"{DURATION}", "--output", f"{target}")
    assert values["scenario_file"] == str(target)
    narrower = np.divide(*(values[f"relative_half_width{end}"]["joint_stiffness"] for end in ("_before", "")))
    assert np.all(narrower > 1)
    loop = load_scenario(target)
    run = loop.simulate(DURATION)
    n = loop.robot.n
    assert np.abs(run.x[:, :n] - run.jets[:, 0]).max() < 2e-3
    assert np.abs(run.jets[0, 1:]).max() < 1e-6
    assert np.abs(run.jets[:, 0] - run.jets[0, 0]).max() > 0.1


@pytest.mark.usefixtures("short_search")
def test_a_robot_file_gets_gains(tmp_path: Path) -> None:
    robot, target = Path(scenario("two_link")).parents[1] / "robots" / "paper_joint.yaml", tmp_path / "moves.yaml"
    fjr_here("excite", f"{robot}", "--duration", f"{DURATION}", "--output", f"{target}")
    assert "stable" in fjr_here("check", f"{target}")


TABLE = ("torsion_deflection:=[0.05, 0.05, 0.1, 0.1]", "torsion_torque:=[2.5, 2.0, 8.0, 6.0]")


@pytest.mark.usefixtures("short_search")
@pytest.mark.parametrize("curve", [("cubic_stiffness:=[4.0e3, 2.5e3]",), TABLE], ids=["cubic", "table"])
def test_the_motion_of_springs_with_a_curve_keeps_their_limits(tmp_path: Path, curve: tuple[str, ...]) -> None:
    target = tmp_path / "moves.yaml"
    given = sets(*(f"robot.{each}" for each in curve), "limits.deflection:=[0.1, 0.06]")
    fjr_here("excite", "two_link", "--duration", f"{DURATION}", "--output", f"{target}", *given)
    loop = load_scenario(target)
    assert loop.robot.curve
    run = loop.simulate(DURATION)
    zeta = np.abs(run.x[:, 2:4] - run.x[:, :2]).max(axis=0)
    assert np.all(zeta <= [0.1, 0.06])
    assert np.abs(run.x[:, :2] - run.jets[:, 0]).max() < 2e-3


def test_coupled_joints_are_refused_before_any_record_is_judged(
    tmp_path_factory: pytest.TempPathFactory, tmp_path: Path
) -> None:
    """The torque of the other joint's spring looked like a wrong gear ratio. This record is of another robot."""
    robot = "{file: package://fjr_bringup/robots/two_link.yaml, joint_stiffness: [40.0, 5.0, 5.0, 25.0]}"
    (tmp_path / "coupled.yaml").write_text(f"/**: {{ros__parameters: {{robot: {robot}}}}}\n", encoding="utf-8")
    run = shared_run(tmp_path_factory, "paper_k31")
    said = fjr_here("identify", str(run), "--robot", str(tmp_path / "coupled.yaml"), code=2)
    assert said.splitlines()[-1] == "fjr: K is not diagonal; expected one number per joint"
