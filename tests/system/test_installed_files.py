# SPDX-License-Identifier: Apache-2.0
"""Layouts name topics of a run of the 7-joint arm only, the launch file what exists; it runs where ROS has launch."""

from __future__ import annotations

import asyncio
import json
import re
import runpy
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple
from unittest import mock
from xml.etree import ElementTree

import pytest
from ament_index_python.packages import get_package_prefix, get_package_share_directory

from fjr_core.config.controller import controller_parameters
from fjr_core.config.nodes import all_parameters
from fjr_core.config.plant import plant_parameters
from nodes.harness import Listener, Ros
from system.shared_runs import messages, shared_run

pytestmark = pytest.mark.system

CERTIFICATE = "/fjr_controller/certificate"
PATH = re.compile(r"(?P<topic>/[\w/]+)\.(?P<field>\w+)\[(?P<index>\d+)\](?:\.@(?P<function>\w+))?")
FUNCTIONS = {"abs", "log", "log2", "log10", "negative", "deg2rad", "rad2deg"}


Published = dict[str, Any]
"""The last message of each topic of a run."""


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> Published:
    return dict(messages(shared_run(tmp_path_factory, "arm7")))


def installed(*parts: str) -> Path:
    return Path(get_package_share_directory("fjr_bringup"), *parts)


FOXGLOVE: dict[str, Any] = json.loads(installed("config", "foxglove_layout.json").read_text(encoding="utf-8"))


def panels(layout: Any) -> list[str]:
    return [layout] if isinstance(layout, str) else panels(layout["first"]) + panels(layout["second"])


def test_foxglove_plots_numbers_that_are_published(published: Published) -> None:
    assert sorted(panels(FOXGLOVE["layout"])) == sorted(FOXGLOVE["configById"])  # each panel once
    plots = [panel for name, panel in FOXGLOVE["configById"].items() if name.startswith("Plot!")]
    assert len(plots) == 6
    for path in (path["value"] for plot in plots for path in plot["paths"]):
        found = PATH.fullmatch(path)
        assert found, path
        assert found["function"] is None or found["function"] in FUNCTIONS
        check_number(published, found["topic"], found["field"], int(found["index"]))
    labels = [label for part in published[CERTIFICATE].layout.dim for label in part.label.split(",")]
    meant = {"V": "V", "bound": "bound", "measured": "dV_measured", "predicted": "dV_predicted"}
    for plot in ("Plot!storage", "Plot!power"):
        for path in FOXGLOVE["configById"][plot]["paths"]:
            assert labels[int(PATH.fullmatch(path["value"])["index"])] == meant[path["label"]]


def check_number(published: Published, topic: str, field: str, index: int) -> None:
    assert isinstance(float(getattr(published[topic], field)[index]), float)  # the topic is there, and the number


def test_foxglove_shows_the_arm_its_health_and_its_events(published: Published) -> None:
    panels = FOXGLOVE["configById"]
    urdf = panels["3D!arm"]["layers"]["urdf"]
    assert published[urdf["topic"]].__msgtype__ == "std_msgs/msg/String"
    assert published[urdf["jointStatesTopic"]].__msgtype__ == "sensor_msgs/msg/JointState"
    robot = ElementTree.fromstring(published[urdf["topic"]].data)
    assert panels["3D!arm"]["followTf"] in {link.get("name") for link in robot.iter("link")}
    moving = {joint.get("name") for joint in robot.iter("joint") if joint.get("type") != "fixed"}
    assert moving <= set(published[urdf["jointStatesTopic"]].name)
    topics = panels["DiagnosticSummary!health"]["topicToRender"], panels["RawMessages!events"]["topicPath"]
    assert published[topics[0]].__msgtype__ == "diagnostic_msgs/msg/DiagnosticArray"
    assert published[topics[1]].__msgtype__ == "diagnostic_msgs/msg/DiagnosticStatus"


