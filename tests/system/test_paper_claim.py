# SPDX-License-Identifier: Apache-2.0
"""The demo: the claim is stated with the numbers of two runs, and only if they show it; a stopped run is repeated."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from fjr_bringup.cli import run
from fjr_core.config.scenario import load_scenario
from fjr_monitor.recording.bag import read_bag
from fjr_monitor.recording.run import ControllerStop
from fjr_monitor.report.comparison_page import Claim, paper_claim
from fjr_monitor.report.metrics import Report
from fjr_monitor.report.shown import RunSummary
from fjr_monitor.report.write import compare, report_bag
from fjr_msgs_py.scenarios import library
from system.browser import Browser
from system.executables import scenario
from system.shared_runs import shared_run

pytestmark = pytest.mark.system
STIFFNESS = (31.0, 3.1)


@pytest.fixture(scope="module")
def summaries(tmp_path_factory: pytest.TempPathFactory) -> list[RunSummary]:
    folders = [shared_run(tmp_path_factory, name) for name in ("paper_k31", "paper_k3p1")]
    output = tmp_path_factory.mktemp("reports")
    return [
        report_bag(each.name, read_bag(each / "bag"), load_scenario(each / "scenario.yaml"), output / each.name)
        for each in folders
    ]


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


def test_a_demonstration_that_is_stopped_in_real_time_is_repeated_in_lock_step(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In real time: test_real_time.py."""
    stopping = tmp_path / "stopping.yaml"
    text, _ = library.as_run(Path(scenario("paper_k31")), {"limits.tracking_error": [0.2]})
    stopping.write_text(text)
    summary = run._demonstrate(str(stopping), 0.3, tmp_path / "runs")
    assert summary.report.stop is not None
    assert summary.report.lockstep
    said = capsys.readouterr().err
    assert re.search(r"the run in real time was stopped at 0\S* s, with \d+\S* % of the states .* in lock-step", said)
    assert ["repeated in lock-step" in note for note in summary.notes] == [True]
    assert len(list((tmp_path / "runs").glob("stopping-*"))) == 2
