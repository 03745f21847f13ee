# SPDX-License-Identifier: Apache-2.0
"""Every name on a page exists: of code, of tests, and in the documented commands that no test runs (shell.NOT_RUN)."""

from __future__ import annotations

import ast
import re
import subprocess
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import click
import pytest
import yaml
from ament_index_python.packages import get_package_prefix, get_package_share_directory
from rclpy.node import Node
from rclpy.parameter import Parameter

import fjr_core
from bench.__main__ import parser as bench_parser
from docs.pages import PAGES, ROOT, blocks, inline, links, tokens
from docs.shell import NOT_RUN, commands, is_run, program, words
from fjr_bringup.cli.app import fjr
from fjr_core.config import ros_yaml
from fjr_monitor.recording.message_types import interface_class
from fjr_msgs_py.console.ending import MEANINGS, Exit
from fjr_msgs_py.messages.plain import fill
from longest_first import LONGEST_FIRST
from nodes.harness import Ros

SOURCES = ROOT / "ros2_ws" / "src"
CORE = SOURCES / "fjr_core" / "fjr_core"
HOMES = [folder for package in sorted(SOURCES.iterdir()) for folder in (package / package.name, package)]
FOLDERS = (CORE, *HOMES, ROOT / "tests" / "core", ROOT / "tests", ROOT)
"""Folders to which the paths on a page are relative, in search order."""
MAPS = tuple(ROOT / "docs" / name for name in ("paper_map.md", "tables/beyond_the_paper.md"))
PATH = re.compile(r"([\w*/]+(?:\.(?:py|c|md)|/))(?:::([\w.]+))?")
NAME = re.compile(r"[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*")


def cells(page: Path) -> Iterator[list[str]]:
    """Return the inline code of each cell of a table."""
    found = tokens(page)
    for before, token in zip(found, found[1:], strict=False):
        if before.type == "td_open":
            yield [child.content for child in token.children or () if child.type == "code_inline"]


def files(path: str, last: list[Path]) -> list[Path]:
    """Return the files or folder of a path, which may contain `*`, relative to the last file or to one of FOLDERS."""
    folders = [file.parent for file in last[:1]]
    return next((found for folder in (*FOLDERS, *folders) if (found := sorted(folder.glob(path.rstrip("/"))))), [])


def definitions(body: list[ast.stmt], prefix: str = "") -> Iterator[str]:
    """Return the names of functions, classes and constants, and `Class.name` of class members."""
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield prefix + node.name
        if isinstance(node, ast.ClassDef):
            yield from definitions(node.body, f"{node.name}.")
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        yield from (prefix + target.id for target in targets if isinstance(target, ast.Name))


@cache
def defined(file: Path) -> frozenset[str]:
    return frozenset(definitions(ast.parse(file.read_text(encoding="utf-8")).body) if file.suffix == ".py" else ())


@cache
def names_of_tests() -> frozenset[str]:
    return frozenset().union(*(defined(file) for file in (ROOT / "tests").rglob("test_*.py")))


def missing(cell: list[str]) -> list[str]:
    """Return missing files of a cell, and names that the last file before them does not define."""
    last: list[Path] = []
    absent = []
    for text in cell:
        path = PATH.fullmatch(text)
        if path:
            last = files(path[1], last)
            absent += [] if last else [text]
        name = path[2] if path else text if NAME.fullmatch(text) else None
        if name and name.startswith("test_") and not last:
            absent += [] if name in names_of_tests() else [name]
        elif name and last:
            known = frozenset(dir(fjr_core)).union(*(defined(file) for file in last))
            absent += [] if name in known else [text]
    return absent


def identifiers(file: Path) -> set[str]:
    """Return the names of a module that stand in its code."""
    nodes = ast.walk(ast.parse(file.read_text(encoding="utf-8")))
    return {getattr(node, key, None) for node in nodes for key in ("id", "attr", "arg", "name")}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_code_and_tests_named_on_a_page_exist(page: Path) -> None:
    said = [token.content for token in inline(page, "code_inline")]
    named = [text for text in said if "::" in text or re.fullmatch(r"test_\w+", text)]
    assert [text for text in named if missing([text])] == []


@pytest.mark.parametrize("page", MAPS, ids=lambda page: page.stem)
def test_files_functions_and_tests_named_in_a_map_exist(page: Path) -> None:
    found = [name for cell in cells(page) for name in missing(cell)]
    assert found == []


def test_symbols_of_the_notation_are_in_the_code() -> None:
    rows = [text for texts in first_column(MAPS[0]) for text in texts]
    assert len(rows) > 15
    absent = {name for text in rows for name in re.findall(r"[A-Za-z_]\w*", text)}
    for file in SOURCES.glob("*/*/**/*.py"):
        absent -= identifiers(file) if absent else set()
    assert absent == set()


def first_column(page: Path) -> Iterator[list[str]]:
    found = tokens(page)
    for row, cell, token in zip(found, found[1:], found[2:], strict=False):
        if (row.type, cell.type) == ("tr_open", "td_open"):
            yield [child.content for child in token.children or () if child.type == "code_inline"]


