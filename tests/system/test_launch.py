# SPDX-License-Identifier: Apache-2.0
"""Every name in the launch file exists; it runs if the launch package of ROS 2 is installed."""

from __future__ import annotations

import asyncio
import runpy
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple
from unittest import mock

import pytest
from ament_index_python.packages import get_package_prefix, get_package_share_directory

from fjr_core.config.controller import controller_parameters
from fjr_core.config.nodes import all_parameters
from fjr_core.config.plant import plant_parameters
from fjr_core.config.scenario import load_scenario
from nodes.harness import Listener, Ros

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


def installed(*parts: str) -> Path:
    return Path(get_package_share_directory("fjr_bringup"), *parts)


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


def test_executables_and_packages_exist_and_are_dependencies(calls: list[Call]) -> None:
    nodes = {(call.named["package"], call.named["executable"]) for call in named(calls, "Node")}
    assert nodes == {("fjr_plant", "plant_node"), ("fjr_controller", "controller_node")}
    for package, executable in nodes:
        assert Path(get_package_prefix(package), "lib", package, executable).is_file()
    depends = {element.text for element in ElementTree.parse(installed("package.xml")).iter("exec_depend")}
    assert {"launch", "launch_ros", *(package for package, _ in nodes)} <= depends
    assert all(Path(get_package_share_directory(*call.arguments)).is_dir() for call in named(calls, "FindPackageShare"))


def test_scenarios_exist_and_fit(calls: list[Call]) -> None:
    declared = {call.arguments[0]: call.named for call in named(calls, "DeclareLaunchArgument")}
    files = {path.stem: path for path in installed("scenarios").glob("*.yaml")}
    assert declared["scenario"]["default_value"] in declared["scenario"]["choices"] == sorted(files)
    assert {"paper_k31", "paper_k3p1", "two_link", "arm7"} <= set(files)
    for path in files.values():
        assert load_scenario(path).warnings == ()
    assert {call.arguments[0] for call in named(calls, "LaunchConfiguration")} == set(declared)


def test_parameters_set_by_the_launch_file_are_declared_by_the_node(calls: list[Call]) -> None:
    for call in named(calls, "Node"):
        own = PARAMETERS[call.named["package"]]
        known = {
            "use_sim_time",
            *(parameter.name for parameter in all_parameters(own, {})),
        }  # of ROS 2, of this project
        assert {name for each in call.named["parameters"] if isinstance(each, dict) for name in each} <= known


@pytest.mark.system
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
