# SPDX-License-Identifier: Apache-2.0
"""The `fjr` command: termination, remaining files and processes, and refused input."""

from __future__ import annotations

import json
import os
import re
import signal
import time
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ament_index_python.packages import get_package_share_directory
from sensor_msgs.msg import JointState

from fjr_monitor.recording.recorder import BagWriter
from fjr_monitor.recording.run_folder import FolderError, RunFolder
from fjr_msgs_py.console.ending import Exit
from nodes.harness import Listener, Ros
from system.executables import NODES, Executable, Start, children, fjr_here, sets, wait_for
from system.shared_runs import is_complete, messages

pytestmark = pytest.mark.system


def is_alive(pid: int) -> bool:
    try:
        return (Path("/proc") / str(pid) / "stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def efforts(run: Path) -> list[float]:
    return [float(message.data[0]) for _, message in messages(run, "/effort_controller/commands")]


CALM = ("--force", "--no-report", *sets("realtime_priority:=0", "publish_rate:=200.0", "state_timeout:=600.0"))
"""In real time with little processor time: lock-step takes all there is."""


def running(ros: Ros, start: Start, output: Path, *options: str) -> tuple[Executable, dict[str, int]]:
    """Start `fjr run`, wait for full motion, return the command, and the processes of its recorder and its nodes."""
    listener = Listener(ros, only=["joint_commands"])
    command = start("fjr", "run", "paper_k31", "--duration", "3600", "--output", str(output), *options)
    ros.until(lambda: len(listener.commands) > 100 or command.process.poll() is not None, "motion")
    assert command.process.poll() is None, command.end()
    recorder = command.recorder()
    return command, {"recorder": recorder, **children(recorder)}


ENDS = [("", signal.SIGINT), ("controller_node", signal.SIGKILL)]
MORE = [pytest.param(*each, marks=pytest.mark.full) for each in (("", signal.SIGTERM), ("plant_node", signal.SIGKILL))]


@pytest.mark.parametrize(("killed", "number"), [*ENDS, *MORE])
def test_a_signal_or_a_killed_node_ends_all_processes_and_leaves_a_readable_bag(
    ros: Ros, start: Start, tmp_path: Path, killed: str, number: int
) -> None:
    command, nodes = running(ros, start, tmp_path, "--lockstep")
    assert {"plant_node", "controller_node"} <= set(nodes)
    sessions = {os.getsid(pid) for pid in (command.process.pid, *nodes.values())}
    assert len(sessions) == 4  # Linux divides the cores among them
    os.kill(nodes[killed] if killed else command.process.pid, number)
    code, said = command.end()
    assert code == (Exit.FAILED if killed else Exit.INTERRUPTED), said
    assert killed in said
    assert "Traceback" not in said
    assert f"what was recorded is in {tmp_path / 'paper_k31'}" in said
    assert not any(is_alive(pid) for pid in nodes.values())
    recorded = efforts(tmp_path / "paper_k31")
    assert len(recorded) > 50
    assert np.max(np.abs(recorded)) == pytest.approx(26.203, rel=0.01)
    if killed:
        report = json.loads((tmp_path / "paper_k31" / "report.json").read_text())
        assert killed in report["failure"]
        assert report["counts"]["answered"] > 50
    else:
        assert recorded[-1] == 0.0


def test_diverged_run_has_a_report_and_figures(tmp_path: Path) -> None:
    unstable = ("--force", "--duration", "60", *sets("publish_rate:=20.0", "inner_steps:=1"))
    said = fjr_here("run", "paper_k31", "--lockstep", *unstable, "--output", str(tmp_path), code=1)
    report = json.loads((tmp_path / "paper_k31" / "report.json").read_text())
    assert "plant_node" in said
    assert said.count("ended: the state of the robot is not finite after ") == 1
    assert "Traceback" not in said
    assert "plant_node" in report["failure"]
    assert 0 < report["duration_s"] < 60
    assert (tmp_path / "paper_k31" / "overview.png").stat().st_size > 10_000


def test_neither_recorder_nor_node_outlives_a_command_that_is_killed(ros: Ros, start: Start, tmp_path: Path) -> None:
    command, nodes = running(ros, start, tmp_path, *CALM)
    command.signal(signal.SIGKILL)
    command.process.wait()
    wait_for(lambda: not any(is_alive(pid) for pid in nodes.values()), "the end of recorder and nodes")


@pytest.fixture(autouse=True)
def fresh_domain(domains: Iterator[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Use another ROS domain than the last test, which killed nodes."""
    monkeypatch.setenv("ROS_DOMAIN_ID", next(domains))


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let executables discover each other as those of `fjr run` do."""
    profile = Path(get_package_share_directory("fjr_bringup")) / "config" / "fastdds.xml"
    monkeypatch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", str(profile))


def test_another_plant_in_the_domain_is_refused_before_anything_is_published(
    ros: Ros, start: Start, tmp_path: Path, quick: None
) -> None:
    listener = Listener(ros, only=["joint_states"])
    start("plant", "--ros-args", "-r", "__node:=other_plant")
    ros.until(lambda: listener.states, "the other plant")
    said = fjr_here("run", "paper_k31", "--no-report", "--output", str(tmp_path), code=Exit.FAILED)
    assert re.search(r"^fjr: /joint_states has other publishers in .*other_plant.*; expected", said, re.MULTILINE)
    assert listener.count_publishers("joint_states") == 1
    assert not list(tmp_path.iterdir())


def test_no_second_run_and_no_node_joins_a_run_and_a_publisher_of_states_that_stays_ends_it(
    ros: Ros, start: Start, tmp_path: Path, quick: None
) -> None:
    command, nodes = running(ros, start, tmp_path, *CALM)
    said = fjr_here("run", "paper_k3p1", "--no-report", "--output", str(tmp_path), code=Exit.FAILED)
    assert re.search(r"^fjr: another fjr run uses ROS domain \d+; expected .*ROS_DOMAIN_ID", said, re.MULTILINE)
    assert not list(tmp_path.glob("paper_k3p1*"))
    plant, controller = start("plant"), start("controller")
    code, said = plant.end()
    assert code == 1
    assert re.search("states of joint1 are published on /joint_states by (/fjr_plant|an unknown node); expected", said)
    code, said = controller.end()
    assert code == 1
    assert "expected nobody else to command the robot" in said
    assert all(map(is_alive, nodes.values()))
    Listener(ros, only=[]).create_publisher(JointState, "/joint_states", 1)
    code, said = command.end()
    assert code == 1, said
    assert "/joint_states has other publishers" in said
    assert len(efforts(tmp_path / "paper_k31")) > 50


def test_lock_step_waits_for_a_recorder_that_stands_still(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """For a time in which the nodes would compute more samples than its queues hold."""
    write, written, standstill = BagWriter.write, count(), 2.0

    def late_write(*arguments: Any) -> None:
        if next(written) == 1000:
            time.sleep(standstill)
        write(*arguments)

    monkeypatch.setattr(BagWriter, "write", late_write)
    options = ("--lockstep", "--no-report", "--duration", "6", "--output", str(tmp_path))
    fjr_here("run", "paper_k31", *options)
    assert is_complete(tmp_path / "paper_k31")


@pytest.mark.usefixtures("no_picture")
def test_stop_of_the_controller_is_the_headline_and_every_run_is_kept(tmp_path: Path) -> None:
    run = ("run", "paper_k31", "--lockstep", "--duration", "0.1", "--output", str(tmp_path), "--set")
    refused = fjr_here(*run, "limits.start_error:=[0.1]", "--no-report", code=Exit.FAILED)
    stopped = fjr_here(*run, "limits.tracking_error:=[0.2]", code=Exit.FAILED)
    assert {path.name for path in tmp_path.iterdir()} == {"paper_k31", "paper_k31-001", "paper_k31-002"}
    assert (tmp_path / "paper_k31").resolve() == tmp_path / "paper_k31-002"
    reasons = {
        "paper_k31-001": r"The controller did not start: \|q_l - q_ld\| of joint1 is 0\.5 rad; expected at most",
        # The event of the stop at the first state may precede or follow the second state.
        "paper_k31-002": r"The controller stopped at 0(\.001)? s: tracking error of joint1: q_l - q_ld = ",
    }
    for said, (folder, reason) in zip((refused, stopped), reasons.items(), strict=True):
        (verdict,) = (line.split()[-1] for line in said.splitlines() if line.startswith("paper_k31 (lock-step)"))
        assert verdict == "stopped"
        assert re.search(reason, said)
        stop = json.loads((tmp_path / folder / "report.json").read_text())["stop"]
        assert re.search(reason, f"{stop['heading']}: {stop['reason']}")
    page = (tmp_path / "paper_k31" / "report.html").read_text()
    assert f'<p class="verdict violated"><b>{stop["heading"]}</b>' in page


NEEDS_ROS = {
    "run": "run paper_k31 --lockstep --no-report",
    "demo": "demo",
    "echo": "echo /joint_states --once",
    "record": "record /joint_states",
    "call": "call /fjr_plant/reset",
    "set": "set /fjr_plant a 1",
    "lifecycle": "lifecycle /fjr_controller",
    "send": "send motion.csv",
    "watch": "watch --once",
}


def test_invalid_ros_domain_is_one_sentence_in_every_command_and_node(
    start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "motion.csv").write_text("time,joint1\n0,0\n1,0\n")
    sentence = "ROS_DOMAIN_ID is '{}'; expected a whole number from 0 to 232"
    for command, domain in [*((command, "abc") for command in NEEDS_ROS), ("echo", "500"), ("echo", "-1")]:
        monkeypatch.setenv("ROS_DOMAIN_ID", domain)
        said = fjr_here(*NEEDS_ROS[command].split(), code=1).splitlines()
        assert said[-1] == f"fjr: {sentence.format(domain)}"
        assert [line for line in said if line.startswith("fjr: ")] == said[-1:]
    for node in NODES:
        assert start(node).end() == (1, f"cannot start: {sentence.format(domain)}\n")


def test_security_without_keys_is_one_sentence(start: Start, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    monkeypatch.setenv("ROS_SECURITY_STRATEGY", "Enforce")
    monkeypatch.delenv("ROS_SECURITY_KEYSTORE", raising=False)
    sentence = "ROS_SECURITY_KEYSTORE is not set; expected the folder of the keys that ROS_SECURITY_STRATEGY demands"
    assert fjr_here("echo", "/joint_states", "--once", code=1) == f"fjr: {sentence}\n"
    assert start("controller").end() == (1, f"cannot start: {sentence}\n")


def test_waiting_for_one_view_or_message_ends_and_names_domain_and_remedy(ros: Ros) -> None:
    domain = os.environ["ROS_DOMAIN_ID"]
    for command, waited in (("watch", "no state and no diagnostics for 0.5 s on /joint_states, /diagnostics"),
                            ("echo /nothing", "no message of /nothing for 0.5 s")):  # fmt: skip
        said = fjr_here(*command.split(), "--once", "--timeout", "0.5", code=1)
        assert waited in said
        assert f"nodes in ROS domain {domain}: " in said
        assert said.endswith("; start the nodes, or set the ROS_DOMAIN_ID in which they run\n")


# Folders of the runs of a scenario.


def new_run(link: Path, text: str) -> Path:
    """Create a started run with a bag."""
    with RunFolder(link) as run:
        (run.path / "bag").mkdir()
        (run.path / "bag" / "bag_0.mcap").write_text(text)
        run.keep()
    return run.path


def test_run_that_could_not_start_leaves_no_folder(tmp_path: Path) -> None:
    first = new_run(tmp_path / "arm", "0")
    with RunFolder(tmp_path / "arm") as run:
        (run.path / "scenario.yaml").write_text("")
    assert {path.name for path in tmp_path.iterdir()} == {"arm", "arm-001"}
    assert (tmp_path / "arm").resolve() == first


def test_a_number_is_used_once(tmp_path: Path) -> None:
    first, second = new_run(tmp_path / "arm", "0"), new_run(tmp_path / "arm", "1")
    first.rename(tmp_path / "published")
    with RunFolder(tmp_path / "arm") as one, RunFolder(tmp_path / "arm") as other:
        assert one.path != other.path
        assert "arm-001" not in (one.path.name, other.path.name)
    assert second.is_dir()


def test_a_run_without_a_number_gets_one(tmp_path: Path) -> None:
    (tmp_path / "arm" / "bag").mkdir(parents=True)
    (tmp_path / "arm" / "bag" / "bag_0.mcap").write_text("old")
    assert new_run(tmp_path / "arm", "new").name == "arm-002"
    assert (tmp_path / "arm-001" / "bag" / "bag_0.mcap").read_text() == "old"


def test_other_folders_than_empty_ones_are_not_changed(tmp_path: Path) -> None:
    (tmp_path / "arm").mkdir()
    new_run(tmp_path / "arm", "replaces the empty folder")
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "text").write_text("")
    (tmp_path / "link").symlink_to("thesis")
    for name in ("thesis", "link"):
        with pytest.raises(FolderError, match="not replaced"), RunFolder(tmp_path / name):
            pass
