# SPDX-License-Identifier: Apache-2.0
"""Results of `fjr` as JSON, runs without pages or certificate, what a slow machine is told, the claim of the demo."""

from __future__ import annotations

import getpass
import json
import math
import os
import platform
import re
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

import fjr_core as fjr
from fjr_bringup.cli.app import fjr as application
from fjr_bringup.cli.app import main
from fjr_bringup.cli.run import _demonstrate, _result
from fjr_core.config.scenario import load_scenario
from fjr_core.extensions.law_registry import LAWS
from fjr_monitor.recording.bag import read_bag
from fjr_monitor.recording.run import ControllerStop
from fjr_monitor.report import html
from fjr_monitor.report.comparison_page import Claim, paper_claim
from fjr_monitor.report.metrics import Report
from fjr_monitor.report.run_page import draw_overview, write_run_page
from fjr_monitor.report.shown import RunSummary
from fjr_monitor.report.write import compare, report_bag
from fjr_monitor.report.write import report as report_bags
from fjr_msgs_py.console import output as progress
from fjr_msgs_py.console.ending import Exit
from fjr_msgs_py.console.output import json_text
from fjr_msgs_py.console.provenance import EPOCH, Provenance, begin_command, machine, provenance
from fjr_msgs_py.scenarios import library
from system.browser import Browser
from system.executables import documented_keys, fjr_here, scenario
from system.shared_runs import shared_run
from time_limits import Limit
from two_link_urdf import two_link_urdf

pytestmark = pytest.mark.system


SHOWN = [name for name, each in application.commands.items() if not each.hidden]


@pytest.fixture(scope="module")
def summaries(tmp_path_factory: pytest.TempPathFactory) -> list[RunSummary]:
    """Reports of two runs in lock-step, on the stiff and on the soft joint."""
    folders = [shared_run(tmp_path_factory, name) for name in ("paper_k31", "paper_k3p1")]
    output = tmp_path_factory.mktemp("reports")
    return [
        report_bag(each.name, read_bag(each / "bag"), load_scenario(each / "scenario.yaml"), output / each.name)
        for each in folders
    ]


@pytest.fixture(scope="module")
def summary(summaries: list[RunSummary]) -> RunSummary:
    return summaries[0]


def test_every_command_offers_json_and_is_documented() -> None:
    for name in SHOWN:
        assert "--json" in {option for each in application.commands[name].params for option in each.opts}, name
    assert {*documented_keys(), "echo", "watch"} == set(SHOWN)


