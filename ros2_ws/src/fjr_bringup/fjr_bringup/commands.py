# SPDX-License-Identifier: Apache-2.0
"""What the `fjr` command does once its line is understood."""

from __future__ import annotations

import argparse
import sys
import threading
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation

from fjr_bringup import scenarios
from fjr_bringup.run import Plan, run
from fjr_bringup.stopping import Interrupted
from fjr_bringup.summary import RunSummary, summarise, table, where_to_look
from fjr_core.errors import FjrError, ParameterError
from fjr_core.scenario import load_scenario

DEMO = ("paper_k31", "paper_k3p1")
DONE, FAILED, NOT_UNDERSTOOD = 0, 1, 2


def execute(options: argparse.Namespace, stop: threading.Event) -> int:
    """Run one command; every error is one sentence on stderr. Returns the exit code."""
    commands = {"demo": _demo, "run": _run, "scenarios": _scenarios}
    try:
        commands[options.command](options, stop)
    except Interrupted as interruption:
        kept = f"; what was recorded is in {interruption.kept}" if interruption.kept else "; nothing was recorded"
        print(f"fjr: stopped{kept}", file=sys.stderr)
    except FjrError as error:
        print(f"fjr: {error}", file=sys.stderr)
        return NOT_UNDERSTOOD if isinstance(error, (scenarios.ScenarioError, ParameterError)) else FAILED
    except (OSError, rclpy_implementation.RCLError) as error:
        print(f"fjr: {' '.join(str(error).split())}", file=sys.stderr)
        return FAILED
    return DONE


def _demo(options: argparse.Namespace, stop: threading.Event) -> None:
    plans = [_plan(name, {}, options) for name in DEMO]
    _tell([_record_and_report(plan, stop) for plan in plans])


def _run(options: argparse.Namespace, stop: threading.Event) -> None:
    overrides = dict(scenarios.parse_assignment(text) for text in options.overrides)
    if options.lockstep:
        overrides = {"realtime_priority": 0, **overrides, "lockstep": True}
    _tell([_record_and_report(_plan(options.scenario, overrides, options), stop)])


def _scenarios(_options: argparse.Namespace, _stop: threading.Event) -> None:
    for name, path in scenarios.known().items():
        print(f"{name:12}  {scenarios.summary(path)}")


def _plan(name: str | None, overrides: dict[str, Any], options: argparse.Namespace) -> Plan:
    path = scenarios.find(name)
    scenario = load_scenario(path)  # a file that is none is refused before anything is changed in it
    text = scenarios.with_overrides(path, overrides)
    lockstep = bool(overrides.get("lockstep", scenario.plant_values["lockstep"]))
    return Plan(path.stem, text, options.duration, options.output / path.stem, lockstep)


def _record_and_report(plan: Plan, stop: threading.Event) -> RunSummary:
    run(plan, stop)
    return summarise(plan.name, plan.folder, plan.duration)


def _tell(summaries: list[RunSummary]) -> None:
    print(table(summaries))
    print(where_to_look(summaries))
