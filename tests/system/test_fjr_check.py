# SPDX-License-Identifier: Apache-2.0
"""`fjr check` reports rates and stability before a run; `fjr run` refuses an unstable scenario unless forced."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest

from fjr_core.config.scenario import load_scenario
from fjr_core.robust.law import Robust, sampled_law
from fjr_core.stability.linear_controller import Sensing
from fjr_design.cli.preflight import start_outside
from fjr_design.stability.sampled_loop import check
from fjr_msgs_py.scenarios import library
from fjr_proofs import kept_rate
from fjr_proofs.kept_rate import cached_rate
from system.executables import fjr_here, fjr_json, scenario, sets
from two_link_urdf import two_link_urdf

pytestmark = [pytest.mark.system, pytest.mark.usefixtures("no_kept_proof")]


def checked(given: str, *assignments: str, code: int = 0) -> tuple[dict[str, str], str]:
    """Return the rows that `fjr check` prints for a scenario with these parameters, and all that it says."""
    said = fjr_here("check", given, *sets(*assignments), code=code)
    return figures(said), said


def figures(output: str) -> dict[str, str]:
    """Return the rows of the table by name, without the lines of the progress, which a slow machine prints, too."""
    rows = (line.strip().partition("  ") for line in output.splitlines())
    return {name: text.strip() for name, _, text in rows if text}


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the path of a scenario of an arm of two joints from a URDF, with gains for a proven inertia."""
    folder = tmp_path_factory.mktemp("arm")
    (folder / "arm.urdf").write_text(two_link_urdf(), encoding="utf-8")
    path, robot = folder / "arm.yaml", "    joints: [shoulder, elbow]\n    robot:\n      model: urdf\n"
    data = "      urdf: arm.urdf\n      joint_stiffness: [400.0, 400.0]\n      motor_inertia: [0.1, 0.1]\n"
    path.write_text(f"/**:\n  ros__parameters:\n{robot}{data}", encoding="utf-8")
    said = fjr_here("gains", str(path), "--beta", "1", "--proven", "--write")
    assert "bounded by a proof near the reference" in said
    return str(path)


def test_the_papers_joint_is_stable_as_sampled_with_a_proven_rate() -> None:
    (rows, _), made = checked("paper_k31"), load_scenario(scenario("paper_k31"))
    found, rate = check(made.law, 1e-3), made.law.rate()
    assert rows["beta"].startswith(f"{rate.beta:.4g} 1/s")
    assert rows["beta of eq. (50)"].startswith(f"{rate.beta_paper:.4g} 1/s")
    assert "proven" in rows["beta"]
    assert rows["spectral radius"].startswith(f"{found.spectral_radius:.6f}")
    assert rows["delay margin"].startswith(f"{found.delay_margin:.2f} samples")
    assert rows["lowest stable rate"] == f"{found.lowest_stable_rate:.4g} Hz"
    assert rows["as sampled"] == "stable"


def test_loop_is_also_checked_along_the_reference() -> None:
    made = load_scenario(scenario("two_link"))
    found = check(made.law, 1e-3, configurations=made.configurations())
    row = checked("two_link")[0]["on the reference"]
    assert f"spectral radius {found.spectral_radius:.6f}" in row
    assert f"delay margin {found.delay_margin:.2f} samples" in row


def test_a_reference_beyond_the_limits_is_named(arm: str) -> None:
    rows, said = checked(arm, "reference.amplitude:=[0.1, 4.0]", "reference.frequency:=[1.0, 2.0]", code=1)
    assert rows["reference"] == "BEYOND the position limits of elbow; BEYOND the velocity limits of elbow"
    assert "fjr: scenario arm has a reference beyond its limits, with which no controller starts: joint 'elbow'" in said


def test_a_law_whose_effort_is_not_finite_is_named() -> None:
    _, said = checked("paper_k31", "law.type:=own_code:NanBeyond", code=1)
    assert re.search(r"effort of the law, or its slope, is not finite at q_l = \[0\.[78]\d*\] rad, at rest", said)