@pytest.mark.parametrize(
    "line",
    [
        "scenarios",
        "check paper_k31",
        "gains paper_k31 --beta 5",
        "new arm.urdf --joints elbow",
        "description paper_k31",
        "export-c paper_k31 c",
        "record /nothing --duration 0.1 --output bag --force",
    ],
    ids=lambda line: line.partition(" ")[0],
)
def test_result_is_one_json_document_with_the_documented_keys(
    line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.urdf").write_text(two_link_urdf(), encoding="utf-8")
    assert main([*line.split(), "--json"]) == Exit.DONE
    assert set(json.loads(capsys.readouterr().out)) == documented_keys()[line.partition(" ")[0]]


def test_failed_check_prints_its_numbers_as_json() -> None:
    said = fjr_here("check", "paper_k31", "--set", "publish_rate:=20.0", "--json", code=Exit.FAILED)
    values, end = json.JSONDecoder().raw_decode(said)
    assert values["stable"] is False
    assert values["refused"] in said[end:]


def test_report_without_pages_is_the_same(summary: RunSummary, tmp_path: Path) -> None:
    run = Path(summary.report.bag).parent
    bare = report_bag("paper_k31", read_bag(run / "bag"), load_scenario(run / "scenario.yaml"), tmp_path, pages=False)
    assert [each.name for each in tmp_path.iterdir()] == [each.name for each in bare.files] == ["report.json"]
    assert bare.report.as_json() == summary.report.as_json()


def test_results_of_a_run_and_of_a_report_hold_the_metrics(summary: RunSummary, tmp_path: Path) -> None:
    found = json.loads(json_text(_result([summary]).values))
    assert set(found) == documented_keys()["run"]
    assert {"name", "folder", "page", "status", "advice", "verdict"} <= set(found["runs"][0])
    said = json.loads(json_text(report_bags([Path(summary.report.bag)], None, tmp_path, "").values))
    assert set(said) == documented_keys()["report"]
    (run,) = said["runs"]
    assert json.loads((Path(run["folder"]) / "report.json").read_text()).items() <= run.items()
    assert Path(run["page"]).is_file()


def test_a_run_with_another_law_is_reported_without_v(summary: RunSummary, tmp_path: Path) -> None:
    run = Path(summary.report.bag).parent
    _, scenario = library.as_run(run / "scenario.yaml", {"law.type": "lqr"})
    found, figure = report_bag("lqr", read_bag(run / "bag"), scenario, tmp_path), Figure()
    report = found.report.as_json()
    assert report["verdict"]["kind"] == "unknown"
    assert report["verdict"]["sentence"] == "no diagnosis: the law lqr has no certificate"
    assert report["storage"] is None
    assert np.isfinite(report["joints"][0]["peak_effort_nm"])
    assert (tmp_path / "report.html").is_file()
    draw_overview("lqr", found.data, found.report, figure)
    assert any("this law has no certificate" in text.get_text() for text in figure.findobj(Text))


@pytest.mark.parametrize("name", ["lqr", "active_disturbance"])  # without and with a state; of each: tests/design
def test_check_reports_another_law_its_gains_and_the_sampled_loop(name: str) -> None:
    said = fjr_here("check", "paper_k31", "--set", f"law.type:={name}")
    for words in (f"{name}: {LAWS[name].title}", "the same bandwidth", "none for this law", "in the whole range"):
        assert words in said
    assert "beta" not in said


def test_numbers_that_are_not_finite_are_null() -> None:
    values = {"a": math.nan, "b": [math.inf, 1.0], "c": np.array([1.0, np.nan]), "d": np.float64(2.0), "e": Path("x")}
    assert json.loads(json_text(values)) == {"a": None, "b": [None, 1.0], "c": [1.0, None], "d": 2.0, "e": "x"}


def with_answers(
    summary: RunSummary, in_time: float, causes: tuple[str, ...], lockstep: bool = False, arrived: float = 1.0
) -> RunSummary:
    """Return the summary of a violated run with shares of states that arrived, and of these answered in time."""
    report = summary.report
    counts = replace(report.counts, answered_in_time_fraction=in_time, published_fraction=arrived)
    verdict = replace(report.verdict, kind="violated", causes=causes)
    return replace(summary, report=replace(report, counts=counts, verdict=verdict, lockstep=lockstep))


@pytest.mark.parametrize(
    ("in_time", "causes", "lockstep", "late"),
    [
        (0.5, ("model mismatch",), False, True),
        (0.97, ("delay",), False, True),
        (0.97, ("loss",), False, True),
        (0.97, ("model mismatch",), False, False),
        (1.0, ("delay",), False, False),
        (0.5, ("delay",), True, False),
    ],
)
def test_a_violation_that_a_slow_machine_explains_is_no_verdict_and_advises_lock_step(
    summary: RunSummary, in_time: float, causes: tuple[str, ...], lockstep: bool, late: bool
) -> None:
    said = _result([with_answers(summary, in_time, causes, lockstep)])
    assert ("answers are late" in said.text, "try --lockstep" in said.text) == (late, late)
    assert ("violated" in said.text) == (not late)
    assert said.code == (Exit.LATE if late else Exit.VIOLATED)
    (run,) = said.values["runs"]
    assert (run["status"], run["verdict"]["kind"]) == ("late" if late else "violated", "violated")
    assert (run["advice"] in said.text, bool(run["advice"])) == (True, late)
    both = _result([with_answers(summary, 0.5, ("delay",)), with_answers(summary, in_time, causes, lockstep)])
    assert both.code == said.code  # a violation counts before a late machine


def test_states_that_a_driver_leaves_out_are_not_answered_late(summary: RunSummary) -> None:
    (found,) = _result([with_answers(summary, 1.0, ("model mismatch",), arrived=0.85)]).values["runs"]
    assert (found["status"], found["advice"]) == ("violated", "")
    for cause in ("loss", "sampling"):
        (found,) = _result([with_answers(summary, 1.0, (cause,), arrived=0.85)]).values["runs"]
        assert found["status"] == "late"
        assert "states are missing (85 % of them arrived)" in found["advice"]


def test_a_slow_machine_leaves_no_verdict_without_V_either(summary: RunSummary) -> None:
    report = with_answers(summary, 0.0, ()).report
    report = replace(report, verdict=replace(report.verdict, kind="unknown"))
    assert report.status == "late"
    assert "answers are late (0 % of the states were answered in time)" in report.advice
    assert replace(report, lockstep=True).status == "unknown"


def test_pages_of_a_slow_machine_advise_lock_step(summary: RunSummary, tmp_path: Path) -> None:
    found = with_answers(summary, 0.5, ("delay",))
    write_run_page(tmp_path / "report.html", found.data, found.report)
    for page in (tmp_path / "report.html", compare([found, found], tmp_path)):
        said = page.read_text(encoding="utf-8")
        assert html.HEADINGS["late"] in said
        assert found.report.advice in said
        assert html.HEADINGS["violated"] not in said


@pytest.mark.parametrize(("late", "advised"), [(20, True), (5, False)])
def test_a_stop_on_a_slow_machine_has_the_advice_too(
    summary: RunSummary, tmp_path: Path, late: int, advised: bool
) -> None:
    found = with_answers(summary, 0.5, ())
    stop = ControllerStop(0.1, "The controller stopped at 0.1 s", "tracking error of joint1")
    counts = replace(found.report.counts, answered=100, answered_in_time=100 - late)
    report = replace(found.report, stop=stop, counts=counts)
    assert report.status == "stopped"
    assert ("try --lockstep" in report.advice) == advised
    assert not replace(report, lockstep=True).advice
    write_run_page(tmp_path / "report.html", found.data, report)
    assert ("tracking error of joint1; answers are late" in (tmp_path / "report.html").read_text()) == advised


def test_long_step_reports_until_it_ends(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(progress, "BEAT", 0.001)
    said, limit = "", Limit(60.0)
    with progress.phase("a long step"):
        while said.count("a long step: ") < 2:
            assert not limit.passed()
            said += capsys.readouterr().err
    assert said.startswith("a long step\n")


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


# The demo: the claim is stated with the numbers of two runs, and only if they show it; a stopped run is repeated.


STIFFNESS = (31.0, 3.1)


def claim(stiff: Report, soft: Report) -> Claim:
    return paper_claim(stiff, soft, STIFFNESS)


def test_claim_states_the_numbers_of_both_runs(summaries: list[RunSummary], tmp_path: Path) -> None:
    made = claim(*(each.report for each in summaries))
    assert made.kind == "holding"
    for words in ("10 times softer", "31 and 3.1 N m/rad", "proven: at least 20 1/s", "from 26.2 N m to 255.8 N m"):
        assert words in made.sentence
    repeated = replace(summaries[1], notes=("repeated in lock-step",))
    page = compare([summaries[0], repeated], tmp_path, made).read_text()
    assert made.sentence in page
    assert "<li>paper_k3p1: repeated in lock-step</li>" in page


def test_the_page_of_the_claim_shows_link_position_and_effort_first(
    summaries: list[RunSummary], tmp_path: Path, browser: Browser
) -> None:
    page = compare(summaries, tmp_path, claim(*(each.report for each in summaries)))
    cut = "[...document.querySelectorAll('.scroll')].filter((each) => each.scrollWidth > each.clientWidth).length"
    values = "[...document.querySelectorAll('.u-legend .u-value')].filter((each) => each.offsetParent).length"
    for width in (1280, 400):
        browser.open(page, width=width)
        browser.is_sound()
        assert browser.figures()[:2] == ["positions", "efforts"]
        assert browser.value(cut) == 0
        assert browser.value(values) == 0, "values without a pointer"


def test_runs_that_do_not_show_the_claim_give_the_reason(summaries: list[RunSummary]) -> None:
    stiff, soft = (each.report for each in summaries)
    slow = replace(soft, tracking=replace(soft.tracking, settling_time_2_percent_s=1.5))
    never = replace(soft, tracking=replace(soft.tracking, settling_time_2_percent_s=None))
    assert soft.storage is not None
    lazy = replace(soft, storage=replace(soft.storage, measured_decay_rate_per_s=5.0))
    stopped = replace(soft, stop=ControllerStop(0.1, "The controller stopped", "for a reason"))
    violated = replace(soft, verdict=replace(soft.verdict, kind="violated", sentence="V grows."))
    expected = {
        "the transients differ: 0.2 s and 1.5 s": slow,
        "does not settle": never,
        "V does not decay at the guaranteed rate": lazy,
        "paper_k3p1: The controller stopped": stopped,
        "paper_k3p1: V grows": violated,
    }
    for words, report in expected.items():
        made = claim(stiff, report)
        assert made.kind == "unknown"
        assert words in made.sentence
        assert "N m" not in made.sentence


@pytest.mark.usefixtures("no_picture")
def test_a_demonstration_that_is_stopped_in_real_time_is_repeated_in_lock_step(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In real time: test_real_time.py."""
    stopping = tmp_path / "stopping.yaml"
    text, _ = library.as_run(Path(scenario("paper_k31")), {"limits.tracking_error": [0.2]})
    stopping.write_text(text)
    summary = _demonstrate(str(stopping), 0.3, tmp_path / "runs")
    assert summary.report.stop is not None
    assert summary.report.lockstep
    said = capsys.readouterr().err
    assert re.search(r"in real time was stopped at 0\S* s: \d+\S* % of the states arrived, .* in lock-step", said)
    assert ["repeated in lock-step" in note for note in summary.notes] == [True]
    assert len(list((tmp_path / "runs").glob("stopping-*"))) == 2
