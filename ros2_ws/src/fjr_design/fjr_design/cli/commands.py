# SPDX-License-Identifier: Apache-2.0
"""Declare the commands before a run; the code behind each is imported when it runs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from fjr_msgs_py.console import options
from fjr_msgs_py.console.options import (
    command,
    duration_option,
    implementation,
    output_option,
    scenario_argument,
    set_option,
)
from fjr_msgs_py.console.output import tell


def _drawn_plants_options(cores: str) -> Callable[[Any], Any]:
    """Return a decorator with the options that `sweep` and `tune` share; cores: default."""
    shared = (
        click.option(
            "--seed", type=options.SEED, metavar="N", help="Seed of all random numbers. [default: the file's, else 0]"
        ),
        duration_option("Duration of a run in seconds. [default: the file's, else 5]"),
        click.option(
            "--cores", type=options.cores, metavar="N", default=cores, help="Cores of this machine, or `all`."
        ),
        click.option(
            "--scheduler", metavar="ADDRESS", help="Dask cluster to use instead of this machine, e.g. tcp://host:8786."
        ),
    )

    def add(function: Any) -> Any:
        for option in reversed(shared):
            function = option(function)
        return function

    return add


@command()
@click.argument("urdf", type=options.PATH)
@click.option(
    "--joints", type=options.names, metavar="A,B", default="", show_default="longest chain", help="Joints to move."
)
@click.option("--chain", type=options.CHAIN, metavar="N", help="Number of a chain that the command has listed, from 1.")
@click.option("--name", metavar="NAME", help="Name of the scenario. [default: of the URDF]")
@click.option("--force", is_flag=True, help="Replace earlier files of this name.")
@output_option("Folder for both files.", ".")
def new(**given: Any) -> Any:
    """Write a robot file and a scenario from a URDF or an MJCF.

    Grippers and joints off the chain are locked. Joint stiffness and motor inertia, which a URDF lacks, are guesses
    until you replace them in the robot file. MJCF is read by MuJoCo; its armature is the motor inertia.
    """
    return implementation("fjr_design.cli.files").new(**given)


@command()
@scenario_argument
@click.option(
    "--certificate",
    type=options.PATH,
    metavar="FILE",
    help="Prove the rate over the joint range and write its certificate (JSON).",
)
@click.option(
    "--seconds",
    type=options.SECONDS,
    metavar="S",
    default=120.0,
    help="Longest time of the proof of the rate and of the bound of --error; with --prove-error of one from the start.",
)
@click.option(
    "--error",
    "errors",
    type=options.model_error,
    metavar="NAME=VALUE",
    multiple=True,
    help="Bound the tracking error for a robot whose NAME is wrong by up to VALUE, e.g. payload=20%; may be repeated.",
)
@click.option(
    "--prove-error",
    is_flag=True,
    help="Prove the bound of --error for three or more joints, too; takes minutes or more.",
)
@click.option(
    "--prove-sampled",
    is_flag=True,
    help="Prove that the sampled loop contracts near the reference; takes seconds, with many joints an hour or more.",
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
    --prove-error a bound of the tracking error along the reference is computed. Relative errors, one number for each
    joint by itself or a list, as stiffness=0.1,20%: link_mass, link_central_inertia, stiffness, motor_inertia,
    link_damping, motor_damping; of all together: gravity, and payload=20%, one factor of mass and inertia of all links.
    With a unit, payload=1.4kg is a mass at the last link, up to payload_position [m] beside
    imperfections.payload_position; gravity_direction is in rad, link_torque and motor_torque are in N m (N), delay
    (from sample to sample) in samples. stated=2: the errors under robot.deviations, of two standard deviations.
    """
    return implementation("fjr_design.cli.check").check_scenario(**given)


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
    return implementation("fjr_design.cli.gains").synthesised(**given)


@command()
@scenario_argument
@set_option
def description(**given: Any) -> Any:
    """Print a robot as URDF for robot_state_publisher.

    SCENARIO is the name of an installed scenario (see `fjr scenarios`) or a YAML file.
    """
    return implementation("fjr_design.cli.files").describe(**given)


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
    return implementation("fjr_design.cli.files").export_scenario(**given)


@command("export-mjcf")
@click.argument("scenario", shell_complete=options.complete_scenario)
@click.argument("file", metavar="FILE.xml", type=options.PATH)
@click.option("--force", is_flag=True, help="Replace an earlier export; other files are kept.")
@set_option
def export_mjcf(**given: Any) -> Any:
    """Export a robot as an MJCF for MuJoCo.

    SCENARIO is the name of an installed scenario or a YAML file. Both sides of each joint are in the file: `<joint>` of
    the link, `<joint>_motor` of the rotor with its motor, between them the tendon `<joint>_spring`. Meshes are written
    to FILE_meshes. The keyframe `start` is the initial state of the scenario.
    """
    return implementation("fjr_design.cli.files").export_mjcf(**given)


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
    return implementation("fjr_design.cli.files").export_ros2_control(**given)


@command()
@scenario_argument
@click.option("--runs", type=options.RUNS, metavar="N", help="Number of runs. [default: the file's, else 1000]")
@_drawn_plants_options(cores="1")
@output_option("Folder in which NAME/ is written.", "runs/sweeps")
@set_option
def sweep(**given: Any) -> Any:
    """Run a Monte-Carlo study of model errors.

    SCENARIO is the name of an installed sweep or scenario, or a YAML file of either.
    """
    return implementation("fjr_design.studies.sweep_run").sweep(**given)


@command()
@scenario_argument
@click.option("--law", metavar="NAME", help="Law to tune. [default: the file's, else law.type of the scenario]")
@click.option(
    "--candidates", type=options.RUNS, metavar="N", help="Number of candidates. [default: the file's, else 300]"
)
@click.option(
    "--draws", type=options.RUNS, metavar="N", help="Drawn plants of a candidate. [default: the file's, else 48]"
)
@click.option(
    "--fresh", type=options.RUNS, metavar="N", help="Runs of the validation. [default: the file's, else 1000]"
)
@_drawn_plants_options(cores="all")
@output_option("Folder in which NAME_LAW/ is written.", "runs/tuned")
@set_option
def tune(**given: Any) -> Any:
    """Choose gains for stated model errors.

    SCENARIO is the name of an installed sweep or scenario, or a YAML file of either. The gains minimise a cost over
    drawn plants and are validated on fresh ones (docs/gains.md).
    """
    return implementation("fjr_design.studies.tune_run").tune(**given)


@command()
@click.argument("suite", default="paper")
@output_option("Folder in which compare_SUITE/ is written.", "runs")
@click.option("--cores", type=options.cores, metavar="N", default="all", help="Cores of this machine, or `all`.")
@click.option(
    "--document",
    type=options.PATH,
    metavar="[FILE]",
    is_flag=False,
    flag_value="docs/tables/compare.md",
    help="Write the table into FILE too. [FILE: docs/tables/compare.md]",
)
@click.option(
    "--readme",
    type=options.PATH,
    is_flag=False,
    flag_value="docs/tables/compare.md",
    hidden=True,
    help="Deprecated in 0.1.0: use --document.",
)
def compare(suite: str, document: Path | None, readme: Path | None, **given: Any) -> Any:
    """Compare control laws under imperfections.

    SUITE is the name of a comparison or a YAML file. [default: paper]
    """
    if readme is not None:
        tell("--readme is deprecated; use --document")
    return implementation("fjr_design.studies.compare_run").compare(suite, document or readme, **given)
