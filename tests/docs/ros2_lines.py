# SPDX-License-Identifier: Apache-2.0
"""Check `ros2 ...` lines against running nodes: executables, files, parameters, topics, services, types, values."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import yaml
from ament_index_python.packages import get_package_prefix, get_package_share_directory
from rclpy.node import Node
from rclpy.parameter import Parameter

from fjr_core.config import ros_yaml
from fjr_monitor.recording.message_types import interface_class
from fjr_msgs_py.messages.plain import fill

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
