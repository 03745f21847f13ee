# SPDX-License-Identifier: Apache-2.0
"""Declare commands of fjr: arguments, options and number types that several share. Imports nothing slow."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable
from functools import wraps
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import click
from click.shell_completion import CompletionItem

from fjr_core.errors import FjrError

from .output import tell
from .ros2 import installed_files

PATH = click.Path(path_type=Path)


def number(noun: str, expected: str, accepts: Callable[[float], bool], percent: bool = False) -> Callable[[str], float]:
    """Return a converter of text, also in `percent`, to a number; it raises click.BadParameter unless it `accepts`."""

    def convert(text: str) -> float:
        try:
            value = float(text[:-1]) / 100 if percent and text.endswith("%") else float(text)
        except ValueError:
            value = math.nan
        if not accepts(value):
            raise click.BadParameter(f"'{text}' is not {noun}; expected {expected}")
        return value

    return convert


def integer(noun: str, expected: str, lowest: int, highest: float = math.inf) -> Callable[[str], int]:
    """Return a converter of text, such as 20 or 1e4, to an integer within lowest and highest."""
    convert = number(noun, expected, lambda value: lowest <= value <= highest and value % 1 == 0)
    return lambda text: int(convert(text))


def cores(text: str) -> int:
    """Convert a number of cores, or `all` of this machine."""
    if text == "all":
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return integer("a number of cores", "1 or more, or all", 1, 1024)(text)


ABSOLUTE = ("payload_mass", "payload_position", "gravity_direction", "link_torque", "motor_torque", "delay", "stated")


def model_error(text: str) -> tuple[str, float | list[float]]:
    """Convert NAME=VALUE, the error of a parameter or of each joint; gravity=2% is 0.02, payload=2kg payload_mass=2."""
    name, _, value = text.partition("=")
    if name == "payload" and value.endswith("kg"):
        name, value = "payload_mass", value.removesuffix("kg")
    if name == "link_inertia":
        tell("--error link_inertia is deprecated; use link_central_inertia")
        name = "link_central_inertia"
    noun, expected = f"an error of {name}", "NAME=VALUE with 0 or a positive number"
    convert = number(noun, expected, lambda size: 0 <= size < math.inf, percent=name not in ABSOLUTE)
    first, *others = map(convert, value.split(","))
    return name, [first, *others] if others else first


def remap(text: str) -> str:
    """Check a remap FROM:=TO."""
    if not all(text.partition(":=")[::2]):
        raise click.BadParameter(f"'{text}' is not a remap; expected FROM:=TO")
    return text


def ros_name(text: str) -> str:
    """Check the name of a node or a namespace."""
    if not re.fullmatch(r"/|/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", text, re.ASCII):
        raise click.BadParameter(f"'{text}' is not a ROS name; expected letters, digits, _ and single /, e.g. /left")
    return text


def names(text: str) -> tuple[str, ...]:
    """Convert names separated by commas."""
    return tuple(part.strip() for part in text.split(",") if part.strip())


SECONDS = number("a duration", "seconds, more than 0, at most 3600", lambda value: 0 < value <= 3600)
SINCE = number("a time", "seconds, 0 or more", lambda value: 0 <= value < math.inf)
RATE = number("a rate", "a positive number", lambda value: 0 < value < math.inf)
SPEED = number("a speed", "0.001 to 1000", lambda value: 1e-3 <= value <= 1e3)
SAMPLES = number("a delay", "samples, 0 to 20", lambda value: 0 <= value <= 20)
ENCODER_NOISE = number("a noise", "rad, more than 0, at most 0.1", lambda value: 0 < value <= 0.1)
DISTANCE = number("a distance", "0 or a positive number", lambda value: 0 <= value < math.inf)
FIRST = 30.0  # s; longest wait for a first message, discovery included
MESSAGES = integer("a number of messages", "1 or more", 1, 1e15)
SEED = integer("a seed", "0 or more", 0, 2**63)
PORT = integer("a port", "0 to 65535", 0, 65535)
CHAIN = integer("a chain", "its number, 1 or more", 1, 1000)
RUNS = integer("a number of runs", "1 or more", 1, 1e9)


def distances(text: str) -> tuple[float, ...]:
    """Convert one distance, or several with commas between them."""
    return tuple(DISTANCE(part) for part in text.split(","))


def complete_scenario(_context: click.Context, _parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Complete the names of installed scenarios, or else file names."""
    names = [name for name in installed_files("scenarios") if name.startswith(incomplete)]
    return [CompletionItem(name) for name in names] or [CompletionItem(incomplete, type="file")]


def complete_assignment(context: click.Context, _parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Complete the names of the parameters of the given scenario; the help is the present value."""
    from fjr_core.config.scenario import read_scenario

    named = context.params.get("scenario") or "paper_k31"
    try:
        scenario = read_scenario(installed_files("scenarios").get(named, Path(named)))
    except FjrError:
        return []
    values = {**scenario.plant_values, **scenario.controller_values}
    return [
        CompletionItem(f"{name}:=", help=str(values[name])) for name in sorted(values) if name.startswith(incomplete)
    ]


scenario_argument = click.argument("scenario", required=False, shell_complete=complete_scenario)
set_option = click.option(
    "--set",
    "assignments",
    metavar="NAME:=VALUE",
    multiple=True,
    shell_complete=complete_assignment,
    help="Change a parameter, e.g. robot.joint_stiffness:=[10.0]; may be repeated.",
)

film_option = click.option(
    "--film", type=PATH, metavar="FILE", help="Draw the motion as a moving picture, .gif, .png or .mp4."
)
json_lines = click.option("--json", "as_json", is_flag=True, help="Print each as JSON in one line.")
force_over_ros2 = click.option("--force", is_flag=True, help="Run although ros2 is on the PATH.")


def output_option(meaning: str, default: str | None = None, kind: str = "DIR") -> Callable[..., Any]:
    """Return the option --output, of a folder by default."""
    return click.option("--output", type=PATH, metavar=kind, default=default, help=meaning)


def duration_option(meaning: str, default: float | None = None) -> Callable[..., Any]:
    """Return the option --duration S."""
    return click.option("--duration", type=SECONDS, metavar="S", default=default, help=meaning)


def implementation(name: str) -> ModuleType:
    """Import the module of a command by its full name, then call `loaded` (see app.main)."""
    module = import_module(name)
    click.get_current_context().obj()
    return module


COMMANDS = click.Group()
"""All commands that are declared so far; fjr_bringup.cli.app loads the declarations of every package."""


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
