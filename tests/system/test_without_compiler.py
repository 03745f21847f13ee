# SPDX-License-Identifier: Apache-2.0
"""Without a C compiler a run and a node end at once, with one sentence and exit code 1."""

from __future__ import annotations

from pathlib import Path

import pytest

from fjr_msgs_py.console.ending import Exit
from system.executables import NODES, Executable, fjr_here

pytestmark = pytest.mark.system
SENTENCE = (
    "no C compiler (no-such-cc) is on the path; expected one: apt-get install gcc libc6-dev, or pip install ziglang"
)


@pytest.fixture(autouse=True)
def no_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-cc")


@pytest.mark.parametrize("command", [("run", "paper_k31"), ("demo",)], ids=["run", "demo"])
def test_a_run_is_refused_before_anything_is_written(command: tuple[str, ...], tmp_path: Path) -> None:
    said = fjr_here(*command, "--duration", "1", "--output", str(tmp_path), code=Exit.FAILED)
    assert said.splitlines()[-1] == f"fjr: {SENTENCE}"
    assert not list(tmp_path.iterdir())


def test_the_controller_node_ends_with_the_sentence() -> None:
    node = Executable(*NODES["controller"])
    try:
        code, said = node.end()
    finally:
        node.kill()
    assert code == 1
    assert SENTENCE in said
    assert "Traceback" not in said
