# SPDX-License-Identifier: Apache-2.0
"""The set-up tool reports failures in one sentence, skips completed steps and repeats interrupted ones."""

from __future__ import annotations

import errno
import os
import platform
import re
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from envsetup import cli, commands, environment, machine, workspace
from envsetup.commands import SetupError
from envsetup.environment import Environment
from envsetup.machine import has_wheels, uses_sourced_ros
from envsetup.workspace import Workspace
from system.executables import wait_for
from time_limits import HANG

ROOT = Path(__file__).resolve().parents[2]
TOOLS = ROOT / "tools"


def run_setup(target: str, pretend: str, path: Path, **environ: str) -> subprocess.CompletedProcess[str]:
    """Run the tool as a separate process that first executes `pretend`, e.g. another platform.machine."""
    code = f"import platform, runpy, sys; {pretend}; sys.path.insert(0, {str(TOOLS)!r}); sys.argv[1:] = [{target!r}]; "
    code += f"runpy.run_path({str(TOOLS / 'setup_env.py')!r}, run_name='__main__')"
    # The guard keeps the start-up hook of the ROS wheels from starting Python twice.
    env = {"PATH": str(path), "HOME": str(path), "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1", **environ}
    return subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, timeout=HANG)


def program(path: Path, text: str) -> None:
    """Write a shell script that can be started."""
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)


INSTALL = ("install ROS 2 Jazzy", "source /opt/ros/jazzy/setup.sh")
OLD = "sys.version_info = (3, 9, 18)"
REFUSED = {
    "aarch64": ("platform.machine = lambda: 'aarch64'", "", ("Linux on aarch64", *INSTALL)),
    "old glibc": ("platform.libc_ver = lambda: ('glibc', '2.17')", "", ("glibc 2.17", *INSTALL)),
    "another ROS": ("pass", "humble", ("ROS_DISTRO=humble", "Jazzy is needed")),
    "no rclpy": ("pass", "jazzy", ("no Python here imports rclpy",)),
    "old Python": (OLD, "", ("Python 3.10 to 3.13 is needed", "this is Python 3.9", "make PYTHON=")),
}


@pytest.mark.parametrize(("pretend", "ros", "words"), REFUSED.values(), ids=REFUSED)
def test_a_machine_that_does_not_fit_is_refused_in_one_sentence(
    pretend: str, ros: str, words: tuple[str, ...], tmp_path: Path
) -> None:
    run = run_setup("build", pretend, tmp_path, **({"ROS_DISTRO": ros} if ros else {}))
    assert run.returncode == 1, run
    assert "Traceback" not in run.stderr
    *before, last = run.stderr.strip().splitlines()
    assert not before or ros == "jazzy", run.stderr
    assert all(each in last for each in words), last


def test_too_old_python_hands_over_to_a_suitable_one(tmp_path: Path) -> None:
    program(tmp_path / "python3.13", "exit 127")
    program(tmp_path / "python3.11", '[ "$1" = -c ] && echo 3.11 || echo "entered with $2"')
    run = run_setup("lint", OLD, tmp_path)
    assert (run.returncode, run.stdout) == (0, "entered with lint\n")


