# SPDX-License-Identifier: Apache-2.0
"""The commands that make a robot's model from recorded motion."""

from __future__ import annotations

from typing import Any

import click

from fjr_bringup.cli import options
from fjr_bringup.cli.commands.declaration import command, implementation
from fjr_bringup.cli.options import duration_option, output_option


@command()
@click.argument("records", nargs=-1, required=True, metavar="RECORD...", type=options.PATH)
@click.option("--robot", type=options.PATH, metavar="FILE", help="Robot file or scenario, the prior.  [required]")
@click.option(
    "--hold-out", "hold_outs", type=options.PATH, metavar="RECORD", multiple=True, help="Record to predict only."
)
@click.option("--map", "mapping", type=options.PATH, metavar="FILE", help="Mapping file: columns, units, gear ratios.")
@click.option(
    "--write-map", is_flag=True, help="Write a mapping file from the column names of RECORD, and identify nothing."
)
@click.option("--joints", type=options.names, metavar="A,B,...", default="", help="Joints to identify. [default: all]")
@click.option("--start", type=options.SINCE, metavar="S", default=0.0, help="Skip the first S seconds of each record.")
@duration_option("Duration in seconds of each record. [default: all]")
@click.option(
    "--accept", "accepted", metavar="KIND", multiple=True, help="Report a contradiction of this kind, do not refuse it."
)
@click.option("--payload", is_flag=True, help="Identify a point mass at the last link.")
@click.option("--link-inertia", is_flag=True, help="Correct mass and inertia of the links, near those of the URDF.")
@click.option("--static-friction", is_flag=True, help="Identify static friction.")
@click.option(
    "--position-torque", metavar="JOINT", default="", help="Joint with a torque that depends on its position."
)
@output_option("Folder for robot.yaml, identification.json and the page.", "identified")
def identify(**given: Any) -> Any:
    """Identify a robot from recorded motion.

    RECORD is the folder of a run, a bag, or CSV or Parquet with --map. Each parameter gets a 95 % interval and a
    verdict.
    """
    return implementation("identify").identify(**{**given, "duration": given["duration"] or float("inf")})
