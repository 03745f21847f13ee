# SPDX-License-Identifier: Apache-2.0
"""Start plant and controller with the parameters of a scenario.

ros2 launch fjr_bringup tracking.launch.py scenario:=paper_k31
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterFile, ParameterValue
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    installed = Path(get_package_share_directory("fjr_bringup"), "scenarios").glob("*.yaml")
    folder_and_name = PathJoinSubstitution(
        [FindPackageShare("fjr_bringup"), "scenarios", LaunchConfiguration("scenario")]
    )
    scenario_file = ParameterFile([folder_and_name, ".yaml"])
    lockstep = ParameterValue(LaunchConfiguration("lockstep"), value_type=bool)
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "scenario",
                default_value="paper_k31",
                choices=sorted(path.stem for path in installed),
                description="Name of the parameter file in fjr_bringup/scenarios that both nodes read",
            ),
            DeclareLaunchArgument(
                "lockstep",
                default_value="false",
                choices=["true", "false"],
                description="Simulate one sample per command, independently of the clock",
            ),
            Node(
                package="fjr_plant",
                executable="plant_node",
                output="screen",
                parameters=[scenario_file, {"lockstep": lockstep}],
            ),
            Node(
                package="fjr_controller",
                executable="controller_node",
                output="screen",
                parameters=[scenario_file, {"use_sim_time": lockstep}],
            ),
        ]
    )
