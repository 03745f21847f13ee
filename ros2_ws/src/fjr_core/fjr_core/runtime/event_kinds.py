# SPDX-License-Identifier: Apache-2.0
"""Names of the events and counters of the control step."""

STOPS, STARTS_REFUSED = "stops", "starts refused"
"""Kinds of the events that end tracking."""
KINDS = (
    "states older than the last",
    "states stale",
    "states repeated",
    "jumps doubted",
    "reference restarts",
    "silences",
    "forward jumps",
    "observer restarts",
    "recoveries",
    STARTS_REFUSED,
    STOPS,
    "stops: wiring",
    "stops: link position",
    "stops: motor position",
    "stops: link velocity",
    "stops: motor velocity",
    "stops: deflection",
    "stops: tracking error",
    "stops: law",
    "resumes",
    "efforts not finite",
    "efforts saturated",
    "efforts rate limited",
    "gains changed",
    "settings changed",
    "references changed",
    "holds",
)
"""Names of the counters, in the order of enum fjr_kind in step.h."""
ERRORS = (STARTS_REFUSED, STOPS, "efforts not finite")
WARNINGS = ("reference restarts", "silences", "forward jumps", "observer restarts", "efforts saturated")
"""Kinds of events by level; all others inform."""
