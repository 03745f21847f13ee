# SPDX-License-Identifier: Apache-2.0
"""Reduce a run to one word: its verdict, unless the controller stopped or late answers explain a violation."""

from __future__ import annotations

from typing import Literal

from fjr_monitor.analysis.controller_stop import ControllerStop
from fjr_monitor.analysis.timing import Counts
from fjr_monitor.diagnosis.diagnosis import Diagnosis
from fjr_msgs_py.console.output import percent

KEEPS_UP = 0.9  # fraction of states answered in time below which a violation shows the computer, not the law
IN_TIME = 0.99  # the same, if delay or loss is the first cause

Status = Literal["stopped", "late", "holding", "degraded", "violated", "unknown"]


def status_of(stop: ControllerStop | None, verdict: Diagnosis, counts: Counts, lockstep: bool) -> Status:
    """Return "stopped" if the controller stopped, "late" if late answers explain a violation, otherwise the verdict.

    Late answers explain a violation in real time if less than KEEPS_UP of the states were answered in time, or less
    than IN_TIME and delay or loss is the first cause.
    """
    if stop:
        return "stopped"
    in_time = counts.answered_in_time_fraction
    if verdict.kind != "violated" or lockstep or in_time is None:
        return verdict.kind
    enough = IN_TIME if verdict.causes[:1] in (("delay",), ("loss",)) else KEEPS_UP
    return "late" if in_time < enough else "violated"


def advice_on(status: Status, counts: Counts, lockstep: bool) -> str:
    """Return what to do about a late computer, as a sentence; empty if late answers explain neither violation nor stop.

    They explain a stop in real time if less than KEEPS_UP of the answers were in time.
    """
    answered, in_time = counts.answered or 0, counts.answered_in_time or 0
    stopped_late = status == "stopped" and not lockstep and in_time < KEEPS_UP * answered
    if status != "late" and not stopped_late:
        return ""
    seen = f"your machine answered late ({percent(counts.answered_in_time_fraction, 0)} of the states in time)"
    return f"{seen}, so this run does not judge the law; try --lockstep"
