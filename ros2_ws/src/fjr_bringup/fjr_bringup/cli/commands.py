# SPDX-License-Identifier: Apache-2.0
"""What the `fjr` command does once its line is understood."""

from __future__ import annotations

import argparse
import logging
import shutil
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation

from fjr_bringup.cli import check as check_command
from fjr_bringup.cli import gains as gains_command
from fjr_bringup.cli.exit_codes import Exit
from fjr_bringup.cli.export import export_to
from fjr_bringup.cli.report import ReportError, report_bags, tell
from fjr_bringup.interrupt import Interrupted, stoppable
from fjr_bringup.monitor import app as monitor_app
from fjr_bringup.recording.echo import echo
from fjr_bringup.recording.record import record
from fjr_bringup.report.write import RunSummary, compare, how_to_play, stops, summarise, table, where_to_look
from fjr_bringup.runner.run import Plan, RunError, discover_quickly, run
from fjr_bringup.scenarios import library
from fjr_bringup.studies.comparison import command as comparison_command
from fjr_bringup.studies.contraction import run as contraction_study
from fjr_core.config.description import description
from fjr_core.errors import CompareError, FjrError, ParameterError

DEMO = ("paper_k31", "paper_k3p1", "arm7")


def execute(options: argparse.Namespace) -> Exit:
    """Run one command; every error is one sentence on stderr. Returns the exit code."""
    _tell_what_takes_long()
    commands: dict[str, Callable[[argparse.Namespace], Exit | None]] = {
        "demo": _demo,
        "run": _run,
        "report": _report,
        "check": _check,
        "gains": _gains,
        "scenarios": _scenarios,
        "contraction": _contraction,
        "description": _description,
        "sweep": _sweep,
        "export-c": _export_c,
        "echo": _echo,
        "record": _record,
        "watch": _watch,
        "compare": _compare,
    }
    try:
        return commands[options.command](options) or Exit.DONE
    except Interrupted as interruption:
        kept = f"; what was recorded is in {interruption.kept}" if interruption.kept else "; nothing was recorded"
        print(f"fjr: stopped{kept}", file=sys.stderr)
        return Exit.INTERRUPTED
    except FjrError as error:
        print(f"fjr: {error}", file=sys.stderr)
        invalid = isinstance(error, (library.ScenarioError, ParameterError, CompareError))
        return Exit.NOT_UNDERSTOOD if invalid else Exit.FAILED
    except (OSError, rclpy_implementation.RCLError) as error:
        print(f"fjr: {' '.join(str(error).split())}", file=sys.stderr)
        return Exit.FAILED


def _tell_what_takes_long() -> None:
    """fjr_core's log, which says when it compiles and when it cannot."""
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("fjr: %(message)s"))
    log = logging.getLogger("fjr_core")
    log.handlers = [handler]
    log.setLevel(logging.INFO)


def _demo(options: argparse.Namespace) -> Exit:
    plans = [_plan(name, {}, options) for name in DEMO]
    summaries = [_record_and_report(plan) for plan in plans]
    _tell(summaries)
    print(f"side by side: {compare(summaries, options.output)}")
    return _exit_of(summaries)


def _run(options: argparse.Namespace) -> Exit:
    overrides = _overrides(options)
    if options.lockstep:
        overrides = {"realtime_priority": 0, **overrides, "lockstep": True}
    summary = _record_and_report(_plan(options.scenario, overrides, options, options.force))
    _tell([summary])
    return _exit_of([summary])


def _exit_of(summaries: Sequence[RunSummary]) -> Exit:
    """The exit code of finished runs."""
    if any(each.report.stop for each in summaries):
        return Exit.FAILED
    return Exit.VIOLATED if any(each.report.verdict.kind == "violated" for each in summaries) else Exit.DONE


def _report(options: argparse.Namespace) -> None:
    namespace = f"/{options.namespace.strip('/')}" if options.namespace.strip("/") else ""
    summaries, failures = report_bags(options.bags, options.scenario, options.output, namespace)
    tell(summaries, failures[:-1], options.output)
    if failures:
        raise ReportError(failures[-1])


def _check(options: argparse.Namespace) -> None:
    _, scenario = library.as_run(library.find(options.scenario), _overrides(options))
    found = check_command.checked(scenario)
    print(check_command.table(scenario, found), flush=True)
    for warning in scenario.warnings:
        print(f"fjr: {warning}", file=sys.stderr)
    check_command.refuse_coarse_steps(scenario)
    check_command.refuse_unstable(scenario, found)
    check_command.refuse_start_outside(scenario)


