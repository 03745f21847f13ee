# SPDX-License-Identifier: Apache-2.0
"""Declare the commands that identify a robot; the code behind each is imported when it runs."""

from __future__ import annotations

from typing import Any

import click

from fjr_msgs_py.console import options


@options.command()
@options.scenario_argument
@options.duration_option("Duration of the record in seconds.", 20.0)
@click.option(
    "--noise",
    type=options.ENCODER_NOISE,
    metavar="RAD",
    default=1e-5,
    help="Standard deviation of the encoders [rad, m] that the scenario has without errors.",
)
@click.option("--seed", type=options.SEED, metavar="N", default=0, help="Seed of the random start of the search.")
@click.option("--force", is_flag=True, help="Replace an earlier file.")
@options.output_option("Scenario file to write. [default: SCENARIO_excite.yaml]", kind="FILE")
@options.set_option
def excite(**given: Any) -> Any:
    """Design the motion from which a robot is identified best.

    SCENARIO is the name of an installed scenario (see `fjr scenarios`), a YAML file, or a robot file. The reference
    keeps 90 % of the limits of position, speed, acceleration, deflection and effort.
    """
    return options.implementation("fjr_identification.cli.excite").excite(**given)


@options.command()
@click.argument("records", nargs=-1, required=True, metavar="RECORD...", type=options.PATH)
@click.option("--robot", type=options.PATH, metavar="FILE", help="Robot file or scenario, the prior.  [required]")
@click.option(
    "--hold-out", "hold_outs", type=options.PATH, metavar="RECORD", multiple=True, help="Record to predict only."
)
@click.option("--map", "mapping", type=options.PATH, metavar="FILE", help="Mapping file: columns, units, gear ratios.")
@click.option(
    "--write-map", is_flag=True, help="Write a mapping file from the column names of RECORD, and identify nothing."
)
@click.option("--joints", type=options.names, metavar="A,B", default="", show_default="all", help="Joints to identify.")
@click.option("--start", type=options.SINCE, metavar="S", default=0.0, help="Skip the first S seconds of each record.")
@options.duration_option("Duration in seconds of each record. [default: all]")
@click.option(
    "--accept", "accepted", metavar="KIND", multiple=True, help="Report a contradiction of this kind, do not refuse it."
)
@click.option("--payload", is_flag=True, help="Identify a point mass at the last link.")
@click.option("--cubic-stiffness", is_flag=True, help="Identify springs that harden, K zeta + k zeta^3.")
@click.option("--link-inertia", is_flag=True, help="Correct mass and inertia of the links, near those of the URDF.")
@click.option("--static-friction", is_flag=True, help="Identify static friction.")
@click.option(
    "--position-torque",
    metavar="JOINT",
    default="",
    show_default=False,
    help="Joint with a torque that depends on its position.",
)
@options.output_option("Folder for robot.yaml, identification.json and the page.", "identified")
def identify(**given: Any) -> Any:
    """Identify a robot from recorded motion.

    RECORD is the folder of a run, a bag, or CSV or Parquet with --map. Each parameter gets a 95 % interval and a
    verdict.
    """
    duration = given["duration"] or float("inf")
    return options.implementation("fjr_identification.cli.identify").identify(**{**given, "duration": duration})
