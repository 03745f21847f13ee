# SPDX-License-Identifier: Apache-2.0
"""The `fjr` command line. Imports nothing that takes time before signals are in hand."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from fjr_bringup.stopping import stoppable

DESCRIPTION = "Run scenarios on two real ROS 2 nodes, record everything, show what happened."


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit code: 0 done or stopped by the user, 1 failed, 2 not understood."""
    options = parser().parse_args(arguments)
    with stoppable() as stop:
        from fjr_bringup.commands import execute  # ROS, CasADi and matplotlib load here

        return execute(options, stop)


def parser() -> argparse.ArgumentParser:
    """The whole command line."""
    top = argparse.ArgumentParser(prog="fjr", description=DESCRIPTION)
    commands = top.add_subparsers(required=True, dest="command", metavar="{demo,run,scenarios}")
    demo = commands.add_parser("demo", help="both scenarios of the paper in real time, with a table at the end")
    run = commands.add_parser("run", help="one scenario")
    commands.add_parser("scenarios", help="list the installed scenarios")
    run.add_argument("scenario", nargs="?", metavar="SCENARIO", help="an installed scenario's name, or a YAML file")
    run.add_argument("--lockstep", action="store_true", help="one sample per answer, whatever the clock says")
    run.add_argument(
        "--set",
        dest="overrides",
        metavar="NAME:=VALUE",
        action="append",
        default=[],
        help="change a parameter, e.g. robot.joint_stiffness:=[10.0]; may be repeated",
    )
    for command in (demo, run):
        command.add_argument(
            "--duration", type=_seconds, metavar="S", default=5.0, help="seconds of stamped time (default 5)"
        )
        command.add_argument(
            "--output",
            type=Path,
            metavar="DIR",
            default=Path("runs"),
            help="where folders of runs go (default runs)",
        )
    return top


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value <= 3600.0:
        raise argparse.ArgumentTypeError(f"'{text}' is not a duration; expected seconds, more than 0, at most 3600")
    return value
