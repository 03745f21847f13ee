# SPDX-License-Identifier: Apache-2.0
"""Declare the commands on a running loop and its bags; the code behind each is imported when it runs."""

from __future__ import annotations

from typing import Any

import click

from fjr_msgs_py.console import options


@options.command()
@click.argument("bags", nargs=-1, required=True, metavar="BAG...", type=options.PATH)
@click.option("--scenario", metavar="NAME", help="Scenario of the robot: a name or a file. [default: next to the bag]")
@options.output_option("Folder for the reports. [default: next to the bag]")
@click.option("--namespace", metavar="NS", default="", show_default=False, help="Namespace, if a bag has several.")
@options.film_option
@click.option(
    "--table", "series", type=options.PATH, metavar="FILE", help="Write the time series as a table, .csv or .parquet."
)
@click.option("--force", is_flag=True, help="Replace an earlier table.")
def report(**given: Any) -> Any:
    """Write pages and figures from bags of any robot.

    BAG is the folder of a run, the folder of a bag, or an .mcap or .db3 file.
    """
    return options.implementation("fjr_monitor.report.write").report(**given)


@options.COMMANDS.command()
@click.argument("topic")
@click.option("--once", "count", flag_value=1, type=int, default=None, help="Print only the first message.")
@click.option("--count", type=options.MESSAGES, metavar="N", help="Print only N messages.")
@click.option(
    "--timeout",
    type=options.SECONDS,
    metavar="S",
    help=f"Give up after S seconds without a message. [default: {options.FIRST:g} with --once, else never]",
)
@options.force_over_ros2
@options.json_lines
def echo(**given: Any) -> Any:
    """Print the messages of a topic, as `ros2 topic echo`."""
    return options.implementation("fjr_monitor.recording.topics").echo(**given)


@options.command()
@click.argument("topics", nargs=-1, metavar="[TOPIC]...")
@options.output_option("A new folder. [default: bag_ and the time]")
@options.duration_option("Duration in seconds, from the first message on. [default: until Ctrl-C]")
@options.force_over_ros2
def record(**given: Any) -> Any:
    """Record topics to an MCAP bag, as `ros2 bag record`.

    All topics are recorded unless some are named.
    """
    return options.implementation("fjr_monitor.recording.topics").record(**given)


@options.command()
@click.argument("bag", type=options.PATH)
@click.argument("topics", nargs=-1, metavar="[TOPIC]...")
@click.option("--rate", type=options.SPEED, metavar="R", default=1.0, help="Speed relative to the recording.")
@click.option("--efforts", is_flag=True, help="Publish commands to a robot too; they move it.")
@options.force_over_ros2
def play(**given: Any) -> Any:
    """Publish the messages of a bag, as `ros2 bag play`.

    BAG is the folder of a run, the folder of a bag, or an .mcap or .db3 file. All topics but the commands to a robot
    are played unless some are named. Ctrl-C ends.
    """
    return options.implementation("fjr_monitor.recording.topics").play(**given)


@options.COMMANDS.command()
@options.scenario_argument
@click.option("--namespace", type=options.ros_name, metavar="NS", default="/", help="Namespace of the nodes.")
@click.option(
    "--controller", type=options.ros_name, metavar="NAME", default="fjr_controller", help="Name of the controller node."
)
@click.option("--once", is_flag=True, help="Print the state once as plain text.")
@click.option(
    "--timeout", type=options.SECONDS, metavar="S", default=options.FIRST, help="Longest wait of --once for the nodes."
)
@click.option(
    "--remap",
    "remaps",
    metavar="FROM:=TO",
    type=options.remap,
    multiple=True,
    help="Remap a topic, e.g. joint_states:=/robot/joint_states; may be repeated.",
)
@click.option("--browser", is_flag=True, help="Show the arm in 3D on a page of this computer.")
@click.option("--port", type=options.PORT, metavar="N", help="Port of the page; 0: any free one. [default: 0]")
@options.json_lines
def watch(**given: Any) -> Any:
    """Watch a running loop in terminal or browser.

    The displayed effort limits are those of SCENARIO, by default those of the URDF on /robot_description. So is the arm
    of --browser.
    """
    return options.implementation("fjr_monitor.watch.app").watch(**given)