def test_the_weight_is_compared_as_efforts_of_the_motors(arm: str) -> None:
    """Motors that drive both joints need other efforts than the torques at the joints."""
    gain, scenario = [0.5, 0.5, 0.5, -0.5], load_scenario(arm)
    weights = np.array([scenario.robot.grad_P_l(q_l) for q_l in scenario.reference.configurations(64)])
    needed = np.abs(np.linalg.solve(np.reshape(gain, (2, 2)), weights.T)).max(axis=1)
    for share, state in ((0.95, "BEYOND the effort limits of shoulder"), (1.05, "within the effort limits")):
        limit = [float(share * needed[0]), 1e3]
        rows, _ = checked(arm, f"robot.input_gain:={gain}", f"limits.effort:={limit}")
        assert rows["weight"].endswith(f"on the reference; {state}")


def test_limits_of_the_controller_count_beside_those_of_the_robot(arm: str) -> None:
    """An effort beyond them saturates; a reference beyond them keeps the controller from its start."""
    made = load_scenario(arm)
    weight = max(abs(made.robot.grad_P_l(q_l)[1]) for q_l in made.reference.configurations(64))
    for share, state in ((0.9, "BEYOND the effort limits of elbow"), (1.1, "within the effort limits")):
        rows, said = checked(arm, f"limits.effort:=[1e3, {share * weight}]")
        assert rows["weight"].endswith(f"on the reference; {state}")
        assert (f"{state}: the arm cannot hold it" in said) == (share < 1)
    rows, _ = checked(arm, "limits.effort:=[1e-6, 1e3]")
    assert rows["first effort"].endswith("BEYOND the effort limits of shoulder")
    rows, _ = checked(arm, "reference.amplitude:=[1e300, 0.1]", code=1)
    assert "BEYOND the effort limits" in rows["first effort"]  # it is not a number
    for limit, what in (("link_position_upper", "position"), ("link_velocity", "velocity")):
        rows, _ = checked(arm, f"limits.{limit}:=[10.0, 1e-3]", code=1)
        assert f"BEYOND the {what} limits of elbow" in rows["reference"]
    assert "its limit is 0.001 rad/s^2" in checked(arm, "limits.acceleration:=[9e9, 1e-3]", code=1)[1]


def three_joints(folder: Path, wrist_mass: float) -> str:
    """Return the path of a scenario of the arm with a wrist, whose inertia is 1e-5 kg m^2 beside that of its mass."""
    text = two_link_urdf(wrist_mass).replace('ixx="0.001"', 'ixx="1e-5"').replace('iyy="0.001"', 'iyy="1e-5"')
    (folder / "arm.urdf").write_text(text, encoding="utf-8")
    path, joints = folder / "arm.yaml", "joint_stiffness: [400.0, 400.0, 400.0], motor_inertia: [0.1, 0.1, 0.05]"
    robot = f"    joints: [shoulder, elbow, wrist]\n    robot: {{model: urdf, urdf: arm.urdf, {joints}}}\n"
    path.write_text(f"/**:\n  ros__parameters:\n{robot}    reference: {{type: sine}}\n", encoding="utf-8")
    return str(path)


def test_a_wrist_without_a_tool_on_a_stiff_spring_is_named(tmp_path: Path) -> None:
    """The last link has a little less than its 1e-5 kg m^2 as the arm moves freely, which makes that 6325 rad/s."""
    path = three_joints(tmp_path, wrist_mass=1e-9)
    said = r"the spring of joint 'wrist' with the inertia .* \(\S+e-06 kg m\^2\) oscillates at 63\d\d rad/s"
    for command in (("check", path), ("gains", path, "--beta", "1")):
        assert re.search(said, fjr_here(*command, code=1))


