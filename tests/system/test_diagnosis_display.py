# SPDX-License-Identifier: Apache-2.0
"""A degraded diagnosis is shown in amber with its error on the page, in the terminal and in report.json."""

from __future__ import annotations

import io
import json
import re
from importlib.resources import files

import numpy as np
import pytest
from rich.console import Console

from fjr_monitor.diagnosis.diagnosis import Diagnosis
from fjr_monitor.report import html, runs_report
from fjr_monitor.watch.state import Health
from fjr_monitor.watch.terminal import _status
from fjr_msgs_py.console.output import finite
from fjr_msgs_py.node.reports import VERDICT_LEVELS

pytestmark = pytest.mark.system
DEGRADED = Diagnosis(
    "degraded",
    ("delay",),
    "delay makes 0.14 mrad at joint2, within the tolerance: the effort acted late",
    {"violated share": 0.5},
    {"delay": np.array([1e-4, 1.4e-4]), "loss": np.array([np.inf, 0.0])},
    "delay makes 0.14 mrad at joint2",
)


def test_the_page_shows_the_number_in_amber() -> None:
    line = html.environment().get_template("macros.html").module.verdict_line(DEGRADED)
    assert 'class="verdict degraded"' in line
    assert "Degraded: delay makes 0.14 mrad at joint2" in line
    css = (files("fjr_monitor") / "report" / "templates" / "page.css").read_text(encoding="utf-8")
    rule = re.search(r"\.degraded[^{]*\{([^}]*)\}", css)
    assert rule is not None
    assert "--doubt" in rule[1]
    assert runs_report.COLOURED["degraded"] == "maybe"


def test_every_verdict_has_a_level_a_heading_and_a_colour() -> None:
    kinds = {"holding", "degraded", "violated", "unknown"}
    assert set(html.HEADINGS) == set(runs_report.COLOURED) == {*kinds, "late"}
    assert set(VERDICT_LEVELS) == kinds


def test_the_terminal_shows_a_degraded_verdict_in_yellow() -> None:
    level = int.from_bytes(VERDICT_LEVELS["degraded"], "little")
    stream = io.StringIO()
    status = Health("fjr_controller: certificate", level, f"Degraded: {DEGRADED.sentence}")
    Console(file=stream, width=200, force_terminal=True, color_system="standard").print(_status(status))
    assert "\x1b[1;33mwarn" in stream.getvalue()
    assert "Degraded: delay makes 0.14 mrad at joint2" in stream.getvalue()


def test_errors_by_cause_are_lists_in_the_report_and_null_where_not_finite() -> None:
    assert json.loads(json.dumps(finite(DEGRADED.errors))) == {"delay": [1e-4, 1.4e-4], "loss": [None, 0.0]}
