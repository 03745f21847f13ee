# SPDX-License-Identifier: Apache-2.0
"""Entry point of `fjr`. ROS 2 and CasADi load only once the command line is valid."""

from __future__ import annotations

import logging
import os
import signal
import sys
from collections.abc import Callable, Sequence
from importlib.metadata import entry_points

import click

from fjr_core.version import __version__
from fjr_msgs_py.console.ending import HELP, Exit, in_own_session
from fjr_msgs_py.console.options import COMMANDS
from fjr_msgs_py.console.output import tell
from fjr_msgs_py.console.provenance import begin_command
from fjr_msgs_py.node.loading import on_signals, prepare, resume_garbage_collection

ALL = "fjr.all_commands"
"""Key of a context whose help shows all commands."""
GROUPS = {
    "Run": ("demo", "run", "watch", "report"),
    "Your robot": ("new", "check", "gains", "identify"),
    "Studies": ("sweep", "compare"),
}
"""Commands of the help, by title; `fjr help all` shows the others, too."""
OTHERS = {
    "Running nodes": ("send", "echo", "record", "play", "call", "set", "lifecycle", "description"),
    "More": ("scenarios", "excite", "tune", "export-c", "export-mjcf", "export-ros2-control"),
}
RECORDING = ["run"], ["demo"]
"""First arguments of the commands that record in real time."""
MAY_BE_LEFT_OUT = {"excite": "fjr_identification", "identify": "fjr_identification"}
"""Commands of packages without which the others run."""


def declared() -> dict[str, click.Command]:
    """Return the commands of all installed packages by name; each declares its own in modules of this group."""
    for point in entry_points(group="fjr.commands"):
        point.load()
    return dict(COMMANDS.commands)


def program() -> int:
    """Run the executable `fjr`: main() with handlers for SIGINT and SIGTERM from the first instruction on."""
    prepare("fjr", Exit.INTERRUPTED)
    if sys.argv[1:2] in RECORDING and (code := in_own_session()) is not None:
        return code
    try:
        return main(loaded=_loaded)
    finally:
        resume_garbage_collection()


def _loaded() -> None:
    on_signals(signal.default_int_handler)  # raises KeyboardInterrupt, except within `stoppable`
    resume_garbage_collection()


def main(arguments: Sequence[str] | None = None, loaded: Callable[[], None] = lambda: None) -> int:
    """Run a command line and return its exit code (fjr_msgs_py.console.ending).

    arguments: default sys.argv[1:]. loaded: called when the modules of the command are imported.
    """
    begin_command(["fjr", *(sys.argv[1:] if arguments is None else arguments)])
    try:
        return int(fjr.main(arguments, prog_name="fjr", standalone_mode=False, obj=loaded) or Exit.DONE)
    except click.ClickException as error:
        error.show()
        return error.exit_code


class Application(click.Group):
    """The group of all commands; converts an error of any command to one sentence on stderr and an exit code."""

    def invoke(self, ctx: click.Context) -> int:
        """Run the command; return its exit code. Usage errors go on to main()."""
        try:
            _log_to_stderr()
            return super().invoke(ctx) or Exit.DONE
        except (click.ClickException, click.exceptions.Exit):
            raise
        except KeyboardInterrupt:
            on_signals(signal.SIG_IGN)
            tell("stopped")
            return Exit.INTERRUPTED
        except BrokenPipeError:  # the reader of standard output, such as head, has ended
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return Exit.FAILED
        except Exception as error:
            return _exit_code(error)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands in groups: GROUPS, and after `fjr help all` OTHERS and those that no group names."""
        groups = GROUPS
        if ctx.meta.get(ALL):
            named = {name for names in (GROUPS | OTHERS).values() for name in names}
            unnamed = {name for name, each in self.commands.items() if name not in named and not each.hidden}
            groups = GROUPS | OTHERS | {"Others": tuple(sorted(unnamed))}
        for title, names in groups.items():
            rows = [(name, self.commands[name].get_short_help_str(60)) for name in names if name in self.commands]
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)
        if groups is GROUPS:
            formatter.write_paragraph()
            formatter.write_text("All commands: fjr help all")

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the command of the arguments; raise UsageError, which names the package of one that is not there."""
        if args and args[0] not in self.commands and args[0] in MAY_BE_LEFT_OUT:
            package = MAY_BE_LEFT_OUT[args[0]]
            raise click.UsageError(f"{args[0]} needs the package {package}, which is not installed")
        return super().resolve_command(ctx, args)


def _exit_code(error: Exception) -> Exit:
    """Print a user error as one sentence on stderr and return its exit code; re-raise any other error."""
    from rclpy.impl.implementation_singleton import rclpy_implementation

    from fjr_core.errors import FjrError, ParameterError, RecordError, RobotError
    from fjr_monitor.recording.files import BagError
    from fjr_msgs_py.console.ending import Interrupted
    from fjr_msgs_py.scenarios.library import ScenarioError

    if isinstance(error, Interrupted):
        kept = f"what was recorded is in {error.kept}" if error.kept else "nothing was recorded"
        sentence, code = f"stopped; {kept}", Exit.INTERRUPTED
    elif isinstance(error, FjrError):
        invalid = (ScenarioError, ParameterError, RecordError, RobotError, BagError)
        sentence, code = str(error), Exit.NOT_UNDERSTOOD if isinstance(error, invalid) else Exit.FAILED
    elif isinstance(error, (OSError, rclpy_implementation.RCLError)):
        sentence, code = " ".join(str(error).split()), Exit.FAILED
        if isinstance(error, OSError) and error.filename:
            reason = f"cannot read or write {error.filename} ({error.strerror})"
            sentence = f"{reason}; expected a path with permission and free space"
    else:
        raise error
    tell(sentence)
    return code


def _log_to_stderr() -> None:
    """Show the log of fjr_core, which reports when a function is compiled and when it cannot be."""
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("fjr: %(message)s"))
    log = logging.getLogger("fjr_core")
    log.handlers = [handler]
    log.setLevel(logging.INFO)


def _show_version(ctx: click.Context, _parameter: click.Parameter, asked: bool) -> None:
    """Print the version of fjr_core and end the program."""
    if asked:
        click.echo(f"fjr {__version__}")
        ctx.exit()


@click.group(
    cls=Application,
    commands=declared(),
    epilog=f"\b\n{HELP}",
    context_settings={"help_option_names": ["-h", "--help"], "show_default": True},
)
@click.option(
    "--version", is_flag=True, is_eager=True, expose_value=False, callback=_show_version, help="Show the version."
)
def fjr() -> None:
    """Simulate, control, record and report flexible-joint robots on ROS 2 nodes."""


@fjr.command("help", hidden=True)
@click.argument("topic", default="")
@click.pass_context
def show_help(ctx: click.Context, topic: str) -> None:
    """Show the help of fjr, of `all` commands, or of one."""
    parent = ctx.parent
    assert parent is not None
    if topic in ("", "all"):
        parent.meta[ALL] = topic == "all"
        click.echo(parent.get_help())
        return
    _, wanted, _ = fjr.resolve_command(parent, [topic])
    assert wanted is not None
    click.echo(wanted.get_help(click.Context(wanted, parent, topic)))
