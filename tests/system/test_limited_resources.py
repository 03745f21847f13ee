# SPDX-License-Identifier: Apache-2.0
"""Full disks, read-only folders, no HOME, paths with spaces: the program continues if possible, with one sentence.

What may be missing, a package, Matplotlib or the C compiler: everything else runs, and what needs it names it.
"""

from __future__ import annotations

import errno
import json
import os
import re
import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from build_wheels import PACKAGES
from envsetup.workspace import quote_paths
from fjr_bringup import runner
from fjr_core.errors import FjrError
from fjr_core.files.text_file import write_text
from fjr_monitor.recording import columns
from fjr_monitor.recording.bag import read_bag
from fjr_monitor.report.write import write_with_fallback
from fjr_msgs_py.console.ending import Exit
from fjr_msgs_py.node.loading import ensure_log_folder
from system.bags import TALKER
from system.executables import PROGRAMS, Start, fjr_here, installed
from time_limits import HANG
from two_link_urdf import two_link_urdf

pytestmark = pytest.mark.system
LIMIT, SENT = 100_000, 1500  # bytes; limit on the file size, for messages of 100 bytes and more

RECORDER = f"""{TALKER}
import resource
resource.setrlimit(resource.RLIMIT_FSIZE, ({LIMIT}, {LIMIT}))
for k in range({SENT}):
    publisher.publish(String(data=f"{{k:0100}}"))
    while not (k + 1) % 10 and f"{{k:0100}}".encode() not in (recorder.ends("/words") or (b"", b""))[1]:
        time.sleep(0.001)  # the publisher keeps ten messages
recorder.close()
print(recorder.failure, recorder.loss)
"""


def limited(kind: int, limit: int, *command: str) -> subprocess.CompletedProcess[str]:
    """Run a command with a limit of the kernel."""
    return subprocess.run(
        command,
        capture_output=True,
        text=True,
        timeout=HANG,
        preexec_fn=lambda: resource.setrlimit(kind, (limit, limit)),
    )


def test_full_disk_ends_only_the_recording(tmp_path: Path) -> None:
    """A kernel limit on the file size makes writing fail like a full disk."""
    command = [sys.executable, "-c", RECORDER, str(tmp_path / "bag")]
    result = subprocess.run(command, capture_output=True, text=True, timeout=HANG)
    assert result.returncode == 0, result.stderr
    assert result.stdout.split()[0] == "None"
    assert "recording stopped: File too large" in result.stdout
    assert result.stderr.count("recording stopped") == 1
    bag = read_bag(tmp_path / "bag")
    words = [int(each.data) for each in bag.topic("/words").decoded]
    assert words == list(range(len(words)))
    assert 100 < len(words) < SENT
    assert not bag.complete


def test_a_full_disk_ends_a_run_with_a_sentence_and_what_was_recorded_is_reported(tmp_path: Path) -> None:
    room = 2_500_000  # bytes of a file, some chunks of the bag; shared memory of the middleware is made of files, too
    options = ("--lockstep", "--duration", "3600", "--no-report", "--output", str(tmp_path))
    done = limited(resource.RLIMIT_FSIZE, room, *installed("fjr", "run", "paper_k31", *options))
    assert done.returncode == Exit.FAILED, done.stderr
    assert "what was not recorded is not judged" in done.stderr
    assert "Traceback" not in done.stderr
    report = json.loads((tmp_path / "paper_k31" / "report.json").read_text())
    assert "File too large" in report["failure"]
    assert report["counts"]["answered_in_time_fraction"] == 1.0
    assert 0 < report["duration_s"] < 60
    assert not (tmp_path / "paper_k31" / "report.html").exists()


TOO_LITTLE = {
    "fjr": (resource.RLIMIT_NOFILE, 24, "fjr: the limit of open files is 24; expected at least 64"),
    "plant": (
        resource.RLIMIT_AS,
        600_000_000,
        "plant_node: the limit of address space is 600000000 bytes; expected at least 1200000000",
    ),
}


@pytest.mark.parametrize("program", TOO_LITTLE)
def test_too_few_descriptors_or_too_little_memory_is_one_sentence(program: str) -> None:
    kind, limit, sentence = TOO_LITTLE[program]
    done = limited(kind, limit, *installed(program))
    assert done.returncode == 1
    assert done.stderr.startswith(sentence)
    assert done.stderr.count("\n") == 1


def test_a_report_that_cannot_be_written_is_written_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    for spoilt in ("/dev/null/none", "/dev/null/none/two"):
        folder = write_with_fallback(Path(spoilt), lambda place: (place / "report.json").write_text("{}"))
        assert (folder / "report.json").read_text() == "{}"
        said = capsys.readouterr().err
        assert said.count("\n") == 1
        assert spoilt in said
        assert str(folder) in said
    assert write_with_fallback(tmp_path / "good", lambda place: None) == tmp_path / "good"
    assert capsys.readouterr().err == ""