def _gains(options: argparse.Namespace) -> None:
    _, scenario = library.as_run(library.find(options.scenario), _overrides(options))
    print(gains_command.text(scenario, options.beta, options.delay, options.everywhere), end="")


def _scenarios(_options: argparse.Namespace) -> None:
    for name, path in library.known().items():
        print(f"{name:12}  {library.summary(path)}")


def _contraction(options: argparse.Namespace) -> None:
    _, scenario = library.as_run(library.find(options.scenario), _overrides(options))
    wish = contraction_study.Wish(options.duration, options.starts, options.spread, options.seed)
    with stoppable() as stop:
        print(contraction_study.run_and_draw(scenario, wish, options.run, options.output / "contraction", stop))


def _description(options: argparse.Namespace) -> None:
    _, scenario = library.as_run(library.find(options.scenario), _overrides(options))
    print(description(scenario.plant_values), end="")


def _sweep(options: argparse.Namespace) -> None:
    from fjr_bringup.studies.monte_carlo import command as monte_carlo_command  # pyarrow loads here

    given = {"runs": options.runs, "seed": options.seed, "duration": options.duration}
    numbers = {name: value for name, value in given.items() if value is not None}
    wish = monte_carlo_command.Wish(options.cores, options.scheduler, options.output, _overrides(options), numbers)
    with stoppable() as stop:
        print(monte_carlo_command.sweep(options.scenario, wish, stop))


def _export_c(options: argparse.Namespace) -> None:
    _, scenario = library.as_run(library.find(options.scenario), _overrides(options))
    print(export_to(scenario, options.folder, options.prefix, options.force))


def _echo(options: argparse.Namespace) -> None:
    refuse_where_better(f"ros2 topic echo {options.topic}", "with filters, fields and statistics", options.force)
    discover_quickly()
    with stoppable() as stop:
        echo(options.topic, options.count, options.timeout, stop)


def _record(options: argparse.Namespace) -> None:
    wanted = " ".join(options.topics) or "--all"
    refuse_where_better(f"ros2 bag record --storage mcap {wanted}", "with splitting and compression", options.force)
    discover_quickly()
    with stoppable() as stop:
        print(record(options.topics, options.output, options.duration, stop))


def _watch(options: argparse.Namespace) -> None:
    limits = {}
    if options.scenario:
        limits = dict(monitor_app.effort_limits(library.as_run(library.find(options.scenario), {})[1]))
    discover_quickly()
    wish = monitor_app.Wish(options.namespace, tuple(options.remaps), options.controller, options.once)
    with stoppable() as stop:
        monitor_app.watch(wish, limits, stop)


def _compare(options: argparse.Namespace) -> None:
    with stoppable() as stop:
        print(comparison_command.compare(options.suite, options.output, options.cores, options.readme, stop))


def _overrides(options: argparse.Namespace) -> dict[str, Any]:
    return dict(library.parse_assignment(text) for text in options.overrides)


def _plan(name: str | None, overrides: dict[str, Any], options: argparse.Namespace, force: bool = False) -> Plan:
    """What to run, once it is known to be stable as sampled or the user insists."""
    path = library.find(name)
    text, scenario = library.as_run(path, overrides)
    if not force:
        check_command.refuse_coarse_steps(scenario)
        check_command.refuse_unstable(scenario, check_command.checked(scenario))
    scenario.warm_up()
    lockstep = bool(scenario.plant_values["lockstep"])
    return Plan(path.stem, text, options.duration, options.output / path.stem, lockstep)


def _record_and_report(plan: Plan) -> RunSummary:
    try:
        with stoppable() as stop:
            recorded = run(plan, stop)
    except RunError as error:
        if error.kept:
            _report_of_failure(plan.name, error.kept, error)
        raise
    return summarise(plan.name, recorded.folder, plan.duration, recorded.skipped)


def _report_of_failure(name: str, folder: Path, error: RunError) -> None:
    """Report and pictures of what was recorded before a run failed, as far as there is anything to show."""
    with suppress(FjrError):
        summary = summarise(name, folder, None, failure=str(error).partition("\n")[0])
        print("\n".join([*stops([summary]), where_to_look([summary])]), file=sys.stderr)


def _tell(summaries: list[RunSummary]) -> None:
    print(table(summaries))
    print(where_to_look(summaries))
    print(how_to_play(Path(summaries[0].report.bag)))


class BetterToolError(FjrError):
    """ROS 2's own tool is installed."""


def refuse_where_better(command: str, what: str, force: bool) -> None:
    """Raise BetterToolError, naming the `command` of ros2 to use, where ros2 is on the PATH, unless forced."""
    if not force and (found := shutil.which("ros2")):
        raise BetterToolError(f"{found} is there and does this better: use `{command}` ({what}), or add --force")
