# SPDX-License-Identifier: Apache-2.0
"""The commands on scenarios: run, check, synthesise, export."""

from __future__ import annotations

from typing import Any

import click

from fjr_bringup.cli import options
from fjr_bringup.cli.commands.declaration import command, implementation
from fjr_bringup.cli.options import duration_option, output_option, scenario_argument, set_option
from fjr_bringup.progress import phase

stamped_duration = duration_option("Duration of a run in seconds of stamped time.", 5.0)
runs_folder = output_option("Folder for the folders of runs.", "runs")


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
@click.argument("urdf", type=options.PATH)
@click.option(
    "--joints", type=options.names, metavar="A,B,...", default="", help="Joints to move. [default: the longest chain]"
)
@click.option("--chain", type=options.CHAIN, metavar="N", help="Number of a chain that the command has listed, from 1.")
@click.option("--name", metavar="NAME", help="Name of the scenario. [default: of the URDF]")
@click.option("--force", is_flag=True, help="Replace earlier files of this name.")
@output_option("Folder for both files.", ".")
def new(**given: Any) -> Any:
    """Write a robot file and a scenario from a URDF.

    Grippers and joints off the chain are locked. Joint stiffness and motor inertia, which a URDF lacks, are guesses
    until you replace them in the robot file.
    """
    return implementation("new").new(**given)


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
@click.option(
    "--certificate",
    type=options.PATH,
    metavar="FILE",
    help="Prove the rate over the joint range and write its certificate (JSON).",
)
@click.option("--seconds", type=options.SECONDS, metavar="S", default=120.0, help="Longest time of the proof.")
@click.option(
    "--error",
    "errors",
    type=options.model_error,
    metavar="NAME=VALUE",
    multiple=True,
    help="Bound the tracking error for a robot whose NAME is wrong by up to VALUE, e.g. payload=0.2; may be repeated.",
)
@click.option(
    "--prove-error",
    is_flag=True,
    help="Prove the bound of --error for three or more joints, too; takes minutes to an hour.",
)
@click.option(
    "--prove-sampled", is_flag=True, help="Prove that the sampled loop contracts near the reference; takes seconds."
)
@click.option(
    "--delay",
    type=options.SAMPLES,
    metavar="D",
    help="Delay in samples: constant for the bound, largest for this proof. [default: the scenario's]",
)
@set_option
def check(**given: Any) -> Any:
    """Check rates, stability and margins before a run.

    SCENARIO is the name of an installed scenario (see `fjr scenarios`) or a YAML file. With --error, --delay or
    --prove-error a bound of the tracking error along the reference is computed. Relative errors: payload (inertia and
    weight of the links), link_inertia, gravity, stiffness, motor_inertia, link_damping, motor_damping; in N m:
    link_torque, motor_torque.
    """
    return implementation("check").check_scenario(**given)


@command()
@scenario_argument
@click.option("--beta", type=options.RATE, metavar="B", required=True, help="Required rate of convergence [1/s].")
@click.option("--delay", type=options.SAMPLES, metavar="D", default=0.0, help="Delay of the loop in samples.")
@click.option("--everywhere", is_flag=True, help="Cover the joints' whole range instead of the reference only.")
@click.option("--proven", is_flag=True, help="Bound the inertia by a proof instead of samples (docs/proof.md).")
@click.option("--write", is_flag=True, help="Replace the gains in the scenario's file; its comments are kept.")
@click.option(
    "--from",
    "identification",
    type=options.PATH,
    metavar="FILE",
    help="identification.json of an identified robot: stable for plants drawn from it, checked on fresh draws.",
)
@click.option("--seed", type=options.SEED, metavar="N", default=0, help="Seed of the drawn plants.")
@set_option
def gains(**given: Any) -> Any:
    """Synthesise gains and print them as YAML.

    SCENARIO is the name of an installed scenario (see `fjr scenarios`) or a YAML file.
    """
    return implementation("gains").synthesised(**given)


@command()
@scenario_argument
@duration_option("Duration of the record in seconds.", 20.0)
@click.option(
    "--noise",
    type=options.ENCODER_NOISE,
    metavar="RAD",
    default=1e-5,
    help="Standard deviation of the encoders [rad] that the scenario has without errors.",
)
@click.option("--seed", type=options.SEED, metavar="N", default=0, help="Seed of the random start of the search.")
@click.option("--force", is_flag=True, help="Replace an earlier file.")
@output_option("Scenario file to write. [default: SCENARIO_excite.yaml]", kind="FILE")
@set_option
def excite(**given: Any) -> Any:
    """Design the motion from which a robot is identified best.

    SCENARIO is the name of an installed scenario (see `fjr scenarios`), a YAML file, or a robot file. The reference
    keeps 90 % of the limits of position, speed, acceleration, deflection and effort.
    """
    return implementation("excite").excite(**given)


@command()
def scenarios() -> Any:
    """List the installed scenarios."""
    return implementation("scenarios").list_scenarios()


@command()
@scenario_argument
@set_option
def description(**given: Any) -> Any:
    """Print a robot as URDF for robot_state_publisher.

    SCENARIO is the name of an installed scenario (see `fjr scenarios`) or a YAML file.
    """
    return implementation("export").describe(**given)


@command("export-c")
@click.argument("scenario", shell_complete=options.complete_scenario)
@click.argument("folder", metavar="DIR", type=options.PATH)
@click.option("--prefix", metavar="NAME", help="Prefix of all names in C. [default: the scenario's name]")
@click.option("--force", is_flag=True, help="Replace an earlier export; other files are kept.")
@set_option
def export_c(**given: Any) -> Any:
    """Export control step and plant as C99.

    SCENARIO is the name of an installed scenario or a YAML file. DIR is a new or empty folder.
    """
    return implementation("export").export_scenario(**given)


@command("export-ros2-control")
@click.argument("scenario", shell_complete=options.complete_scenario)
@click.argument("folder", metavar="DIR", type=options.PATH)
@click.option("--package", metavar="NAME", help="Name of the package. [default: SCENARIO_ros2_control]")
@click.option("--force", is_flag=True, help="Replace an earlier export; other files are kept.")
@set_option
def export_ros2_control(**given: Any) -> Any:
    """Export a controller and a simulated arm for ros2_control.

    SCENARIO is the name of an installed scenario or a YAML file. DIR is a new or empty folder, the package.
    """
    return implementation("export").export_ros2_control(**given)