def test_index_links_to_every_page() -> None:
    index = ROOT / "docs" / "README.md"
    found = {(index.parent / target.partition("#")[0]).resolve() for target in links(index)}
    assert {page for page in PAGES if page != index} <= found


# Lines of `ros2`, checked against running nodes: executables, files, parameters, topics, services, types, values.


TRANSITIONS = ("configure", "activate", "deactivate", "cleanup", "shutdown")
ALONE = {"bag": ("record", "play", "info"), "lifecycle": ("get", "list"), "node": ("list", "info")}
"""Verbs without project names in their arguments."""
OPTIONS = ("--all", "--once", "--storage", "mcap", "--output", "--force")


@dataclass(frozen=True)
class Graph:
    """The nodes by full name, with the types of all their topics and services."""

    nodes: Mapping[str, Node]
    topics: Mapping[str, str]
    services: Mapping[str, str]

    @classmethod
    def of(cls, nodes: list[Node]) -> Graph:
        topics = {topic: kinds[0] for topic, kinds in nodes[0].get_topic_names_and_types()}
        services: dict[str, str] = {}
        for node in nodes:
            offered = node.get_service_names_and_types_by_node(node.get_name(), node.get_namespace())
            services |= {service: kinds[0] for service, kinds in offered}
        return cls({f"/{node.get_name()}": node for node in nodes}, topics, services)

    def check(self, words: list[str]) -> None:
        """Check a line of `ros2`, or of `fjr` for running nodes; fail for a missing name or a wrong value."""
        if words[0] == "fjr":
            words = self._as_ros2(*[word for word in words[1:] if word not in OPTIONS])
        _, verb, *rest = words
        checks: dict[str, Callable[..., None]] = {"run": self._run, "launch": self._launch, "param": self._param}
        checks |= {"topic": self._topic, "service": self._service}
        if verb in checks:
            checks[verb](*[word for word in rest if word not in OPTIONS])
        elif rest[0] not in ALONE.get(verb, ()):
            assert (verb, rest[0]) == ("lifecycle", "set"), words
            assert rest[1] in self.nodes
            assert rest[2] in TRANSITIONS

    def _as_ros2(self, verb: str, name: str, *rest: str) -> list[str]:
        """Return the line of `ros2` that does what `fjr call`, `fjr set` or `fjr lifecycle` does."""
        if verb == "call":
            return ["ros2", "service", "call", name, self.services[name], *rest]
        if verb == "set":
            return ["ros2", "param", "set", name, *rest]
        assert verb == "lifecycle"
        return ["ros2", "lifecycle", *(["set", name, *rest] if rest else ["get", name])]

    def _run(self, package: str, name: str, *arguments: str) -> None:
        assert (Path(get_package_prefix(package)) / "lib" / package / name).is_file()
        node = self.nodes[f"/{package}"]
        for option, value in zip(arguments, arguments[1:], strict=False):
            if option == "-p":
                self._set(node, *value.split(":=", 1))
            assert option != "--params-file" or "-p" not in arguments[: arguments.index(value)], (
                "-p must not come before the file"
            )
            if option == "--params-file" and value.startswith("$(ros2 pkg"):
                assert Path(expanded(value)).is_file()

    def _launch(self, package: str, file: str, *arguments: str) -> None:
        path = Path(get_package_share_directory(package)) / "launch" / file
        declared = re.findall(r'DeclareLaunchArgument\(\s*"(\w+)"', path.read_text(encoding="utf-8"))
        assert {argument.split(":=")[0] for argument in arguments} <= set(declared)

    def _param(self, verb: str, node: str, name: str = "", value: str = "") -> None:
        assert verb in ("set", "get", "describe", "list")
        assert verb == "list" or self.nodes[node].has_parameter(name), name
        if verb == "set":
            self._set(self.nodes[node], name, value)

    def _set(self, node: Node, name: str, text: str) -> None:
        assert node.has_parameter(name), name
        value = ros_yaml.parse(text)
        result = node.set_parameters([Parameter(name, value=value)])[0]
        assert result.successful or "while" in result.reason or "read-only" in result.reason, result.reason

    def _topic(self, verb: str, name: str, *given: str) -> None:
        assert verb in ("echo", "pub", "hz", "info")
        assert name in self.topics, f"{name}: {sorted(self.topics)}"
        if verb == "pub":
            assert given[0].replace("/msg/", "/").split("/") == self.topics[name].replace("/msg/", "/").split("/")
            fill(interface_class(given[0])(check_fields=True), yaml.safe_load(given[1]))

    def _service(self, verb: str, name: str, kind: str, value: str = "{}") -> None:
        assert verb == "call"
        assert self.services.get(name) == kind, f"{name}: {sorted(self.services)}"
        fill(interface_class(kind).Request(check_fields=True), yaml.safe_load(value))


def expanded(text: str) -> str:
    """Replace `$(ros2 pkg prefix --share NAME)` by its folder."""
    pattern = r"\$\(ros2 pkg prefix --share (\w+)\)"
    return re.sub(pattern, lambda found: get_package_share_directory(found[1]), text)


# Commands.


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
