# SPDX-License-Identifier: Apache-2.0
"""The commands on a running control loop and its bags."""

from __future__ import annotations

from typing import Any

import click

from fjr_bringup.cli import options
from fjr_bringup.cli.commands.declaration import COMMANDS, command, implementation
from fjr_bringup.cli.options import duration_option, output_option, scenario_argument

json_lines = click.option("--json", "as_json", is_flag=True, help="Print each as JSON in one line.")
service_timeout = click.option(
    "--timeout",
    type=options.SECONDS,
    metavar="S",
    default=options.FIRST,
    help="Longest wait for the node and for its response.",
)
force_over_ros2 = click.option("--force", is_flag=True, help="Run although ros2 is on the PATH.")


@COMMANDS.command()
@click.argument("topic")
@click.option("--once", "count", flag_value=1, type=int, default=None, help="Print only the first message.")
@click.option("--count", type=options.MESSAGES, metavar="N", help="Print only N messages.")
@click.option(
    "--timeout",
    type=options.SECONDS,
    metavar="S",
    help=f"Give up after S seconds without a message. [default: {options.FIRST:g} with --once, else never]",
)
@force_over_ros2
@json_lines
def echo(**given: Any) -> Any:
    """Print the messages of a topic, as `ros2 topic echo`."""
    return implementation("live").echo_topic(**given)


@command()
@click.argument("topics", nargs=-1, metavar="[TOPIC]...")
@output_option("A new folder. [default: bag_ and the time]")
@duration_option("Duration in seconds. [default: until Ctrl-C]")
@force_over_ros2
def record(**given: Any) -> Any:
    """Record topics to an MCAP bag, as `ros2 bag record`.

    All topics are recorded unless some are named.
    """
    return implementation("live").record_topics(**given)


@command()
@click.argument("bag", type=options.PATH)
@click.argument("topics", nargs=-1, metavar="[TOPIC]...")
@click.option("--rate", type=options.SPEED, metavar="R", default=1.0, help="Speed relative to the recording.")
@click.option("--efforts", is_flag=True, help="Publish commands to a robot too; they move it.")
@force_over_ros2
def play(**given: Any) -> Any:
    """Publish the messages of a bag, as `ros2 bag play`.

    BAG is the folder of a run, the folder of a bag, or an .mcap or .db3 file. All topics but the commands to a robot
    are played unless some are named. Ctrl-C ends.
    """
    return implementation("live").play_bag(**given)


@command()
@click.argument("service")
@click.argument("request", default="")
@service_timeout
@force_over_ros2
def call(**given: Any) -> Any:
    """Call a service, as `ros2 service call`.

    REQUEST holds the fields of the request as YAML, e.g. "{data: true}", or the value of the only field.
    """
    return implementation("services").call_service(**given)


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
    return implementation("services").set_value(**given)


@command()
@click.argument("node")
@click.argument("transition", required=False)
@service_timeout
@force_over_ros2
def lifecycle(**given: Any) -> Any:
    """Show or change the state of a node, as `ros2 lifecycle`.

    TRANSITION is configure, activate, deactivate, cleanup or shutdown; without it the state is printed.
    """
    return implementation("services").change_state(**given)


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
    return implementation("send").send_motion(**given)


@COMMANDS.command()
@scenario_argument
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
@click.option("--foxglove", is_flag=True, help="Serve Foxglove on this computer; needs foxglove-sdk.")
@click.option(
    "--port",
    type=options.PORT,
    metavar="N",
    help="Port of the page or of Foxglove; 0: any free one. [default: page: 0, Foxglove: 8765]",
)
@json_lines
def watch(**given: Any) -> Any:
    """Watch a running loop in terminal, browser or Foxglove.

    The displayed effort limits are those of SCENARIO, by default those of the URDF on /robot_description. So is the arm
    of --browser.
    """
    return implementation("live").watch_loop(**given)