def test_path_on_the_command_line_is_relative_to_the_current_folder(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.yaml").write_text("/**: {ros__parameters: {joints: [knee], robot: {model: single_link}}}")
    rows, _ = checked("paper_k31", "robot.file:=mine.yaml")
    assert rows["scenario"] == "paper_k31: knee; 1000 Hz"


def test_robust_action_observer_and_delay_are_in_the_loop() -> None:
    options = ("robust.integral_gain:=[5.0]", "measurement.velocity:=observer", "imperfections.state_delay:=0.001")
    rows, _ = checked("paper_k31", *options)
    for part in ("integral action", "velocity observer of 150.0 rad/s", "delay of 1 ms"):
        assert part in rows["in the loop"]
    made = load_scenario(scenario("paper_k31"))
    law = sampled_law(made.law, Robust(integral_gain=5.0))
    found = check(law, 1e-3, 1e-3, sensing=Sensing(150.0), lowest_rate=False)
    assert rows["spectral radius"].startswith(f"{found.spectral_radius:.6f}")
    assert found.spectral_radius > check(made.law, 1e-3, lowest_rate=False).spectral_radius + 0.01


def test_a_law_that_takes_longer_than_a_sample_is_named() -> None:
    found = fjr_json("check", "paper_k31", "--set", "law.type:=own_code:Slow")
    (sentence,) = (text for text in found["warnings"] if " us; " in text)
    assert re.search(r"the law takes \d{4,} us; expected less than a sample of 1000 us$", sentence)


def test_radii_with_model_errors_are_listed() -> None:
    rows, _ = checked("paper_k31", "publish_rate:=95.0", "inner_steps:=200")
    assert rows["as sampled"] == "stable"
    state, _, worst = rows["with model errors"].partition("; the worst is ")
    kind, _, radius = worst.rpartition(": ")
    listed = [each for name in ("stiffness", "link inertia", "motor inertia") for each in rows[name].split(", ")]
    assert len(listed) == 12
    assert f"{radius} at {' '.join(kind.split()[-2:])}" in listed
    assert state == ("stable" if float(radius) < 1 else "UNSTABLE")
    assert max(float(each.split()[0]) for each in listed) == float(radius)


def test_initial_position_outside_the_range_of_the_robot_is_refused() -> None:
    start = [0.35, 2.5, -0.05, -1.45, 0.15, 0.55, 0.15]
    outside = {"initial_link_position": start, "initial_motor_position": start}
    beyond = "joint2: q_l is 2.5 rad; expected -2 to 2 rad"
    for said, changes in (([], {}), ([beyond], outside), ([], {**outside, "limits.from_robot": False})):
        _, made = library.as_run(library.find("arm7"), {**changes, "limits.motor_position_upper": [9.0] * 7})
        assert start_outside(made) == said


def test_a_rate_is_proven_with_a_certificate_and_kept_until_a_gain_or_its_file_changes(
    arm: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "folder" / "rate.json"
    sampled, _ = checked(arm)
    for name in ("beta", "beta of eq. (50)"):
        assert "minimum over sampled configurations, not proven" in sampled[name]
    near = sampled["near the reference"]
    assert near.endswith("1/s within 0.1 rad of the reference in each joint, proven")
    assert float(near.split()[1]) >= 0.995  # four digits of the gains are written
    proven = figures(fjr_here("check", arm, "--certificate", str(file)))
    assert proven["beta"].endswith("in continuous time, proven over the joint range")
    found = fjr_json("check", arm)
    assert found["rows"] == proven
    assert found["beta_is_proven"] is True
    assert 0.998 * found["beta_attained_per_s"] <= found["beta_per_s"] <= found["beta_attained_per_s"]
    certificate = json.loads(file.read_text())
    assert 0.9999 * found["beta_per_s"] < certificate["beta"] < found["beta_per_s"]
    assert certificate["joints"] == ["shoulder", "elbow"]
    assert "not proven" in checked(arm, "gains.K_md:=[9.0, 9.0]")[0]["beta"]
    (kept,) = Path(os.environ["XDG_CACHE_HOME"], "fjr").glob("rate-*.json")
    written, seal = kept.read_text(), kept.with_name(f"{kept.name}.sha256")
    for spoilt in (written[: len(written) // 2], "\udcff", "[" * 100_000, written):
        kept.write_text(spoilt, encoding="utf-8", errors="surrogateescape")
        if spoilt == written:
            seal.unlink()
        assert cached_rate(library.load(arm)) is None
        said = capsys.readouterr().err
        assert said.startswith("fjr: the kept proof ")
        assert said.count("\n") == 1
        assert kept.read_bytes() == b""
    kept.write_text(written.replace('"beta": 0', '"beta": 768'))
    rows, said = checked(arm)
    assert "fjr: the kept proof " in said
    assert rows["beta"] == sampled["beta"]
    assert figures(fjr_here("check", arm, "--certificate", str(file))) == proven
    assert json.loads(kept.read_text()) == json.loads(written)


def test_a_proof_that_ends_early_gives_what_is_proven_beside_the_sampled_rate_and_replaces_no_better_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm, certificate = three_joints(tmp_path, wrist_mass=0.3), str(tmp_path / "rate.json")
    fjr_here("gains", arm, "--beta", "1", "--write")
    rows = figures(fjr_here("check", arm, "--certificate", certificate, "--seconds", "0.001"))
    assert rows["beta"].endswith("proven over the joint range so far")
    sampled = load_scenario(arm).law.rate().beta
    assert f"minimum over sampled configurations: {sampled:.4g} 1/s" in rows["rate at q_l"]
    monkeypatch.setattr(kept_rate, "GOAL", 2.0)  # no proof is complete
    better, again = (kept_rate.certified_rate(library.load(arm), seconds) for seconds in (60.0, 0.0))
    assert better.beta > float(rows["beta"].split()[0])
    assert again == better == cached_rate(library.load(arm))


def test_the_tracking_error_is_bounded_for_stated_errors() -> None:
    given = ("check", "paper_k31", "--error", "payload=0.2", "--delay", "1")
    printed = fjr_here(*given, "--json")
    assert printed.count("bounding the tracking error") == 1
    result, _ = json.JSONDecoder().raw_decode(printed)
    bound = result["error_bound"]
    said = re.fullmatch(
        r"\|q_l - q_ld\| at most (\S+) mrad \(joint1\), V at most (\S+) mJ after the transient along this reference, "
        "with all link masses and inertias off by one common factor of up to 20 %, one sample of delay; proven",
        result["rows"]["error bound"],
    )
    for text, exact in zip(said.groups(), (1e3 * bound["position"]["joint1"], 1e3 * bound["V_J"]), strict=True):
        assert exact <= float(text) <= 1.01 * exact
    assert bound["errors"] == {"payload": 0.2}
    assert bound["from_start"]["joint1"] > bound["position"]["joint1"]
    assert bound["proven"]


def test_a_payload_without_a_lever_arm_is_named() -> None:
    place = ("--set", "imperfections.payload_position:=[0.2, 0.0, 0.0]")
    axis, beside = (fjr_here("check", "paper_k31", "--error", "payload=0.5kg", *more) for more in ((), place))
    assert ", on the axis of its joint (imperfections.payload_position)" in figures(axis)["error bound"]
    assert "axis" not in figures(beside)["error bound"]


def test_a_proof_that_was_asked_for_and_not_found_is_named() -> None:
    """Without --error or --delay the bound is that of the hold and the scenario's delay."""
    abrupt = ("type:=point_to_point", "point_to_point.returns:=false", "point_to_point.duration:=0.2")
    given = sets(*(f"reference.{assignment}" for assignment in abrupt))
    rows = figures(fjr_here("check", "paper_k31", "--prove-error", *given))
    assert "with no delay" in rows["error bound"]
    assert "not proven: no proof was found" in rows["error bound"]


@pytest.mark.full
def test_the_tracking_error_of_seven_joints_is_proven_on_request() -> None:
    given = ("check", "arm7", "--error", "payload=0.001", "--delay", "1")
    sampled, proven = figures(fjr_here(*given)), figures(fjr_here(*given, "--prove-error"))
    assert "not proven: --prove-error tries a proof" in sampled["error bound"]
    assert "not proven" not in proven["error bound"]
    assert proven["error bound"].endswith("; proven")
