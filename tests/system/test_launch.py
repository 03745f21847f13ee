# SPDX-License-Identifier: Apache-2.0
"""Every name in the launch file exists; it runs if the launch package of ROS 2 is installed."""

from __future__ import annotations

import ast
import asyncio
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import pytest
import rclpy
from ament_index_python.packages import get_package_prefix, get_package_share_directory
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState

from fjr_core.config.controller import controller_parameters
from fjr_core.config.nodes import all_parameters
from fjr_core.config.plant import plant_parameters
from fjr_core.config.scenario import load_scenario
from fjr_msgs_py.node.participant import leave
from time_limits import Limit

LIMIT = 40.0  # s on a free machine
OWN_PARAMETERS = {"fjr_plant": plant_parameters, "fjr_controller": controller_parameters}


def installed(*parts: str) -> Path:
    return Path(get_package_share_directory("fjr_bringup"), *parts)


def calls(name: str) -> list[dict[str, Any]]:
    """Return the arguments (syntax trees) of each call of `name` in the launch file, positional ones under '0'."""
    tree = ast.parse(installed("launch", "tracking.launch.py").read_text(encoding="utf-8"))
    found = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
    return [
        {str(place): argument for place, argument in enumerate(call.args)}
        | {str(k.arg): k.value for k in call.keywords}
        for call in found
        if isinstance(call.func, ast.Name) and call.func.id == name
    ]


def constant(node: ast.expr) -> Any:
    assert isinstance(node, ast.Constant)
    return node.value


def test_executables_exist() -> None:
    named = {(constant(call["package"]), constant(call["executable"])) for call in calls("Node")}
    assert named == {("fjr_plant", "plant_node"), ("fjr_controller", "controller_node")}
    for package, executable in named:
        assert Path(get_package_prefix(package), "lib", package, executable).is_file()


def test_packages_exist_and_are_dependencies() -> None:
    manifest = ElementTree.parse(installed("package.xml")).getroot()
    depends = {element.text for element in manifest.findall("exec_depend")}
    for call in calls("FindPackageShare") + calls("get_package_share_directory"):
        assert Path(get_package_share_directory(constant(call["0"]))).is_dir()
    assert {"launch", "launch_ros", *(constant(call["package"]) for call in calls("Node"))} <= depends


def test_scenarios_exist_and_fit() -> None:
    (argument,) = (call for call in calls("DeclareLaunchArgument") if constant(call["0"]) == "scenario")
    files = {path.stem: path for path in installed("scenarios").glob("*.yaml")}
    assert constant(argument["default_value"]) in files
    assert {"paper_k31", "paper_k3p1", "two_link", "arm7"} <= set(files)
    for path in files.values():
        assert load_scenario(path).warnings == ()


def test_parameters_set_by_the_launch_file_are_declared_by_the_node() -> None:
    for call in calls("Node"):
        own = OWN_PARAMETERS[constant(call["package"])]
        known = {
            "use_sim_time",
            *(parameter.name for parameter in all_parameters(own, {})),
        }  # of ROS 2, of this project
        set_here = [node for node in ast.walk(call["parameters"]) if isinstance(node, ast.Dict)]
        for node in set_here:
            assert {constant(key) for key in node.keys if key} <= known


def test_arguments_used_are_declared() -> None:
    declared = {constant(call["0"]) for call in calls("DeclareLaunchArgument")}
    assert {constant(call["0"]) for call in calls("LaunchConfiguration")} == declared


def answered_steps(count: int) -> bool:
    """Return whether `count` stamped commands arrive within the time limit."""
    context = rclpy.Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("listener", context=context)
    stamps: set[tuple[int, int]] = set()
    node.create_subscription(
        JointState, "/joint_commands", lambda m: stamps.add((m.header.stamp.sec, m.header.stamp.nanosec)), 10
    )
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    limit = Limit(LIMIT)
    while len(stamps) < count and not limit.passed():
        executor.spin_once(timeout_sec=0.1)
    executor.shutdown()
    leave(node)
    context.try_shutdown()
    return len(stamps) >= count


@pytest.mark.system
@pytest.mark.parametrize("lockstep", ["false", "true"])
def test_the_launch_file_runs_the_closed_loop(lockstep: str) -> None:
    launch = pytest.importorskip("launch", reason="ROS 2's launch is not installed")
    pytest.importorskip("launch_ros", reason="ROS 2's launch_ros is not installed")
    from launch.launch_description_sources import PythonLaunchDescriptionSource

    async def run() -> bool:
        service = launch.LaunchService(noninteractive=True)
        source = PythonLaunchDescriptionSource(str(installed("launch", "tracking.launch.py")))
        arguments = {"scenario": "paper_k31", "lockstep": lockstep}.items()
        service.include_launch_description(
            launch.LaunchDescription([launch.actions.IncludeLaunchDescription(source, launch_arguments=arguments)])
        )
        running = asyncio.ensure_future(service.run_async())
        answered = await asyncio.get_running_loop().run_in_executor(None, answered_steps, 100)
        await service.shutdown()
        assert await running == 0
        return answered

    assert asyncio.run(run())
