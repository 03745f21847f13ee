# SPDX-License-Identifier: Apache-2.0
"""Every name in the documented commands that no test runs (shell.NOT_RUN) exists."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from bench.__main__ import parser as bench_parser
from docs.pages import PAGES, ROOT, blocks, inline
from docs.ros2_lines import Graph
from docs.shell import NOT_RUN, commands, is_run, program, words
from fjr_bringup.cli.app import fjr
from fjr_msgs_py.console.ending import MEANINGS, Exit
from longest_first import LONGEST_FIRST
from nodes.harness import Ros

HELD = [c for page in PAGES for b in blocks(page) if b.language == "sh" for c in commands(b.text) if not is_run(c)]
SAID = [token.content for page in PAGES for token in inline(page, "code_inline")]
PATHS = {"cd", "source", "colcon", "rosdep", ".venv/bin/python"}


def starting(word: str) -> list[list[str]]:
    """Return the words of all commands that start with a word, in blocks and, if they have arguments, in the text."""
    said = [text for text in SAID if text.startswith(f"{word} ")]
    return [words(command) for command in (*HELD, *said) if words(command)[0] == word]


@pytest.fixture
def graph(ros: Ros) -> Iterator[Graph]:
    plant, controller = ros.plant(executor="events"), ros.controller(executor="events")  # all in one participant
    ros.until(lambda: "/fjr_controller/events" in dict(plant.get_topic_names_and_types()), "the controller")
    ros.until(lambda: "fjr_plant" in controller.get_node_names(), "the plant")
    return Graph.of([plant, controller])


def test_names_in_lines_for_running_nodes_exist(graph: Graph) -> None:
    ros2 = [line for line in starting("ros2") if len(line) > 3]
    own = [line for line in starting("fjr") if len(line) > 2 and " ".join(line[:2]) in NOT_RUN]
    assert len(ros2) > 10
    assert len(own) > 5
    for line in (*ros2, *own):
        graph.check(line)


def test_lists_of_commands_and_files_name_what_is_there() -> None:
    assert {program(command) for command in HELD} <= set(NOT_RUN)
    assert [name for name in LONGEST_FIRST if not (ROOT / "tests" / name).is_file()] == []


def test_fjr_commands_in_the_text_exist() -> None:
    for text in SAID:
        if text.startswith("fjr "):
            name, *rest = words(text)[1:]
            if name in ("--help", "--version"):
                continue
            assert name in fjr.commands, text
            known = {option for parameter in fjr.commands[name].params for option in parameter.opts}
            assert {word for word in rest if word.startswith("--")} <= known, text


def test_every_exit_code_is_documented() -> None:
    page = (ROOT / "docs" / "reports.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\d+) \| (.*) \|$", page, flags=re.MULTILINE)
    assert {int(code): meaning for code, meaning in rows} == {code.value: MEANINGS[code] for code in Exit}
    said = fjr.get_help(click.Context(fjr, info_name="fjr"))
    assert all(f"  {code:<4} {meaning.replace('`', '')}" in said for code, meaning in MEANINGS.items())


def test_make_targets_and_their_arguments_exist() -> None:
    for _, *rest in starting("make"):
        targets = [word for word in rest if "=" not in word]
        done = subprocess.run(["make", "-n", *targets], cwd=ROOT, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        for name, _, value in (word.partition("=") for word in rest if "=" in word):
            assert f"{name} ?=" in (ROOT / "Makefile").read_text(encoding="utf-8"), name
            if name == "BENCH_ARGS":
                bench_parser().parse_args(value.split())


def test_files_folders_and_modules_of_the_checkout_exist() -> None:
    for first, *rest in map(words, HELD):
        for word in rest if first in PATHS else ():
            if word.startswith(("ros2_ws", "tools/", "docs/")):
                assert (ROOT / word).exists(), word
        if first == "python":
            assert rest[0] == "-m"
            module = Path(ROOT, *rest[1].split("."))
            assert (module / "__main__.py").is_file() or module.with_suffix(".py").is_file()