def test_a_sourced_jazzy_is_used_on_any_machine_and_wheels_only_where_they_exist(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("ROS_DISTRO", "jazzy")
    monkeypatch.setattr(platform, "machine", lambda: "aarch64")
    assert uses_sourced_ros()
    monkeypatch.delenv("ROS_DISTRO")
    monkeypatch.setattr(platform, "machine", lambda: "x86_64")
    monkeypatch.setattr(platform, "libc_ver", lambda: ("glibc", "2.36"))
    assert not uses_sourced_ros()
    monkeypatch.setattr(sys, "implementation", SimpleNamespace(name="pypy"))
    assert not has_wheels()


def test_every_direct_requirement_is_pinned_once_and_only_tests_and_benchmarks_require_pinocchio() -> None:
    text = (ROOT / "constraints.txt").read_text()
    pinned = environment.pins(text)
    assert len(environment.entries(text)) == len(pinned)
    for file in (ROOT / "requirements").glob("*.txt"):
        for entry in environment.entries(file.read_text()):
            assert environment.requirement_name(entry) in pinned, f"{entry} of {file.name}"
    assert {"numpy", "scipy", "casadi", "ros-jazzy-rclpy", "mcap", "rosbags"} <= required("run")
    assert "matplotlib" not in required("run")
    for level in environment.LEVELS:
        assert ("pin" in required(level)) == (level in ("test", "bench"))
        assert "pin" not in required(level, wheels=False)  # its wheels need NumPy 2


def required(level: str, wheels: bool = True) -> set[str]:
    """Return the distributions that a level requires by name."""
    files = environment.requirement_files(ROOT, level, wheels)
    return {environment.requirement_name(entry) for file in files for entry in environment.entries(file.read_text())}


def test_packages_of_a_sourced_ros_are_kept_and_test_tools_pinned() -> None:
    pinned = {"numpy": "2.2.6", "scipy": "1.15.3", "casadi": "3.8.2", "pytest": "9.2.0", "lark": "1.0"}
    installed = {"numpy": "1.26.4", "scipy": "1.11.4", "pytest": "7.4.4", "lark": "1.10"}
    lines = environment.relaxed(pinned, installed, {"pytest"})
    assert lines == ["numpy==1.26.4", "scipy<=1.15.3", "casadi==3.8.2", "pytest==9.2.0", "lark<=1.10"]
    assert environment.relaxed(pinned, {})[0] == "numpy<2"


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """Copy the files that the set-up reads to a separate folder."""
    shutil.copytree(ROOT / "requirements", tmp_path / "requirements")
    shutil.copy(ROOT / "constraints.txt", tmp_path)
    package = tmp_path / "ros2_ws" / "src" / "pack"
    package.mkdir(parents=True)
    (package / "setup.py").write_text("# one\n")
    (package / "module.py").write_text("# one\n")
    return tmp_path


def test_a_changed_pin_changes_the_environment_and_what_colcon_reads_the_build(checkout: Path) -> None:
    environment = Environment(checkout, sourced_ros=False)
    before = environment.wanted("run")
    assert environment.wanted("run") == before
    assert environment.wanted("test") != before
    constraints = checkout / "constraints.txt"
    constraints.write_text(constraints.read_text().replace("casadi==", "casadi==0."))
    assert environment.wanted("run") != before
    workspace, package = Workspace(environment), checkout / "ros2_ws" / "src" / "pack"
    built = workspace.content()
    (package / "module.py").write_text("# two\n")
    (package / "__pycache__").mkdir()
    (package / "__pycache__" / "module.pyc").write_text("")
    assert workspace.content() == built
    (package / "setup.py").write_text("# two\n")
    changed = workspace.content()
    assert changed != built
    (package / "added.yaml").write_text("")
    assert workspace.content() != changed


def test_interrupted_installation_is_repeated_and_a_complete_one_kept(
    checkout: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    environment = Environment(checkout, sourced_ros=False)
    done: list[str] = []

    def create() -> None:
        done.append("create")
        environment.python.parent.mkdir(parents=True, exist_ok=True)
        environment.python.write_text("")

    def install(level: str) -> None:
        done.append(level)
        if len(done) == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(environment, "_create", create)
    monkeypatch.setattr(environment, "_install", install)
    with pytest.raises(KeyboardInterrupt):
        environment.ensure("run")
    for level in ("run", "run", "test", "run", "bench", "test"):
        environment.ensure(level)
    assert done == ["create", "run", "create", "run", "test"]


def test_a_folder_that_cannot_be_written_ends_the_set_up_in_one_sentence(
    checkout: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(cli, "ROOT", checkout)
    monkeypatch.delenv("ROS_DISTRO", raising=False)
    (checkout / ".setup").write_text("")
    assert cli.main(["build"]) == 1
    said = capsys.readouterr().err
    assert f"'{checkout}/.setup'" in said
    assert said.count("\n") == 1


def test_equal_files_become_one_and_stay_two_where_there_are_no_links(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = [tmp_path / "one", tmp_path / "two"]
    for file in files:
        file.write_bytes(bytes(1 << 16))

    def refuse(*_: object) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted")  # as by FAT and exFAT

    with monkeypatch.context() as patch:
        patch.setattr(os, "link", refuse)
        environment.share_equal_files(tmp_path)
    assert sorted(tmp_path.iterdir()) == files
    assert not files[0].samefile(files[1])
    environment.share_equal_files(tmp_path)
    assert sorted(tmp_path.iterdir()) == files
    assert files[0].samefile(files[1])
    assert files[1].read_bytes() == bytes(1 << 16)


def test_the_defaults_of_a_user_of_colcon_do_not_change_the_build(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / ".colcon").mkdir()
    (tmp_path / ".colcon" / "defaults.yaml").write_text("list: {packages-select: [another]}\n")
    monkeypatch.setenv("HOME", str(tmp_path))
    packages = ["--names-only", "--base-paths", str(ROOT / "ros2_ws" / "src" / "fjr_plant")]
    command = [sys.executable, "-c", workspace.COLCON, "--log-base", os.devnull, "list", *packages]
    env = commands.clean_environment(sourced_ros=False)
    assert subprocess.check_output(command, cwd=tmp_path, env=env, text=True) == "fjr_plant\n"


SLEEPING = """
import os, signal, sys
from pathlib import Path
from envsetup import cli, commands
signal.signal(signal.SIGINT, signal.default_int_handler)  # which a suite in the background of a shell ignores
sleep = ["sh", "-c", "echo $$ > part && mv part begun && exec sleep 1000"]
cli.set_up = lambda *_: commands.run("sleep", sleep, Path("log"), dict(os.environ), "sleep failed")
sys.exit(cli.main(["build"]))
"""


@pytest.mark.parametrize("by", [signal.SIGTERM, signal.SIGINT])
def test_a_set_up_that_is_ended_leaves_no_command_behind(by: signal.Signals, tmp_path: Path) -> None:
    env = {name: value for name, value in os.environ.items() if name != "ROS_DISTRO"} | {"PYTHONPATH": str(TOOLS)}
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    setup = subprocess.Popen([sys.executable, "-c", SLEEPING], cwd=tmp_path, env=env, **streams)
    assert setup.stdout.readline() == "[setup] sleep ...\n"
    wait_for((tmp_path / "begun").exists, "the command to begin")
    setup.send_signal(by)
    _, said = setup.communicate(timeout=HANG)
    assert setup.returncode == 130
    assert said.strip() == "[setup] interrupted; run the same command again to continue."
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "begun").read_text()), 0)


TOOL = machine.Extra("a tool", ("one", "two"), "all is slow", [["test", "-e", "there"]])


def pretended(
    monkeypatch: pytest.MonkeyPatch, folder: Path, user: int, apt: bool = True, fails: bool = False
) -> list[str]:
    """Pretend to be a user, with or without apt-get, whose installation succeeds or fails; return what it installs."""
    installed: list[str] = []

    def install(packages: tuple[str, ...], log: Path, env: dict[str, str]) -> None:
        if fails:
            raise SetupError("apt-get update failed")
        installed.extend(packages)
        Path("there").write_text("")

    monkeypatch.chdir(folder)
    monkeypatch.setattr(shutil, "which", lambda name: name if apt else None)
    monkeypatch.setattr(machine, "apt_install", install)
    monkeypatch.setattr(os, "geteuid", lambda: user)
    return installed


def test_missing_system_packages_are_installed_by_root(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    installed = pretended(monkeypatch, tmp_path, user=0)
    for _ in range(2):
        TOOL.ensure(tmp_path / "log", dict(os.environ))
    assert installed == ["one", "two"]


UNAVAILABLE = {
    "ask an administrator for `apt-get install one two`": {"user": 1000},
    "install it if you can": {"user": 1000, "apt": False},
    "apt-get update failed": {"user": 0, "fails": True},
}


@pytest.mark.parametrize("expected", UNAVAILABLE)
def test_unavailable_system_packages_are_reported_and_end_the_set_up_only_if_they_are_required(
    expected: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pretended(monkeypatch, tmp_path, **UNAVAILABLE[expected])
    TOOL.ensure(tmp_path / "log", dict(os.environ))
    sentence = f"a tool is missing: all is slow; .*{expected}"
    assert re.search(sentence, capsys.readouterr().out.splitlines()[-1])
    with pytest.raises(SetupError, match=sentence):
        replace(TOOL, required=True).ensure(tmp_path / "log", dict(os.environ))


def test_a_user_without_a_compiler_gets_that_of_pypi(checkout: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    pretended(monkeypatch, checkout, user=1000)
    monkeypatch.setattr(cli, "ROOT", checkout)
    monkeypatch.setenv("CC", "no-such-compiler")
    for kind in (Environment, Workspace):
        monkeypatch.setattr(kind, "ensure", lambda *_: None)
    monkeypatch.setattr(Environment, "_pip", lambda _self, _title, _constraints, *wanted: asked.extend(wanted))
    cli.set_up("build", sourced_ros=False)
    assert asked == [f"--requirement={checkout}/requirements/compiler.txt"]


@pytest.mark.parametrize(
    ("name", "wanted", "code", "counts"),
    [
        ("gcc", "", 0, True),
        ("mycc", "mycc -m64", 0, True),
        ("gcc", "", 1, False),
        ("python", "", 0, True),  # -m ziglang cc
        ("python", "mycc", 0, False),
    ],
)
def test_compiler_is_accepted_if_it_compiles(name: str, wanted: str, code: int, counts: bool, tmp_path: Path) -> None:
    program(tmp_path / name, f"exit {code}")
    env = {"PATH": str(tmp_path), "CC": wanted}
    assert machine.compiler(env, tmp_path / "python").is_there(env) == counts


def test_a_sourced_ros_without_pinocchio_is_noticed(tmp_path: Path) -> None:
    (tmp_path / "pinocchio.py").write_text("")
    for path, there in ((tmp_path, True), (tmp_path / "empty", False)):
        env = {"PYTHONPATH": str(path), "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"}
        python = Path(sys.executable).resolve()  # outside the environment, which has its own
        assert machine.pinocchio(python).is_there(env) == there


def test_a_command_shows_its_latest_line_and_one_that_fails_its_last_ones(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(commands, "BEAT", 0.02)
    log, go_on = tmp_path / "log", tmp_path / "go on"
    waiting = f"echo reading; while [ ! -e '{go_on}' ]; do sleep 0.01; done; echo lost; exit 3"

    def say(text: str, passing: bool = False) -> None:
        if text.endswith("reading"):
            go_on.write_text("")
        print(text, passing)

    monkeypatch.setattr(commands, "say", say)
    with pytest.raises(SetupError, match=r"no tool \(exit code 3; the whole output is in .*log\)") as caught:
        commands.run("tool", ["sh", "-c", waiting], log, dict(os.environ), "no tool")
    first, *_, last = capsys.readouterr().out.splitlines()
    assert (first, last.startswith("tool ... failed after ")) == ("tool ... True", True)
    assert caught.value.details.splitlines()[-2:] == ["reading", "lost"]
    with pytest.raises(SetupError, match="no tool: "):
        commands.run("tool", [str(tmp_path / "none")], log, dict(os.environ), "no tool")


def test_damaged_stamp_is_ignored(tmp_path: Path) -> None:
    stamp = tmp_path / "stamp.json"
    assert environment.read_stamp(stamp) == {}
    environment.write_stamp(stamp, {"identity": ["here"]})
    assert environment.read_stamp(stamp) == {"identity": ["here"]}
    stamp.write_text(stamp.read_text()[:-3])
    assert environment.read_stamp(stamp) == {}


def test_check_names_the_choice_and_changes_nothing(tmp_path: Path) -> None:
    run = run_setup("check", "platform.machine = lambda: 'x86_64'", tmp_path)
    if not has_wheels():
        pytest.skip("the wheels do not exist for this machine")
    assert run.returncode == 0, run.stderr
    assert "ROS 2 Jazzy: wheels" in run.stdout
