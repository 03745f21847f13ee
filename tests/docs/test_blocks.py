# SPDX-License-Identifier: Apache-2.0
"""Run the blocks of every page from top to bottom in one folder, as a reader would."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from docs.pages import LANGUAGES, MARKS, PAGES, ROOT, Block, blocks, languages
from docs.shell import exit_codes, only_fjr, script, syntax_error
from fjr_core.config import ros_yaml
from fjr_core.config.scenario import load_scenario
from fjr_design.studies import suite, sweep
from fjr_identification.excitation import optimal_design
from fjr_identification.records.record_map import read_map
from system.executables import fjr_here, is_alive, python_here
from system.shared_runs import shared_run
from time_limits import HANG
from two_link_urdf import link

LINKED = ("ros2_ws", "examples")  # folders that commands name relative to the checkout
ENVIRONMENT = {
    **os.environ,
    "PATH": f"{os.environ['PATH']}:{Path(sys.executable).parent}",
}  # includes CMake from its wheel
MAPPED = ("shoulder", "elbow", "wrist")  # joints of the mapping files on the page on identification
PLAIN_RUN, PLAIN_SAID = Path("runs", "paper_k31"), "plain_said"
WITH_THE_PLAIN_RUN = ("tutorial", "identification", "reports")
"""Pages that begin with a run of the paper's joint; they are given that of other tests, and what the command said."""
IN_PYTHON = "is evaluated in Python"  # of a law of the user
BACKGROUND: list[subprocess.Popen[bytes]] = []
WITH_BLOCKS = sorted(  # pages with many commands take long and begin
    (page for page in PAGES if {"python", "sh", "yaml"}.intersection(languages(page))),
    key=lambda page: -languages(page).count("sh"),
)


def test_every_block_names_its_language_and_every_shell_block_is_valid_bash() -> None:
    for block in (block for page in PAGES for block in blocks(page)):
        assert block.language in LANGUAGES, f"{block}: '{block.language}'; indented blocks have no language"
        assert set(block.marks) <= set(MARKS), str(block)
        assert block.language != "sh" or syntax_error(block.text) == "", str(block)


@pytest.mark.system
@pytest.mark.slow
@pytest.mark.usefixtures("background_processes_ended")
@pytest.mark.parametrize(
    "page", WITH_BLOCKS, ids=lambda page: page.parent.name if "examples" in page.parts else page.stem
)
def test_blocks_of_a_page_run_in_order(
    page: Path, reader_folder: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)  # `make build` leaves it out, too
    monkeypatch.setattr(optimal_design, "STARTS", 1)  # of a search in which all starts take the same steps
    if page.stem in WITH_THE_PLAIN_RUN:
        shared = shared_run(tmp_path_factory, "paper_k31")
        shutil.copytree(shared, reader_folder / PLAIN_RUN)
        shutil.copy(shared.with_name("said"), reader_folder / PLAIN_SAID)
    for name in LINKED:
        (reader_folder / name).symlink_to(ROOT / name)
    (reader_folder / "my_arm.urdf").write_text(my_arm_urdf(), encoding="utf-8")
    said = ""
    for block in blocks(page):
        said = RUNNERS[block.language](block, reader_folder, said)


@pytest.fixture
def reader_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The working directory of a reader, whose modules are found there and forgotten at the end."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    for name, module in list(sys.modules.items()):
        if Path(getattr(module, "__file__", None) or ".").is_relative_to(tmp_path):
            del sys.modules[name]


def do_python(block: Block, folder: Path, _said: str) -> str:
    """Run the block, as the file that it names if it names one, in this process, which saves the imports."""
    file = folder / block.marks.get("file", "block.py")
    file.write_text(block.text, encoding="utf-8")
    return python_here(block.text, file)


def do_sh(block: Block, folder: Path, _said: str) -> str:
    """Run the block in bash, or in this process if it is commands of `fjr` alone, which saves the imports of each."""
    commands = only_fjr(block.text)
    if not commands:
        return run(block, ["bash", "-c", script(block.text)], folder)
    expected = [0] * (len(commands) - 1) + [int(block.marks.get("exit", 0))]
    said = ""
    for arguments, code in zip(commands, expected, strict=True):
        if is_plain_run(arguments) and (folder / PLAIN_SAID).exists():
            said += (folder / PLAIN_SAID).read_text(encoding="utf-8")
        else:
            said += fjr_here(*arguments, codes=exit_codes(arguments, code))
    return said


def is_plain_run(arguments: list[str]) -> bool:
    """Return whether a command makes the run of the paper's joint that PLAIN_RUN holds."""
    return arguments[:3] == ["run", "paper_k31", "--lockstep"] and "--set" not in arguments


