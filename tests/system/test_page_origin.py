# SPDX-License-Identifier: Apache-2.0
"""The head of every page written to a file: date, version, command line, machine, no names of users and hosts."""

from __future__ import annotations

import getpass
import json
import os
import platform
import re
from html import unescape
from pathlib import Path

import pytest

import fjr_core as fjr
from fjr_monitor.report import html
from fjr_msgs_py.console.provenance import EPOCH, Provenance, begin_command, machine, provenance
from system.executables import fjr_here
from system.shared_runs import shared_run

pytestmark = pytest.mark.system
TEMPLATES = sorted((Path(html.__file__).parent / "templates").glob("*.html"))
WITHOUT_HEAD = ("film", "live")
PAGES = [
    path for path in TEMPLATES if '{% extends "page.html" %}' in path.read_text() and path.stem not in WITHOUT_HEAD
]


def origin(page: Path) -> list[str]:
    """Return the lines of the origin in the head of a page."""
    (found,) = re.findall(r'<p class="origin">(.*?)</p>', page.read_text(), re.DOTALL)
    return [unescape(re.sub("<.*?>", "", line)) for line in re.findall(r"<span>(.*?)</span>", found)]


def test_every_page_has_the_common_head() -> None:
    for template in PAGES:
        assert template.read_text().count("macros.header(") == 1, template
    assert len(PAGES) > 3


def test_head_names_the_command_that_recorded_the_run_and_the_one_that_wrote_the_page(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = shared_run(tmp_path_factory, "paper_k31")
    monkeypatch.setenv(EPOCH, "1700000000")
    fjr_here("report", str(run), "--output", str(tmp_path))
    recorded, written = origin(tmp_path / "paper_k31" / "report.html")
    assert "fjr run paper_k31 --lockstep" in recorded
    assert written.startswith(f"Written 2023-11-14 22:13 UTC by fjr {fjr.__version__} · fjr report {run} ")
    said = f"{platform.system()} {platform.release()}, Python {platform.python_version()}"
    for line in (recorded, written):
        assert line.endswith(machine())
        assert said in line
        assert f", {len(os.sched_getaffinity(0))} core" in line
    report = json.loads((tmp_path / "paper_k31" / "report.json").read_text())
    assert report["provenance"] == json.loads((run / "report.json").read_text())["provenance"]


def test_origin_has_no_name_of_user_or_host(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/jane_doe")
    begin_command(["fjr", "run", "/home/jane_doe/arm.yaml"])
    made = provenance()
    assert made.command == "fjr run ~/arm.yaml"
    words = re.findall(r"\w+", " ".join((made.date, made.version, made.machine)).lower())
    assert platform.node().lower() not in words
    assert getpass.getuser() not in words


def test_an_epoch_that_is_no_date_is_ignored_and_the_origin_of_a_damaged_report_unknown(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for text in ("tomorrow", "99999999999999999999", "-1e3", ""):
        monkeypatch.setenv(EPOCH, text)
        begin_command(["fjr"])
        assert provenance().date.startswith("20")
    known = provenance()
    assert Provenance.read(vars(known)) == known
    assert Provenance.read({**vars(known), "machine": None}) is Provenance.read(None) is None