def test_numbers_of_a_bag_that_have_no_room_are_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", "/dev/null")
    monkeypatch.setattr(columns, "IN_MEMORY", 8)
    sentence = (
        "^the scratch file of a bag in /dev/null is not written: Not a directory; expected room there, or TMPDIR$"
    )
    with pytest.raises(FjrError, match=sentence):
        columns.Columns().add(t=np.zeros(100))


def test_partial_file_is_never_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_text(tmp_path / "figures.json", "old")

    def full(_descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match=r"No space left on device: '.*/figures\.json'"):
        write_text(tmp_path / "figures.json", "new")
    assert [path.name for path in tmp_path.iterdir()] == ["figures.json"]
    assert (tmp_path / "figures.json").read_text() == "old"


POOR = [{}, {"HOME": "/proc/nobody"}, {"ROS_HOME": "/proc/ros"}, {"ROS_LOG_DIR": "/dev/null/log"}]


@pytest.mark.parametrize("variables", POOR, ids=lambda given: "".join(given) or "nothing")
def test_ros_starts_without_a_writable_log_folder(
    variables: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    for name in ("HOME", "ROS_HOME", "ROS_LOG_DIR"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("ROS_LOG_DIR", variables.get("ROS_LOG_DIR", ""))  # removed at the end of the test
    ensure_log_folder()
    folder = os.environ["ROS_LOG_DIR"]
    assert os.access(folder, os.W_OK)
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert folder in said
    ensure_log_folder()  # a folder that can be written is kept, without a word
    assert os.environ["ROS_LOG_DIR"] == folder
    assert capsys.readouterr().err == ""


def test_scripts_and_nodes_start_from_a_path_with_spaces(tmp_path: Path) -> None:
    """The scripts are as written by colcon 0.20 and setuptools 79."""
    root = tmp_path / "Übungs ordner's"
    install, python = root / "install", root / "bin" / "python"
    nodes = [install / "arm" / folder / "arm" / "node" for folder in ("lib", "libexec")]
    for path in (*nodes, python):
        path.parent.mkdir(parents=True)
    python.symlink_to(sys.executable)
    name = "_colcon_prefix_chain_sh_COLCON_CURRENT_PREFIX"
    (install / "setup.sh").write_text(f'{name}={install}\necho "${name}"\n')
    (install / "local_setup.sh").write_text(
        f'_colcon_python_executable="{python}"\nsaid="$($_colcon_python_executable -c "print(5)")"\necho "$said"\n'
    )
    for node in nodes:
        node.write_text(f'#!"{python}" -x\n# comment\nimport sys\nprint(sys.argv[1:])\n')
        node.chmod(0o755)
    for _ in range(2):  # quoted paths are unchanged
        quote_paths(install)
    assert _said("sh", str(install / "setup.sh")) == f"{install}\n"
    assert _said("sh", str(install / "local_setup.sh")) == "5\n"
    assert [_said(str(node), "a b") for node in nodes] == ["['a b']\n"] * 2


@pytest.mark.parametrize("given", [{}, {"AMENT_PREFIX_PATH": "/opt/ros"}], ids=["nothing", "no Python path"])
@pytest.mark.parametrize("program", PROGRAMS)
def test_a_program_by_its_path_without_a_sourced_workspace_says_so(program: str, given: dict[str, str]) -> None:
    """As systemd, cron and sudo start it, without the variables of the shell."""
    bare = {"PATH": os.defpath, **given}
    done = subprocess.run(installed(program), env=bare, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (1, "")
    name = PROGRAMS[program][1]
    assert done.stderr.startswith(f"{name}: no workspace is sourced in this shell; expected . ros2_ws/install/setup.sh")
    assert done.stderr.count("\n") == 1


def test_a_table_is_printed_in_a_locale_that_lacks_its_dash(tmp_path: Path) -> None:
    ascii_only = {**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    code = "from fjr_msgs_py.node.loading import prepare; prepare('fjr'); print('\\N{EN DASH}')"
    assert python(code, ascii_only, tmp_path) == (0, "?\n")


def _said(*command: str) -> str:
    environment = {name: value for name, value in os.environ.items() if not name.startswith("_ROS_WHEELS")}
    return subprocess.run(command, capture_output=True, text=True, check=True, env=environment).stdout


def test_nodes_that_may_not_discover_each_other_end_a_run_with_the_variable(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")
    monkeypatch.setattr(runner, "STARTUP_LIMIT", 2.0)
    said = fjr_here("run", "paper_k31", "--lockstep", "--output", str(tmp_path), code=Exit.FAILED)
    (sentence,) = (line for line in said.splitlines() if line.startswith("fjr: waited 2 s for fjr_plant to appear; "))
    assert sentence.endswith("; ROS_AUTOMATIC_DISCOVERY_RANGE is OFF")


# What may be missing.


def without(*packages: str) -> dict[str, str]:
    """Return the environment variables without the folders of packages on the Python path."""
    paths = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    kept = [path for path in paths if not any(package in Path(path).parts for package in packages)]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(kept)}


def python(code: str, env: dict[str, str], folder: Path, *arguments: str) -> tuple[int, str]:
    """Return exit code and output of a program."""
    command = [sys.executable, "-c", code, *arguments]
    done = subprocess.run(command, env=env, cwd=folder, capture_output=True, text=True, timeout=HANG, check=False)
    return done.returncode, done.stdout + done.stderr


PROGRAM = """
import sys
from fjr_bringup.cli.app import main
sys.stderr = sys.stdout
for line in sys.argv[1:]:
    print("|", int(main(line.split())))
"""


NEEDS = {
    "identify record.csv": (2, "fjr_identification"),
    "excite two_link": (2, "fjr_identification"),
    "check two_link --certificate rate.json": (1, "fjr_proofs"),
    "check paper_k31 --error payload=0.1": (1, "fjr_proofs"),
    "check paper_k31 --prove-sampled": (1, "fjr_proofs"),
    "gains two_link --beta 1 --proven": (1, "fjr_proofs"),
    "export-mjcf two_link arm.xml": (1, "fjr_engines"),
}


def test_without_identification_and_proofs_what_needs_them_names_them_and_the_rest_runs(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(two_link_urdf(), encoding="utf-8")
    rest = ("new arm.urdf", "check arm.yaml", "gains two_link --beta 1", "--help")
    _, said = python(PROGRAM, without("fjr_identification", "fjr_proofs", "fjr_engines"), tmp_path, *NEEDS, *rest)
    texts, codes = zip(*re.findall(r"(.*?)^\| (\d)$", said, re.DOTALL | re.MULTILINE), strict=True)
    assert [*map(int, codes)] == [*(code for code, _ in NEEDS.values()), 0, 0, 0, 0], said
    *needing, _, check, _, shown = texts
    for text, (_, package) in zip(needing, NEEDS.values(), strict=True):
        assert f"needs the package {package}, which is not installed" in text
    assert "near the reference" not in check  # nothing is proven
    assert (" identify " in shown, " check " in shown) == (False, True)


def test_the_core_runs_alone_and_names_the_package_of_a_name(tmp_path: Path) -> None:
    code = """
import fjr_core as fjr
from fjr_core.extensions.law_registry import LAWS
robot = fjr.single_link(stiffness=31.0)
law = fjr.TrackingLaw(robot, fjr.PAPER_GAINS)
fjr.simulate(fjr.Plant(robot), law, fjr.Sine(1.0, 1.0), robot.state(0.5, 0.5, 0, 0), 0.1)
print(law.rate().proven, fjr.spectral_radius(law, 1e-3, configurations=[[0.5]])[0] < 1, list(LAWS))
for name in ("check", "testing", "synthesize", "diagnose", "Record", "Diagnosis"):
    try:
        getattr(fjr, name)
    except fjr.FjrError as error:
        print(name, error)
try:
    law.proven_rate()
except fjr.FjrError as error:
    print("proven_rate", error)
"""
    above = ("fjr_design", "fjr_monitor", "fjr_identification", "fjr_proofs", "fjr_bringup")
    status, said = python(code, without(*above), tmp_path)
    assert status == 0, said
    lines = said.splitlines()
    assert lines[0] == "True True ['v_dpbc']"
    packages = dict.fromkeys(("check", "testing", "synthesize"), "fjr_design")
    packages |= dict.fromkeys(("diagnose", "Record", "Diagnosis"), "fjr_monitor") | {"proven_rate": "fjr_proofs"}
    sentence = "{} this needs the package {}, which is not installed; expected it beside fjr_core"
    assert lines[1:] == [sentence.format(*each) for each in packages.items()]


IMPORT_ALL = """
import importlib, importlib.util, pkgutil, sys
sys.modules["matplotlib"] = None
left_out = () if importlib.util.find_spec("pydrake") else ("fjr_engines.drake",)
for package in sys.argv[1:]:
    for each in pkgutil.walk_packages(importlib.import_module(package).__path__, f"{package}."):
        if each.name not in left_out:
            importlib.import_module(each.name)
"""


def test_every_module_loads_without_matplotlib(tmp_path: Path) -> None:
    status, said = python(IMPORT_ALL, dict(os.environ), tmp_path, *PACKAGES)
    assert status == 0, said


SENTENCE = "no C compiler (no-such-cc) is on the path; expected one: apt-get install gcc libc6-dev, or "


def test_run_and_node_without_a_compiler_end_with_the_sentence_and_write_nothing(
    start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CC", "no-such-cc")
    said = fjr_here("run", "paper_k31", "--duration", "1", "--output", str(tmp_path), code=Exit.FAILED)
    assert re.fullmatch(f"fjr: {re.escape(SENTENCE)}.* -m pip install ziglang", said.splitlines()[-1])
    assert not list(tmp_path.iterdir())
    code, said = start("controller").end()
    assert code == 1
    assert SENTENCE in said
    assert "Traceback" not in said
