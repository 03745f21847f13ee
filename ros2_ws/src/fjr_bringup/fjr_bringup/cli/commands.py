# SPDX-License-Identifier: Apache-2.0
"""Declare the commands of `fjr`: names, arguments, options and help. The code behind each is imported when it runs.

A command returns a Result, which is printed as text or, with --json, as JSON.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from importlib import import_module
from types import ModuleType
from typing import Any

import click

from fjr_bringup.cli import options
from fjr_bringup.cli.options import duration_option, output_option, scenario_argument, set_option
from fjr_bringup.progress import phase


def implementation(name: str) -> ModuleType:
    """Import the module of a command, then call `loaded` (see app.main)."""
    module = import_module(f"fjr_bringup.cli.{name}")
    click.get_current_context().obj()
    return module


COMMANDS = click.Group()
"""All commands, in the order of the help."""


def command(name: str | None = None, **settings: Any) -> Callable[[Callable[..., Any]], click.Command]:
    """Return a decorator that declares a command with --json; settings: as of click. The function returns a Result."""

    def declare(function: Callable[..., Any]) -> click.Command:
        @wraps(function)
        def shown(as_json: bool, **given: Any) -> int:
            return int(function(**given).show(as_json))

        made = COMMANDS.command(name, **settings)(shown)
        made.params.append(click.Option(["--json", "as_json"], is_flag=True, help="Print the result as JSON."))
        return made

    return declare


json_lines = click.option("--json", "as_json", is_flag=True, help="Print each as JSON in one line.")
stamped_duration = duration_option("Duration of a run in seconds of stamped time.", 5.0)
runs_folder = output_option("Folder for the folders of runs.", "runs")
service_timeout = click.option(
    "--timeout", type=options.SECONDS, metavar="S", default=30.0, help="Longest wait for the node and for its response."
)
force_over_ros2 = click.option("--force", is_flag=True, help="Run although ros2 is on the PATH.")


@command()
@stamped_duration
@runs_folder
def demo(**given: Any) -> Any:
    """Run three scenarios in real time and print a table.

    The scenarios are the paper's two and a 7-joint arm. A run that fails because the computer is too busy for real
    time is repeated in lock-step.
    """
    with phase("loading ROS 2 and CasADi"):
        module = implementation("run")
    return module.demo(**given)


@command()
@scenario_argument
@click.option("--lockstep", is_flag=True, help="Simulate one sample per command, independently of the clock.")
@click.option("--force", is_flag=True, help="Run a scenario even if it is unstable as sampled.")
@click.option("--no-report", is_flag=True, help="Write report.json only, no page and no picture.")
@set_option
@stamped_duration
@runs_folder
def run(**given: Any) -> Any:
    """Run one scenario on two ROS 2 nodes and report it.

    SCENARIO is the name of an installed scenario (see `fjr scenarios`) or a YAML file.
    """
    return implementation("run").run_scenario(**given)


@command()
@click.argument("bags", nargs=-1, required=True, metavar="BAG...", type=options.PATH)
@click.option("--scenario", metavar="NAME", help="Scenario of the robot: a name or a file. [default: next to the bag]")
@output_option("Folder for the reports. [default: next to the bag]")
@click.option(
    "--namespace",
    metavar="NS",
    default="",
    show_default=False,
    help="Namespace of the nodes, if the bag holds several.",
)
def report(**given: Any) -> Any:
    """Write pages and figures from bags of any robot.

    BAG is the folder of a run, the folder of a bag, or an .mcap or .db3 file.
    """
    return implementation("report").report(**given)


@command()
@scenario_argument
@set_option
def check(**given: Any) -> Any:
    """Check rates, stability and margins before a run.

    SCENARIO is the name of an installed scenario (see `fjr scenarios`) or a YAML file.
    """
    return implementation("check").check_scenario(**given)


@command()
@scenario_argument
@click.option("--beta", type=options.RATE, metavar="B", required=True, help="Required rate of convergence [1/s].")
@click.option("--delay", type=options.SAMPLES, metavar="D", default=0.0, help="Delay of the loop in samples.")
@click.option("--everywhere", is_flag=True, help="Cover the joints' whole range instead of the reference only.")
@set_option
def gains(**given: Any) -> Any:
    """Synthesise gains and print them as YAML.

    SCENARIO is the name of an installed scenario (see `fjr scenarios`) or a YAML file.
    """
    return implementation("gains").synthesised(**given)


@command()
def scenarios() -> Any:
    """List the installed scenarios."""
    return implementation("scenarios").list_scenarios()


@command()
@scenario_argument
@click.option("--run", "run_folder", type=options.PATH, metavar="DIR", help="Folder of a recorded run to follow.")
@duration_option("Duration in seconds.", 1.0)
@click.option("--starts", type=options.SOLUTIONS, metavar="M", default=8, help="Number of virtual solutions, 2 to 64.")
@click.option(
    "--spread", type=options.ANGLE, metavar="RAD", default=0.5, help="Largest initial distance of the links [rad]."
)
@click.option("--seed", type=int, metavar="N", default=0, help="Seed of the random initial states.")
@output_option("Folder in which contraction/ is written.", "runs")
@set_option
def contraction(**given: Any) -> Any:
    """Show that solutions of the virtual system converge.

    SCENARIO is the name of an installed scenario (see `fjr scenarios`) or a YAML file.
    """
    return implementation("studies").contraction(**given)


@command()
@scenario_argument
@set_option
def description(**given: Any) -> Any:
    """Print a robot as URDF for robot_state_publisher.

    SCENARIO is the name of an installed scenario (see `fjr scenarios`) or a YAML file.
    """
    return implementation("export").describe(**given)


@command()
@scenario_argument
@click.option("--runs", type=options.RUNS, metavar="N", help="Number of runs. [default: the sweep's, else 1000]")
@click.option("--seed", type=int, metavar="N", help="Seed of all random numbers. [default: the sweep's, else 0]")
@duration_option("Duration of a run in seconds. [default: the sweep's, else 5]")
@click.option("--cores", type=options.cores, metavar="N", default="1", help="Cores of this machine, or `all`.")
@click.option(
    "--scheduler", metavar="ADDRESS", help="Dask cluster to use instead of this machine, e.g. tcp://host:8786."
)
@output_option("Folder in which NAME/ is written.", "runs/sweeps")
@set_option
def sweep(**given: Any) -> Any:
    """Run a Monte-Carlo study of model errors.

    SCENARIO is the name of an installed sweep or scenario, or a YAML file of either.
    """
    return implementation("studies").sweep(**given)


@command("export-c")
@click.argument("scenario", shell_complete=options.complete_scenario)
@click.argument("folder", metavar="DIR", type=options.PATH)
@click.option("--prefix", metavar="NAME", help="Prefix of all names in C. [default: the scenario's name]")
@click.option("--force", is_flag=True, help="Replace an earlier export; other files are kept.")
@set_option
def export_c(**given: Any) -> Any:
    """Export law, plant and reference as C99.

    SCENARIO is the name of an installed scenario or a YAML file. DIR is a new or empty folder.
    """
    return implementation("export").export_scenario(**given)


@command()
@click.argument("suite", default="paper")
@output_option("Folder in which compare_SUITE/ is written.", "runs")
@click.option("--cores", type=options.cores, metavar="N", help="Cores of this machine, or `all`. [default: all]")
@click.option(
    "--document",
    type=options.PATH,
    metavar="[FILE]",
    is_flag=False,
    flag_value="docs/compare.md",
    help="Write the table into FILE too. [FILE: docs/compare.md]",
)
@click.option(
    "--readme",
    type=options.PATH,
    is_flag=False,
    flag_value="docs/compare.md",
    hidden=True,
    help="Deprecated in 0.1.0: use --document.",
)
def compare(**given: Any) -> Any:
    """Compare control laws under non-idealities.

    SUITE is the name of a comparison or a YAML file. [default: paper]
    """
    return implementation("studies").compare(**given)


@COMMANDS.command()
@click.argument("topic")
@click.option("--once", "count", flag_value=1, type=int, default=None, help="Print only the first message.")
@click.option("--count", type=options.MESSAGES, metavar="N", help="Print only N messages.")
@click.option("--timeout", type=options.SECONDS, metavar="S", help="Give up after S seconds without a message.")
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


@COMMANDS.command()
@click.argument("motion", metavar="FILE", type=options.PATH)
@click.option("--scenario", metavar="NAME", help="Scenario of the robot, to check the efforts: a name or a file.")
@click.option("--lead", type=options.SECONDS, metavar="S", default=2.0, help="Time in which to reach the first sample.")
@click.option(
    "--tolerance",
    type=options.DISTANCE,
    metavar="RAD",
    default=1e-3,
    help="Largest distance of the smoothed motion from the samples; 0: interpolate them.",
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
    "--remap",
    "remaps",
    metavar="FROM:=TO",
    type=options.remap,
    multiple=True,
    help="Remap a topic, e.g. joint_states:=/robot/joint_states; may be repeated.",
)
@json_lines
def watch(**given: Any) -> Any:
    """Watch a running control loop in the terminal.

    The displayed effort limits are those of SCENARIO, by default those of the URDF.
    """
    return implementation("live").watch_loop(**given)