def test_plotjuggler_plots_numbers_that_are_published(published: Published) -> None:
    """PlotJuggler's parsers name curves of joint states by joint and those of arrays by index."""
    layout = ElementTree.parse(installed("config", "plotjuggler_layout.xml"))
    curves = [curve.get("name", "") for curve in layout.iter("curve")]
    assert len(curves) > 30
    for curve in curves:
        array = re.fullmatch(r"(/[\w/]+)/data\[(\d+)\]", curve)
        if array:
            check_number(published, array[1], "data", int(array[2]))
            continue
        topic, joint, field = curve.rsplit("/", 2)
        message = published[topic]
        assert len(getattr(message, field)) > list(message.name).index(joint)


PARAMETERS = {"fjr_plant": plant_parameters, "fjr_controller": controller_parameters}
MODULES = ("launch", "launch.actions", "launch.substitutions", "launch_ros", "launch_ros.actions")
MODULES += ("launch_ros.parameter_descriptions", "launch_ros.substitutions")


class Call(NamedTuple):
    """A call of the launch file, instead of the object of `launch` that it would make."""

    name: str
    arguments: tuple[Any, ...]
    named: dict[str, Any]


class StandIn(ModuleType):
    """A module of `launch` in which every name is a function that returns its Call."""

    def __getattr__(self, name: str) -> Any:
        return lambda *arguments, **named: Call(name, arguments, named)


@pytest.fixture(scope="module")
def calls() -> list[Call]:
    """Return all calls of the launch file."""
    with mock.patch.dict(sys.modules, {name: StandIn(name) for name in MODULES}):
        described = runpy.run_path(str(installed("launch", "tracking.launch.py")))["generate_launch_description"]()
    return list(within(described))


def within(value: Any) -> Iterator[Call]:
    if isinstance(value, Call):
        yield value
        yield from within([*value.arguments, *value.named.values()])
    elif isinstance(value, list | dict):
        for each in value.values() if isinstance(value, dict) else value:
            yield from within(each)


def named(calls: list[Call], name: str) -> list[Call]:
    return [call for call in calls if call.name == name]


def test_executables_packages_scenarios_and_parameters_exist(calls: list[Call]) -> None:
    nodes = {
        (call.named["package"], call.named["executable"]): call.named["parameters"] for call in named(calls, "Node")
    }
    assert set(nodes) == {("fjr_plant", "plant_node"), ("fjr_controller", "controller_node")}
    for (package, executable), given in nodes.items():
        assert Path(get_package_prefix(package), "lib", package, executable).is_file()
        known = {"use_sim_time", *(parameter.name for parameter in all_parameters(PARAMETERS[package], {}))}
        assert {name for each in given if isinstance(each, dict) for name in each} <= known
    depends = {element.text for element in ElementTree.parse(installed("package.xml")).iter("exec_depend")}
    assert {"launch", "launch_ros", *(package for package, _ in nodes)} <= depends
    assert all(Path(get_package_share_directory(*call.arguments)).is_dir() for call in named(calls, "FindPackageShare"))
    declared = {call.arguments[0]: call.named for call in named(calls, "DeclareLaunchArgument")}
    files = sorted(path.stem for path in installed("scenarios").glob("*.yaml"))
    assert declared["scenario"]["default_value"] in declared["scenario"]["choices"] == files
    assert {call.arguments[0] for call in named(calls, "LaunchConfiguration")} == set(declared)


@pytest.mark.parametrize("lockstep", ["false", "true"])
def test_the_launch_file_runs_the_closed_loop(ros: Ros, lockstep: str) -> None:
    launch = pytest.importorskip("launch", reason="ROS 2's launch is not installed")
    pytest.importorskip("launch_ros", reason="ROS 2's launch_ros is not installed")
    from launch.launch_description_sources import PythonLaunchDescriptionSource

    listener = Listener(ros, only=["joint_commands"])

    def answered() -> None:
        ros.until(lambda: len(listener.commands) >= 100, "100 answers")

    async def run() -> None:
        service = launch.LaunchService(noninteractive=True)
        source = PythonLaunchDescriptionSource(str(installed("launch", "tracking.launch.py")))
        arguments = {"scenario": "paper_k31", "lockstep": lockstep}.items()
        service.include_launch_description(
            launch.LaunchDescription([launch.actions.IncludeLaunchDescription(source, launch_arguments=arguments)])
        )
        running = asyncio.ensure_future(service.run_async())
        await asyncio.get_running_loop().run_in_executor(None, answered)
        await service.shutdown()
        assert await running == 0

    asyncio.run(run())
