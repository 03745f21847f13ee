# SPDX-License-Identifier: Apache-2.0
"""The `fjr` command line. Imports nothing that takes time before signals are in hand."""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from fjr_bringup.cli.exit_codes import HELP, Exit
from fjr_bringup.interrupt import interruptible, uninterruptible
from fjr_msgs_py.node.loading import end_on_signals, without_blas_threads

DESCRIPTION = "Run scenarios on two real ROS 2 nodes, record everything, show what happened."


def program() -> int:
    """Run the executable `fjr`: main() with handlers for SIGINT and SIGTERM from the first moment."""
    end_on_signals(Exit.INTERRUPTED)
    try:
        return main(loaded=interruptible)
    except KeyboardInterrupt:
        uninterruptible()
        print("fjr: stopped", file=sys.stderr)
        return Exit.INTERRUPTED


def main(arguments: Sequence[str] | None = None, loaded: Callable[[], None] = lambda: None) -> int:
    """Run the command; return its exit code (fjr_bringup.cli.exit_codes). loaded: called when all modules are there."""
    options = parser().parse_args(arguments)
    without_blas_threads()
    from fjr_bringup.cli.commands import execute  # ROS, CasADi and matplotlib load here

    loaded()
    return execute(options)


def parser() -> argparse.ArgumentParser:
    """The whole command line."""
    top = argparse.ArgumentParser(
        prog="fjr", description=DESCRIPTION, epilog=HELP, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = top.add_subparsers(required=True, dest="command", metavar="COMMAND")
    demo = commands.add_parser("demo", help="the paper's two scenarios and a 7-joint arm in real time, with a table")
    run = commands.add_parser("run", help="one scenario")
    report = commands.add_parser("report", help="pages and figures from bags, of ours or of any robot")
    check = commands.add_parser("check", help="what is known before a scenario runs: rates, stability as sampled")
    gains = commands.add_parser("gains", help="gains for a scenario's robot and sample rate, as YAML to paste")
    commands.add_parser("scenarios", help="list the installed scenarios")
    run.add_argument("--lockstep", action="store_true", help="one sample per answer, whatever the clock says")
    run.add_argument("--force", action="store_true", help="run a scenario that is unstable as sampled, too")
    gains.add_argument("--beta", type=_positive, metavar="B", required=True, help="wanted rate of convergence [1/s]")
    gains.add_argument(
        "--delay", type=_samples, metavar="D", default=0.0, help="delay of the loop, in samples (default 0)"
    )
    gains.add_argument(
        "--everywhere", action="store_true", help="for the whole range of the joints, not only along the reference"
    )
    contraction = commands.add_parser("contraction", help="solutions of the virtual system meet along a run: a picture")
    description = commands.add_parser("description", help="a scenario's robot as a URDF, for robot_state_publisher")
    _add_sweep(commands)
    _add_export(commands.add_parser("export-c", help="a scenario's law, plant and reference as plain C99, in a folder"))
    _add_comparison(commands)
    _add_listening(commands)
    for command in (run, check, gains, contraction, description):
        _add_scenario(command)
    _add_contraction(contraction)
    for command in (demo, run):
        _add_recording(command)
    _add_bags(report)
    return top


def _add_scenario(command: argparse.ArgumentParser, what: str = "an installed scenario's name, or a YAML file") -> None:
    command.add_argument("scenario", nargs="?", metavar="SCENARIO", help=what)
    _add_overrides(command)


def _add_overrides(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--set",
        dest="overrides",
        metavar="NAME:=VALUE",
        action="append",
        default=[],
        help="change a parameter, e.g. robot.joint_stiffness:=[10.0]; may be repeated",
    )


def _add_export(command: argparse.ArgumentParser) -> None:
    command.add_argument("scenario", metavar="SCENARIO", help="an installed scenario's name, or a YAML file")
    command.add_argument("folder", type=Path, metavar="DIR", help="a new or empty folder")
    command.add_argument(
        "--prefix", metavar="NAME", help="what all names in C begin with (default: the scenario's name)"
    )
    command.add_argument("--force", action="store_true", help="replace an earlier export; other files are left alone")
    _add_overrides(command)


def _add_recording(command: argparse.ArgumentParser) -> None:
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


def _add_bags(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "bags", nargs="+", type=Path, metavar="BAG", help="a run's folder, a bag's folder, or an .mcap or .db3 file"
    )
    command.add_argument(
        "--scenario",
        metavar="NAME",
        help="the robot: a scenario's name or file (default: scenario.yaml beside the bag)",
    )
    command.add_argument("--output", type=Path, metavar="DIR", help="where reports go (default: beside the bag)")
    command.add_argument("--namespace", metavar="NS", default="", help="of the nodes, where the bag holds several")


def _add_contraction(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--run", type=Path, metavar="DIR", help="along a recorded run: its folder (default: simulated)"
    )
    command.add_argument("--duration", type=_seconds, metavar="S", default=1.0, help="seconds (default 1)")
    command.add_argument(
        "--starts", type=_starts, metavar="M", default=8, help="virtual solutions, 2 to 64 (default 8)"
    )
    command.add_argument(
        "--spread", type=_spread, metavar="RAD", default=0.5, help="how far the links begin at most (default 0.5 rad)"
    )
    command.add_argument("--seed", type=int, metavar="N", default=0, help="of the random start (default 0)")
    command.add_argument(
        "--output", type=Path, metavar="DIR", default=Path("runs"), help="contraction/ in there (default runs)"
    )


def _add_sweep(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    sweep = commands.add_parser("sweep", help="thousands of runs with drawn numbers: how wrong may the model be")
    _add_scenario(sweep, "an installed sweep's or scenario's name, or a YAML file of either")
    sweep.add_argument("--runs", type=_runs, metavar="N", help="how many runs (default: the sweep's, else 1000)")
    sweep.add_argument(
        "--seed", type=int, metavar="N", help="of everything that is drawn (default: the sweep's, else 0)"
    )
    sweep.add_argument("--duration", type=_seconds, metavar="S", help="of a run (default: the sweep's, else 5)")
    sweep.add_argument("--cores", type=_cores, metavar="N", default=1, help="of this machine, or `all` (default 1)")
    sweep.add_argument(
        "--scheduler", metavar="ADDRESS", help="of a Dask cluster in place of them, e.g. tcp://host:8786"
    )
    sweep.add_argument(
        "--output",
        type=Path,
        metavar="DIR",
        default=Path("runs", "sweeps"),
        help="<name>/ in there (default runs/sweeps)",
    )


def _add_comparison(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    compare = commands.add_parser("compare", help="laws beside each other under imperfections, with margins: a page")
    compare.add_argument("suite", nargs="?", metavar="SUITE", default="paper", help="a suite's name, or a YAML file")
    compare.add_argument(
        "--output", type=Path, metavar="DIR", default=Path("runs"), help="compare_SUITE/ in there (default runs)"
    )
    compare.add_argument("--cores", type=_cores, metavar="N", help="of this machine, or `all` (default all)")
    page = Path("docs", "compare.md")
    compare.add_argument(
        "--document", type=Path, metavar="FILE", nargs="?", const=page, help=f"also write the table to FILE ({page})"
    )
    compare.add_argument("--readme", type=Path, nargs="?", const=page, help=argparse.SUPPRESS)  # deprecated in 0.1.0


def _add_listening(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The commands that listen to running nodes."""
    echo = commands.add_parser("echo", help="print the messages of a topic, where there is no `ros2 topic echo`")
    echo.add_argument("topic", metavar="TOPIC")
    echo.add_argument("--once", dest="count", action="store_const", const=1, help="only the first message")
    echo.add_argument("--count", type=_count, metavar="N", help="only so many messages")
    echo.add_argument("--timeout", type=_seconds, metavar="S", default=math.inf, help="give up after so long a silence")
    record = commands.add_parser("record", help="record topics to an MCAP bag, where there is no `ros2 bag record`")
    record.add_argument("topics", nargs="*", metavar="TOPIC", help="which topics (default: all)")
    record.add_argument("--output", type=Path, metavar="DIR", help="a new folder (default bag_ and the time)")
    record.add_argument("--duration", type=_seconds, metavar="S", help="seconds (default: until Ctrl-C)")
    watch = commands.add_parser(
        "watch", help="a running loop, live in the terminal: errors, efforts, V, timing, faults"
    )
    watch.add_argument(
        "scenario", nargs="?", metavar="SCENARIO", help="whose limits of effort are shown (default: URDF)"
    )
    watch.add_argument("--namespace", metavar="NS", default="/", help="of the nodes")
    watch.add_argument("--controller", metavar="NAME", default="fjr_controller", help="name of the controller's node")
    watch.add_argument("--once", action="store_true", help="one picture as plain text")
    watch.add_argument(
        "--remap",
        dest="remaps",
        metavar="FROM:=TO",
        type=_remap,
        action="append",
        default=[],
        help="another name of a topic, e.g. joint_states:=/robot/joint_states; may be repeated",
    )
    for command in (echo, record):
        command.add_argument("--force", action="store_true", help="although ros2 is on the PATH")


def _remap(text: str) -> str:
    if not all(text.partition(":=")[::2]):
        raise argparse.ArgumentTypeError(f"'{text}' is not a remap; expected FROM:=TO")
    return text


def _count(text: str) -> int:
    return int(_number(text, "a number of messages; expected 1 or more", lambda value: value >= 1 and value % 1 == 0))


def _runs(text: str) -> int:
    return int(
        _number(text, "a number of runs; expected 1 or more", lambda value: 1 <= value <= 1e9 and value % 1 == 0)
    )


def _cores(text: str) -> int:
    here = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if text == "all":
        return here
    return int(_number(text, "a number of cores; expected 1 or more, or all", lambda value: value in range(1, 1025)))


def _starts(text: str) -> int:
    return int(_number(text, "a number of solutions; expected 2 to 64", lambda value: value in range(2, 65)))


def _spread(text: str) -> float:
    return _number(text, "an angle; expected rad, more than 0, at most 3", lambda value: 0 < value <= 3)


def _seconds(text: str) -> float:
    return _number(text, "a duration; expected seconds, more than 0, at most 3600", lambda value: 0 < value <= 3600)


def _positive(text: str) -> float:
    return _number(text, "a rate; expected a positive number", lambda value: 0 < value < math.inf)


def _samples(text: str) -> float:
    return _number(text, "a delay; expected samples, 0 to 20", lambda value: 0 <= value <= 20)


def _number(text: str, expected: str, fits: Callable[[float], bool]) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not fits(value):
        raise argparse.ArgumentTypeError(f"'{text}' is not {expected}")
    return value