def do_file(block: Block, folder: Path, said: str) -> str:
    """Write the file for a later command."""
    (folder / block.marks["file"]).write_text(block.text, encoding="utf-8")
    return said


def run(block: Block, command: list[str], folder: Path) -> str:
    """Run a command, check its exit code and return its output; background processes keep running."""
    with (folder / ".said").open("w+") as file:
        process = subprocess.Popen(
            command, cwd=folder, stdout=file, stderr=file, start_new_session=True, env=ENVIRONMENT
        )
        BACKGROUND.append(process)
        code = process.wait(timeout=HANG)
        if not is_alive(process.pid):
            BACKGROUND.remove(process)
        file.seek(0)
        said = file.read()
    assert code == int(block.marks.get("exit", 0)), f"{block}\n{command[-1]}\n{said}"
    assert "Traceback" not in said, f"{block}\n{said}"
    return said


@pytest.fixture
def background_processes_ended() -> Iterator[None]:
    """End the background processes that the blocks of a page left."""
    yield
    while BACKGROUND:
        with suppress(ProcessLookupError):
            end_group(BACKGROUND.pop())


def end_group(leader: subprocess.Popen[bytes]) -> None:
    """Terminate the processes of a group; raise ProcessLookupError when none is left."""
    os.killpg(leader.pid, signal.SIGTERM)
    for _ in range(300):
        time.sleep(0.1)
        leader.poll()
        os.killpg(leader.pid, 0)
    os.killpg(leader.pid, signal.SIGKILL)
    pytest.fail(f"a process of {leader.args!r} did not end")


def do_yaml(block: Block, folder: Path, said: str) -> str:
    """Write or extend the file and read it as the nodes and `fjr` do."""
    values, reader = ros_yaml.parse(block.text), block.marks.get("for")
    if reader == "ros2_control":  # its nodes are not installed; check that it is a parameter file
        assert all(ros_yaml.values_for(node, values) for node in values)
        return said
    file = folder / block.marks["file"]
    if reader is None and not sweep.is_one(values):
        before = ros_yaml.parse(file.read_text(encoding="utf-8")) if file.exists() else {}
        file.write_text(ros_yaml.dump(merged(before, values)), encoding="utf-8")
        assert [one for one in load_scenario(file).warnings if IN_PYTHON not in one] == [], str(block)
        return said
    file.write_text(block.text, encoding="utf-8")
    assert READERS[reader](file), str(block)
    return said


READERS: dict[str | None, Callable[[Path], object]] = {
    None: lambda file: sweep.read(ros_yaml.parse(file.read_text(encoding="utf-8")))["vary"],
    "compare": lambda file: suite.load(file).robots,
    "identify": lambda file: read_map(file, MAPPED),
}


def merged(below: dict, above: dict) -> dict:
    """Return the first mapping updated recursively by the second."""
    both = {key: merged(below[key], value) for key, value in above.items() if isinstance(below.get(key), dict)}
    return {**below, **above, **both}


def do_text(block: Block, _folder: Path, said: str) -> str:
    """Check that each shown line is in the output of the previous block; `...` matches any text."""
    lines = [" ".join(line.split()) for line in said.splitlines()]
    for shown in block.text.splitlines() if "shown" in block.marks else ():
        pattern = ".*".join(re.escape(" ".join(part.split())) for part in shown.split("..."))
        assert any(re.fullmatch(pattern.replace(".*", " ?.* ?"), line) for line in lines), f"{block}: {shown}\n{said}"
    return said


RUNNERS = {
    **dict.fromkeys(("c", "cpp", "xml"), do_file),
    "python": do_python,
    "sh": do_sh,
    "text": do_text,
    "yaml": do_yaml,
}


JOINTS = {"shoulder": (0.0, "1 0 0"), "elbow": (-0.3, "0 1 0"), "wrist": (-0.25, "0 1 0"), "gripper": (-0.1, "0 0 1")}
LINKS = (("upper", 3.0, 0.15, 0.05), ("lower", 2.0, 0.12, 0.03), ("hand", 1.0, 0.05, 0.01), ("finger", 0.2, 0.02, 1e-3))


def my_arm_urdf() -> str:
    """Return the XML text."""
    parents = ["world", *(name for name, *_ in LINKS)]
    joints = [
        f"""<joint name="{name}" type="revolute"><parent link="{parents[k]}"/><child link="{parents[k + 1]}"/>
        <origin xyz="0 0 {height}"/><axis xyz="{axis}"/>
        <limit lower="-2.5" upper="2.5" velocity="5" effort="150"/></joint>"""
        for k, (name, (height, axis)) in enumerate(JOINTS.items())
    ]
    parts = [link(*each) for each in LINKS] + joints
    return '<?xml version="1.0"?>\n<robot name="my_arm"><link name="world"/>\n' + "\n".join(parts) + "\n</robot>\n"
