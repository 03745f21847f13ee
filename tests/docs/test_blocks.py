# SPDX-License-Identifier: Apache-2.0
"""Every page is done from top to bottom in one folder, as its reader would do it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from docs.arm import my_arm_urdf
from docs.pages import LANGUAGES, PAGES, ROOT, Block, blocks
from docs.shell import script, syntax_error
from fjr_core import parameter_file
from fjr_core.scenario import load_scenario

LINKED = ("ros2_ws", "examples")  # what commands name relative to the checkout
ALL = [block for page in PAGES for block in blocks(page)]
WITH_BLOCKS = [page for page in PAGES if any(block.language in ("python", "sh", "yaml") for block in blocks(page))]


@pytest.mark.parametrize("block", ALL, ids=str)
def test_every_block_says_what_it_is(block: Block) -> None:
    assert block.language in LANGUAGES, f"{block}: '{block.language}'; indented blocks have no language"
    assert set(block.marks) <= {"file", "exit"}


@pytest.mark.parametrize("block", [block for block in ALL if block.language == "sh"], ids=str)
def test_every_shell_block_is_one_for_bash(block: Block) -> None:
    assert syntax_error(block.text) == ""


@pytest.mark.system
@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.usefixtures("turn")
@pytest.mark.parametrize("page", WITH_BLOCKS, ids=lambda page: page.stem)
def test_the_blocks_of_a_page_work_one_after_the_other(page: Path, tmp_path: Path) -> None:
    for name in LINKED:
        (tmp_path / name).symlink_to(ROOT / name)
    (tmp_path / "my_arm.urdf").write_text(my_arm_urdf(), encoding="utf-8")
    for block in blocks(page):
        DOING[block.language](block, tmp_path)


def do_python(block: Block, folder: Path) -> None:
    run(block, [sys.executable, "-c", block.text], folder)


def do_sh(block: Block, folder: Path) -> None:
    run(block, ["bash", "-c", script(block.text)], folder)


def run(block: Block, command: list[str], folder: Path) -> None:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300, check=False)
    said = f"{block}\n{command[-1]}\n{done.stdout}{done.stderr}"
    assert done.returncode == int(block.marks.get("exit", 0)), said
    assert "Traceback" not in done.stderr, said


def do_yaml(block: Block, folder: Path) -> None:
    """Write the file, or add to it, and read it as the nodes and `fjr` do."""
    file = folder / block.marks["file"]
    before = parameter_file.parse(file.read_text(encoding="utf-8")) if file.exists() else {}
    file.write_text(parameter_file.dump(merged(before, parameter_file.parse(block.text))), encoding="utf-8")
    assert load_scenario(file).warnings == (), str(block)


def merged(below: dict, above: dict) -> dict:
    """Two mappings as one, the second over the first."""
    both = {key: merged(below[key], value) for key, value in above.items() if isinstance(below.get(key), dict)}
    return {**below, **above, **both}


DOING = {"python": do_python, "sh": do_sh, "yaml": do_yaml, "text": lambda _block, _folder: None}
