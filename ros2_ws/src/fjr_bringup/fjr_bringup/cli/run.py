# SPDX-License-Identifier: Apache-2.0
"""`fjr run` and `fjr demo`: check a scenario, run it on two nodes, report it."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from fjr_bringup import runner
from fjr_bringup.runner import RunError, RunPlan
from fjr_core.errors import FjrError, ParameterError
from fjr_core.files import importing
from fjr_core.numerics.jit import c_compiler
from fjr_design.cli.preflight import refuse_coarse_steps, refuse_unstable
from fjr_monitor.recording.files import BagError
from fjr_monitor.recording.run_folder import RunFolder
from fjr_monitor.report.comparison_page import Claim, paper_claim
from fjr_monitor.report.shown import RunSummary
from fjr_monitor.report.write import compare, output_paths, play_hint, report_run, stops, table
from fjr_msgs_py.console.ending import Exit, stoppable
from fjr_msgs_py.console.output import Result, percent, phase, tell
from fjr_msgs_py.console.ros2 import discover_quickly
from fjr_msgs_py.scenarios import library
from fjr_plant.engine import engine_kind

DEMO = ("paper_k31", "paper_k3p1", "arm7")  # the paper's stiff joint, its soft joint, any arm
LOCKSTEP = {"realtime_priority": 0, "lockstep": True}


def demo(duration: float, output: Path) -> Result:
    """Run the demonstration scenarios in real time and write a page that compares them and states the paper's claim."""
    summaries = [_demonstrate(name, duration, output) for name in DEMO]
    stiff, soft = summaries[:2]
    stiff_K, soft_K = (float(each.data.run.scenario.robot.K[0, 0]) for each in (stiff, soft))
    claim = paper_claim(stiff.report, soft.report, (stiff_K, soft_K))
    with phase("comparing the runs"):
        page = compare(summaries, output, claim)
    return _result(summaries, page, claim)


def run_scenario(
    scenario: str | None,
    assignments: Sequence[str],
    duration: float,
    output: Path,
    lockstep: bool,
    engine: str | None,
    force: bool,
    no_report: bool,
    film: Path | None = None,
    viewer: bool = False,
) -> Result:
    """Run one scenario for `duration` [s] and report it; force: even if it is unstable as sampled.

    engine: the parameter of the plant node, None for that of the scenario. no_report: write report.json without page
    and picture. film: file of a moving picture. viewer: show the arm in that of MuJoCo.
    """
    if viewer:
        importing.module("fjr_engines.viewer").check()
    if film is not None:
        importing.module("fjr_engines.film").check(film)
        if no_report:
            raise ParameterError("--film draws the motion of the page; expected it without --no-report")
    overrides = library.parse_assignments(assignments)
    if engine:
        overrides["engine"] = engine
    if lockstep:
        overrides = {**LOCKSTEP, **overrides, "lockstep": True}
    plan = _plan(scenario, overrides, duration, output, force)
    with importing.module("fjr_engines.viewer").shown(plan.name, plan.scenario) if viewer else nullcontext():
        summary = _record_and_report(plan, not no_report)
    if film is not None:
        importing.module("fjr_engines.film").film(summary.data, film)
    return _result([summary])


def _demonstrate(name: str, duration: float, output: Path) -> RunSummary:
    """Run a scenario in real time; in lock-step, too, if that was stopped, late or violated."""
    summary = _record_and_report(_plan(name, {}, duration, output))
    if _exit_code([summary]) == Exit.DONE:
        return summary
    report, counts = summary.report, summary.report.counts
    what = f"was stopped at {report.stop.at_s:.3g} s" if report.stop else f"is {report.status}"
    arrived, in_time = percent(counts.published_fraction, 1), percent(counts.answered_in_time_fraction, 1)
    note = (
        f"the run in real time {what}: {arrived} of the states arrived, {in_time} of these were answered in time; "
        "repeated in lock-step, where the robot waits for each command"
    )
    print(f"{name}: {note}", file=sys.stderr)
    return replace(_record_and_report(_plan(name, LOCKSTEP, duration, output)), notes=(note,))


def _plan(
    name: str | None, overrides: Mapping[str, Any], duration: float, output: Path, force: bool = False
) -> RunPlan:
    """Return what to run, and print the warnings of a motion from a file and of guessed values.

    Raises UnstableError for a scenario that is unstable as sampled, unless forced, and CompilerError.
    """
    c_compiler()  # a missing compiler is refused first
    path = library.find(name)
    discover_quickly()  # an invalid ROS domain is refused before anything is compiled
    with phase(f"{path.stem}: checking and compiling the law"):
        text, scenario = library.as_run(path, overrides)
        engine_kind(scenario.plant_values)  # one that is not installed is refused before the nodes start
        for warning in (*scenario.motion_warnings, *scenario.robot_warnings):
            tell(warning)
        if not force:
            refuse_coarse_steps(scenario)
            refuse_unstable(scenario)
        with RunFolder(output / path.stem):  # so is a folder that cannot be written
            scenario.warm_up()
    return RunPlan(path.stem, text, duration, output / path.stem, bool(scenario.plant_values["lockstep"]))


def _record_and_report(plan: RunPlan, pages: bool = True) -> RunSummary:
    """Run the plan and report it; of a run that failed, report what its bag holds and raise RunError."""
    try:
        with stoppable() as stop:
            folder, skipped = runner.run(plan, stop)
    except RunError as error:
        with suppress(FjrError):
            if error.kept:
                reason = str(error).partition("\n")[0]
                summary = report_run(plan.name, error.kept, None, failure=reason, pages=pages)
                print("\n".join([*stops([summary]), output_paths([summary])]), file=sys.stderr)
        raise
    with phase(f"{plan.name}: writing the report"):
        try:
            return report_run(plan.name, folder, plan.duration, skipped, pages=pages)
        except BagError as error:  # of this run, not of a file that was given
            raise RunError(f"{error}\nwhat was recorded is in {folder}", folder) from None


def _result(summaries: Sequence[RunSummary], page: Path | None = None, claim: Claim | None = None) -> Result:
    """Return table and files of finished runs; page: the page that compares them; claim: what they show together."""
    for note in (f"{each.label}: {note}" for each in summaries for note in each.report.missing):
        tell(note)
    lines = [table(summaries), output_paths(summaries), play_hint(Path(summaries[0].report.bag))]
    lines += [f"side by side: {page}"] if page else []
    lines += [f"{claim.heading}: {claim.sentence}"] if claim else []
    shown = {"shown": claim.kind == "holding", "sentence": claim.sentence} if claim else None
    values = {"runs": [each.values for each in summaries], "comparison": page, "claim": shown}
    return Result("\n".join(lines), values, _exit_code(summaries))


def _exit_code(summaries: Sequence[RunSummary]) -> Exit:
    """Return the exit code of finished runs, the first that applies: FAILED, VIOLATED, LATE, DONE."""
    found = {each.report.status for each in summaries}
    codes = {"stopped": Exit.FAILED, "violated": Exit.VIOLATED, "late": Exit.LATE}
    return next((code for status, code in codes.items() if status in found), Exit.DONE)
