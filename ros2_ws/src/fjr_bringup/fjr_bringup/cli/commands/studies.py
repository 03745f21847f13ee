# SPDX-License-Identifier: Apache-2.0
"""The commands that study a scenario by simulation, without nodes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click

from fjr_bringup.cli import options
from fjr_bringup.cli.commands.declaration import command, implementation
from fjr_bringup.cli.options import duration_option, output_option, scenario_argument, set_option


def _drawn_plants_options(cores: str) -> Callable[[Any], Any]:
    """Return a decorator with the options that `sweep` and `tune` share; cores: default."""
    shared = (
        click.option("--seed", type=int, metavar="N", help="Seed of all random numbers. [default: the file's, else 0]"),
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
@click.option("--runs", type=options.RUNS, metavar="N", help="Number of runs. [default: the file's, else 1000]")
@_drawn_plants_options(cores="1")
@output_option("Folder in which NAME/ is written.", "runs/sweeps")
@set_option
def sweep(**given: Any) -> Any:
    """Run a Monte-Carlo study of model errors.

    SCENARIO is the name of an installed sweep or scenario, or a YAML file of either.
    """
    return implementation("studies").sweep(**given)


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
    drawn plants and are validated on fresh ones (docs/tuning.md).
    """
    return implementation("studies").tune(**given)


@command()
@click.argument("suite", default="paper")
@output_option("Folder in which compare_SUITE/ is written.", "runs")
@click.option("--cores", type=options.cores, metavar="N", help="Cores of this machine, or `all`. [default: all]")
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
def compare(**given: Any) -> Any:
    """Compare control laws under non-idealities.

    SUITE is the name of a comparison or a YAML file. [default: paper]
    """
    return implementation("studies").compare(**given)
