# SPDX-License-Identifier: Apache-2.0
"""Declare the commands that run scenarios and talk to nodes; the code behind each is imported when it runs."""

from __future__ import annotations

from typing import Any

import click

from fjr_msgs_py.console import options
from fjr_msgs_py.console.options import (
    command,
    duration_option,
    film_option,
    force_over_ros2,
    implementation,
    output_option,
    scenario_argument,
    set_option,
)
from fjr_msgs_py.console.output import Result, phase

stamped_duration = duration_option("Duration of a run in seconds of stamped time.", 5.0)
runs_folder = output_option("Folder for the folders of runs.", "runs")
service_timeout = click.option(
    "--timeout",
    type=options.SECONDS,
    metavar="S",
    default=options.FIRST,
    help="Longest wait for the node and for its response.",
)


@command()
@stamped_duration
@runs_folder
def demo(**given: Any) -> Any:
    """Run three scenarios in real time and print a table.

    The scenarios are the paper's two and a 7-joint arm. A run that fails because the computer is too busy for real
    time is repeated in lock-step.
    """
    with phase("loading ROS 2 and CasADi"):
        module = implementation("fjr_bringup.cli.run")
    return module.demo(**given)


@command()
@scenario_argument
@click.option("--lockstep", is_flag=True, help="Simulate one sample per command, independently of the clock.")
@click.option("--engine", metavar="NAME", help="Simulator of the plant: own, mujoco, drake; --set engine:=NAME.")
@click.option("--force", is_flag=True, help="Run a scenario even if it is unstable as sampled.")
@click.option("--no-report", is_flag=True, help="Write report.json only, no page and no picture.")
@click.option("--viewer", is_flag=True, help="Show the arm in MuJoCo's viewer while it runs.")
@film_option
@set_option
@stamped_duration
@runs_folder
def run(**given: Any) -> Any:
    """Run one scenario on two ROS 2 nodes and report it.

    SCENARIO is the name of an installed scenario (see `fjr scenarios`) or a YAML file.
    """
    return implementation("fjr_bringup.cli.run").run_scenario(**given)


@command()
def scenarios() -> Any:
    """List the installed scenarios."""
    there = implementation("fjr_msgs_py.scenarios")
    found = [
        {"name": name, "summary": there.summary(path), "file": path}
        for name, path in there.installed("scenarios").items()
    ]
    return Result("\n".join(f"{each['name']:12}  {each['summary']}" for each in found), {"scenarios": found})


@command()
@click.argument("service")
@click.argument("request", default="")
@service_timeout
@force_over_ros2
def call(**given: Any) -> Any:
    """Call a service, as `ros2 service call`.

    REQUEST holds the fields of the request as YAML, e.g. "{data: true}", or the value of the only field.
    """
    return implementation("fjr_bringup.cli.running_nodes").call_service(**given)


@command("set", context_settings={"ignore_unknown_options": True})  # such as -0.5
@click.argument("node")
@click.argument("parameter")
@click.argument("value")
@service_timeout
@force_over_ros2
def set_parameter(**given: Any) -> Any:
    """Set a parameter of a node, as `ros2 param set`.

    VALUE is YAML of the type that the node declares, e.g. 0.05 or "[0.1, 0.2]".
    """
    return implementation("fjr_bringup.cli.running_nodes").set_value(**given)


@command()
@click.argument("node")
@click.argument("transition", required=False)
@service_timeout
@force_over_ros2
def lifecycle(**given: Any) -> Any:
    """Show or change the state of a node, as `ros2 lifecycle`.

    TRANSITION is configure, activate, deactivate, cleanup or shutdown; without it the state is printed.
    """
    return implementation("fjr_bringup.cli.running_nodes").change_state(**given)


@command()
@click.argument("motion", metavar="FILE", type=options.PATH)
@click.option("--scenario", metavar="NAME", help="Scenario of the robot, to check the efforts: a name or a file.")
@click.option("--lead", type=options.SECONDS, metavar="S", default=2.0, help="Time in which to reach the first sample.")
@click.option(
    "--tolerance",
    type=options.distances,
    metavar="D[,D..]",
    default="0.001",
    help="Largest distance [rad, m] of the smoothed motion from the samples, one or one per joint; 0: interpolate.",
)
@click.option("--namespace", metavar="NS", default="/", help="Namespace of the nodes.")
@click.option("--controller", metavar="NAME", default="fjr_controller", help="Name of the controller node.")
def send(**given: Any) -> Any:
    """Send a motion to a running controller.

    FILE is CSV or Parquet with the columns time [s] and each joint. The motion is smoothed, see docs/references.md.
    """
    return implementation("fjr_bringup.cli.running_nodes").send_motion(**given)
