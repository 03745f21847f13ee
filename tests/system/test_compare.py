# SPDX-License-Identifier: Apache-2.0
"""`fjr compare`: results determined by the suite alone, a page in a real browser, a table, one sentence for errors."""

from __future__ import annotations

import copy
import json
import os
import re
import signal
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from fjr_core.config.scenario import parse_scenario
from fjr_core.errors import FjrError, ParameterError
from fjr_core.extensions.law_registry import LAWS, V_DPBC
from fjr_core.numerics import jit as jit_cache
from fjr_design.batch import Draws, scenario_loop
from fjr_design.studies import compare_page, compare_run, suite
from fjr_design.studies.compare_results import BEGIN, END, Row, Value, extent, markdown, marks, rows, table_rows
from fjr_msgs_py.console.ending import Exit
from fjr_msgs_py.scenarios import library
from system.browser import Browser
from system.executables import Start, documented_keys, fjr_here, is_alive, wait_for
from time_limits import HANG

pytestmark = pytest.mark.system
QUICK: dict[str, Any] = {
    "laws": [
        "v_dpbc",
        "torque_feedback",
        {"label": "v-dPBC + residual", "law": "v_dpbc", "robust": {"residual_gain": 20.0}},
    ],
    "robots": {
        "one joint": {"scenario": "paper_k31", "references": {"slow": {}, "fast": {"reference.frequency": [3.0]}}}
    },
    "duration": 1.2,
    "settle_after": 0.6,
    "imperfections": {"soft": {"stiffness": 0.8}, "noisy": {"noise": 1e-4, "friction": 0.1}},
    "margins": ["stiffness", "delay"],
}
PLOTS = ["robot-0-error", "robot-0-effort", "robot-0-stiffness", "robot-0-delay"]
AT_REST = {f"initial_{side}_position": [0.0] for side in ("link", "motor")}


def compared(folder: Path, document: dict[str, Any], *arguments: str) -> tuple[dict[str, Any], str]:
    file = folder / "mine.yaml"
    file.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
    said = fjr_here("compare", str(file), "--output", str(folder / "runs"), *arguments)
    return json.loads((folder / "runs" / "compare_mine" / "comparison.json").read_text()), said


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("compared")


@pytest.fixture(scope="module")
def found(folder: Path) -> dict[str, Any]:
    document, said = compared(folder, QUICK, "--cores", "2", "--json")
    result, _ = json.JSONDecoder().raw_decode(said)
    assert set(result) == documented_keys()["compare"]
    assert result.items() >= document.items()
    return document


def test_every_cell_and_margin_is_present(found: dict[str, Any]) -> None:
    assert list(found["results"]["one joint"]) == ["v_dpbc", "torque_feedback", "v-dPBC + residual"]
    for result in found["results"]["one joint"].values():
        assert list(result["margins"]) == ["stiffness down to", "stiffness up to", "delay up to"]
        assert list(result["cells"]) == ["slow", "fast"]
        assert all(list(cells) == ["nominal", "soft", "noisy"] for cells in result["cells"].values())
    assert len({tuple(result["effort_limit_nm"]) for result in found["results"]["one joint"].values()}) == 1
    plain, robust = (found["results"]["one joint"][label]["cells"]["slow"] for label in ("v_dpbc", "v-dPBC + residual"))
    assert robust["soft"]["rms"] < 0.8 * plain["soft"]["rms"]  # its option takes effect


@pytest.mark.usefixtures("found")
def test_kept_results_are_not_run_again(folder: Path) -> None:
    kept = folder / "runs" / "compare_mine" / "kept"
    before = {path: path.stat().st_mtime_ns for path in kept.glob("*.json")}
    one = next(iter(before))
    text = one.read_text()
    one.write_text(text[: len(text) // 2])  # as after a full disk
    _, said = compared(folder, QUICK)
    assert "1 of 3 pairs of law and robot to run" in said
    table = said[said.index("\none joint\n") :].splitlines()
    assert {"RMS error [mrad]", "peak effort"} <= {line.split("  ")[0] for line in table}
    files = ", ".join(str(folder / "runs" / "compare_mine" / f"comparison.{kind}") for kind in ("html", "json"))
    assert f"page and figures: {files}" in table


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGKILL, marks=pytest.mark.full)])
def test_results_do_not_depend_on_an_interruption_the_order_of_laws_or_the_number_of_cores(
    tmp_path: Path, start: Start, number: int, found: dict[str, Any]
) -> None:
    file, folder = tmp_path / "mine.yaml", tmp_path / "runs" / "compare_mine"
    file.write_text(yaml.safe_dump({**QUICK, "laws": QUICK["laws"][::-1]}, sort_keys=False), encoding="utf-8")
    arguments, kept = ["compare", str(file), "--output", str(tmp_path / "runs"), "--cores", "1"], folder / "kept"
    ended = start("fjr", *arguments)
    wait_for(lambda: any(kept.glob("*.json")), "a result")
    ended.signal(number)
    code, said = ended.end()
    wait_for(lambda: not is_alive(ended.process.pid), "the end")  # the workers must end, too
    ctrl_c = number == signal.SIGINT
    assert (code, "stopped; what was recorded is in" in said) == ((Exit.INTERRUPTED, True) if ctrl_c else (-9, False))
    assert "Traceback" not in said
    left = len(QUICK["laws"]) - len(list(kept.glob("*.json")))
    assert left
    assert f"compare: {left} of {len(QUICK['laws'])} pairs of law and robot" in fjr_here(*arguments)
    again = json.loads((folder / "comparison.json").read_text())
    assert again["results"] == found["results"]
    assert again["laws"] == found["laws"][::-1]


class Failing:
    """Replacement of a worker: one law fails or kills its process, the other never ends."""

    def __init__(self, kill: bool) -> None:
        self.kill = kill

    def __call__(self, job: compare_run.Job, _number: int) -> compare_run.Values:
        if job.law.law == "v_dpbc":
            time.sleep(HANG)
        if self.kill:
            os.kill(os.getpid(), signal.SIGKILL)
        raise ParameterError("no gains")


@pytest.mark.parametrize(("kill", "words"), [(False, "^no gains$"), (True, "a worker process died")])
def test_failure_is_reported_while_other_jobs_run(
    kill: bool, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    jobs = compare_run.jobs(suite.read("mine", {**QUICK, "laws": ["v_dpbc", "torque_feedback"]}))
    monkeypatch.setattr(compare_run, "work", Failing(kill))
    begun = time.monotonic()
    with pytest.raises(FjrError, match=words):
        compare_run.run(jobs, tmp_path, 2, threading.Event())
    assert time.monotonic() - begun < HANG


def test_key_of_kept_results_depends_on_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def key(scenario: str = "paper_k31") -> str:
        return compare_run.jobs(suite.read("mine", {**QUICK, "robots": {"joint": {"scenario": scenario}}}))[0].key

    before, own_plant = key(), tmp_path / "own_plant.yaml"
    own_plant.write_text(library.as_run(library.find("paper_k31"), {"plant.type": "own_code:Ideal"})[0])
    with monkeypatch.context() as other:
        other.setattr(jit_cache, "source_digest", lambda *_: "another")
        assert key() != before
    assert key() == before
    before = key(str(own_plant))
    monkeypatch.setattr(compare_run, "source_digest", lambda _: "another")
    assert key(str(own_plant)) != before


@pytest.mark.parametrize(
    ("numbers", "states", "less", "best"),
    [
        ((1.0, 0.5, 2.0), "ttt", True, "nyn"),
        ((1.0, 0.96, 2.0), "ttt", True, "yyn"),
        ((1.0, 0.5, 2.0), "ttt", False, "nny"),
        ((1.0, 0.5, 2.0), "tlt", True, "ynn"),
        ((None, None, 2.0), "ult", True, "nny"),
        ((None, None, None), "ull", True, "nnn"),
    ],
)
def test_best_of_a_row(numbers: Any, states: str, less: bool, best: str) -> None:
    names = {"t": "tracks", "l": "lost", "u": "unstable"}
    values = tuple(Value(n, "", names[s]) for n, s in zip(numbers, states, strict=True))
    row = Row("r", "k", "", "w", values, less)
    assert row.best == tuple(letter == "y" for letter in best)


def test_the_page_draws_everything_and_states_the_findings(
    folder: Path, found: dict[str, Any], browser: Browser
) -> None:
    page = folder / "runs" / "compare_mine" / "comparison.html"
    browser.draws(page, PLOTS)
    text = browser.value("document.body.innerText")
    assert extent(found)[:-1] in text
    assert "not a ranking" in text
    best = browser.value("[...document.querySelectorAll('td b.ok')].map((cell) => cell.textContent)")
    assert best == [v.words for row in rows(found) for v, is_best in zip(row.values, row.best, strict=True) if is_best]


def test_names_of_a_page_are_escaped_once(found: dict[str, Any], tmp_path: Path) -> None:
    text = json.dumps(found)
    for name in ("one joint", "slow", "noisy", "v-dPBC + residual"):
        text = text.replace(name, f"{name}<b onload=x>")
    compare_page.write_page(tmp_path / "page.html", json.loads(text))
    page = (tmp_path / "page.html").read_text()
    assert "<b onload" not in page
    assert page.count("&lt;b onload=x&gt;") > 10
    assert "&amp;lt;" not in page


def test_table_replaces_the_one_between_the_markers(folder: Path, found: dict[str, Any]) -> None:
    page = folder / "page.md"
    page.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n", encoding="utf-8")
    assert "--readme is deprecated; use --document" in compared(folder, QUICK, "--readme", str(page))[1]
    assert page.read_text() == f"before\n{BEGIN}\n{markdown(found)}{END}\nafter\n"
    lines = [line for line in page.read_text().splitlines() if line.startswith("|")]
    assert {line.count(" | ") for line in lines} == {3}
    assert not [cell for line in lines[3:] for cell in line.split("|") if "**" in cell]  # no winner is named


def test_a_law_of_the_user_has_options_and_is_named_as_not_tuned(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    mine = {"law": "own_code:Pd", "label": "mine", "options": {"K_p": 5.0}}
    file.write_text(yaml.safe_dump({"laws": ["v_dpbc", mine], "robots": {"paper_k31": {}}}))
    known, own = suite.load(file).laws
    assert (known.options, own.law, own.options) == ({}, "own_code:Pd", {"K_p": 5.0})
    laws = [{"law": each.law, "title": each.label} for each in (known, own)]
    assert compare_page.laws_of_the_user({"laws": laws}) == ["mine"]


def test_the_installed_suites_hold_every_law_and_the_tuned_ones_differ_in_robots_and_draws() -> None:
    names = ("paper", "quick", "paper_tuned", "arm7_tuned")
    paper, quick, few, seven = (suite.load(library.find(name, "suite")) for name in names)
    for chosen, name in zip((paper, quick, few, seven), names, strict=True):
        assert (chosen.name, chosen.laws[0]) == (name, suite.LawChoice(V_DPBC, V_DPBC))
        assert all(suite.scenario_texts(robot) for robot in chosen.robots)
    assert quick.robots[0].references == {"scenario": {}}  # its own, where none are named
    for chosen in (paper, few):
        assert {law.law for law in chosen.laws} == set(LAWS)
    for robots in (paper.robots, (*few.robots, *seven.robots)):
        assert [robot.scenario for robot in robots] == ["paper_k31", "two_link", "arm7"]
    assert paper.margins == ("stiffness", "inertia", "delay", "noise", "friction", "load")
    tune = {**(few.tune or {}), "draws": 8, "fresh": 200}
    assert replace(few, name=seven.name, robots=seven.robots, tune=tune) == seven
    laws = [{"law": law.law} for law in paper.laws]  # versions of a law count as one law
    described = extent({"laws": laws, "robots": {"one": {}}, "runs": 12, "suite": {"duration": 10.0}})
    assert described == f"{len(LAWS) - 2} control laws in {len(laws)} versions on 1 robot, 12 runs of 10 s."


def test_a_transition_from_the_measured_state_spares_the_first_effort_and_every_law_starts_without_a_limit() -> None:
    """two_link limits the error of its start to 0.41 and 0.22 rad; noise of the velocity would exceed it."""
    (robot,) = suite.read("two", {"laws": ["v_dpbc"], "robots": {"two_link": {}}}).robots
    peaks = []
    for join in (0.0, 0.5):
        ((_, text),) = suite.scenario_texts(robot, join)
        scenario = parse_scenario("two", text)
        found = scenario_loop(scenario, scenario.sampled_law, 0.5, settle_after=0.1).run(Draws(1, velocity_noise=0.3))
        assert found.cause[0] == ""
        peaks.append(found.effort_peak[0].max())
    assert peaks[1] < 0.5 * peaks[0]


PAPER = {"scenario": "paper_k31"}
WRONG: list[tuple[Any, str]] = [
    (["v_dpbc"], r"^is \['v_dpbc'\]; expected a mapping"),
    ({"laws": ["v_dpbc"]}, "has no 'robots'"),
    ({**QUICK, "law": 1}, "has 'law'; did you mean 'laws'"),
    ({**QUICK, "laws": "v_dpbc"}, "has 'v_dpbc' as 'laws'; expected a list"),
    ({**QUICK, "laws": ["pid"]}, "unknown law 'pid': expected one of v_dpbc, "),
    ({**QUICK, "laws": [{"law": ["v_dpbc"]}]}, r"unknown law '\['v_dpbc'\]': expected one of"),
    ({**QUICK, "laws": ["v_dpbc", "v_dpbc"]}, "law 'v_dpbc' is listed twice"),
    ({**QUICK, "laws": [{"law": "lqr", "robust": {"magic": 1.0}}]}, "law 'lqr': 'robust': has 'magic'; expected some"),
    ({**QUICK, "laws": [{"law": "lqr", "gain": 1.0}]}, "law 'lqr': has 'gain'; did you mean 'gains'"),
    (
        {**QUICK, "laws": [{"law": "lqr", "gains": "tuned"}]},
        "'gains' of lqr is 'tuned'; expected 'tuned', for v_dpbc",
    ),
    ({**QUICK, "laws": [{"law": "v_dpbc", "gains": "best"}]}, "'gains' of v_dpbc is 'best'; expected 'tuned', for"),
    ({**QUICK, "laws": [{"law": "lqr", "options": {"K": 1.0}}]}, "law 'lqr' has options; expected them for a law of y"),
    ({**QUICK, "laws": [{"law": "lqr", "join": -1.0}]}, "has -1.0 as 'join'; expected 0 to 10"),
    ({**QUICK, "robots": []}, "has no 'robots'"),
    ({**QUICK, "robots": {"r": {**PAPER, "gains": {}}}}, "robot 'r': has 'gains'; expected some of scenario, ref"),
    (
        {**QUICK, "robots": {"r": {**PAPER, "references": {"x": {"gains.K_ld": [0.8]}}}}},
        "robot 'r': reference 'x' changes 'gains.K_ld'; expected names that begin with reference. or initial_",
    ),
    ({**QUICK, "imperfections": {"nominal": {"delay": 0.001}}}, "an imperfection is called 'nominal'"),
    ({**QUICK, "imperfections": {"x": {"wind": 1.0}}}, "'x': has 'wind'; expected some of stiffness, "),
    ({**QUICK, "imperfections": {"x": {"delay": "long"}}}, "'x': has 'long' as 'delay'; expected a number"),
    ({**QUICK, "imperfections": {"x": {"stiffness": -1.0}}}, "has -1.0 as 'stiffness'; expected a positive factor"),
    ({**QUICK, "imperfections": {"x": {"delay": -1e-3}}}, r"has -0.001 as 'delay'; expected 0 or more \[s\]"),
    ({**QUICK, "margins": ["gust"]}, "unknown imperfection 'gust': expected one of stiffness, inertia, delay, noise"),
    ({**QUICK, "margins": "delay"}, "has 'delay' as 'margins'; expected a list"),
    ({**QUICK, "duration": 0}, "has 0 as 'duration'; expected 0.001 to 600"),
    ({**QUICK, "duration": 10**400}, "has 10* as 'duration'; expected a number"),
    ({**QUICK, "settle_after": 2.0}, "'settle_after' is 2.0 and 'duration' 1.2 s; expected 0 to less"),
    ({**QUICK, "tracks": True}, "has True as 'tracks'; expected a number"),
]


@pytest.mark.parametrize(("document", "words"), WRONG, ids=[words for _, words in WRONG])
def test_invalid_suite_is_refused_in_one_sentence(document: Any, words: str) -> None:
    with pytest.raises(ParameterError, match=words):
        suite.read("mine", document)


TUNE: dict[str, Any] = {
    "vary": {"stiffness": {"log_uniform": [0.5, 2.0]}},
    "imperfections": {"delay": 0.001, "noise": 0.001, "friction": 0.05},
    "candidates": 6,
    "draws": 4,
    "fresh": 20,
    "duration": 0.6,
    "settle_after": 0.3,
}
ALIKE: dict[str, Any] = {
    "laws": ["v_dpbc", "lqr", {"label": "v-dPBC + residual", "law": "v_dpbc", "robust": {"residual_gain": 20.0}}],
    "robots": {"one joint": {"scenario": "paper_k31"}},
    "tune": TUNE,
    "duration": 1.0,
    "settle_after": 0.5,
    "margins": ["delay"],
}


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("tuned_alike") / "page.md"
    first, last = marks("mine")
    path.write_text(f"before\n{first}\n{last}\nbetween\n{BEGIN}\nkept\n{END}\n")
    return path


@pytest.fixture(scope="module")
def alike(page: Path) -> dict[str, Any]:
    return compared(page.parent, ALIKE, "--cores", "1", "--document", str(page))[0]


def test_every_law_has_its_figures_on_fresh_draws_beside_the_margins(alike: dict[str, Any]) -> None:
    for label, result in alike["results"]["one joint"].items():
        assert set(result["uncertain"]) == {"rms", "rms_outer", "success", "effort_noise", "effort_peak"}
        assert result["uncertain"]["rms"] <= result["uncertain"]["rms_outer"]
        assert "20 fresh draws" in result["tuning"]
        assert ("robust.residual_gain" in result["gains"]) == (label == "v-dPBC + residual")
    assert alike["results"]["one joint"]["lqr"]["gains"]["law.type"] == "lqr"
    drawn = ("RMS error [mrad]", "its 95 % [mrad]", "share that tracks", "noise of effort")
    assert [row.name for row in rows(alike) if row.kind == "drawn"] == [f"drawn: {what}" for what in drawn]
    assert [row.name for row in rows(alike) if row.kind == "margins"] == ["delay up to"]


def test_the_table_stands_between_the_marks_of_its_suite(alike: dict[str, Any], page: Path) -> None:
    before, _, rest = page.read_text().partition(marks("mine")[0])
    table, _, after = rest.partition(marks("mine")[1])
    assert "| drawn: share that tracks |" in table
    assert before == "before\n"
    assert after == f"\nbetween\n{BEGIN}\nkept\n{END}\n"
    assert "Every law is tuned to the same uncertainties" in page.with_name("runs").joinpath(
        "compare_mine", "comparison.html"
    ).read_text(encoding="utf-8")


def test_drawn_figures_of_a_law_that_tracks_too_few_draws_do_not_count(alike: dict[str, Any]) -> None:
    changed = copy.deepcopy(alike)
    figures = changed["results"]["one joint"]["lqr"]["uncertain"]
    figures |= {"success": 0.94, "rms": 1e-6, "effort_noise": 1e-6}
    drawn = {row.name: row for row in rows(changed) if row.kind == "drawn"}
    assert [drawn[what].best[1] for what in ("drawn: RMS error [mrad]", "drawn: noise of effort")] == [False, False]
    assert drawn["drawn: share that tracks"].values[1].words == "94.0 %"
    figures["success"] = 0.95
    assert next(row for row in rows(changed) if row.name == "drawn: noise of effort").best[1]


def test_rows_are_counted_in_which_a_column_is_best(alike: dict[str, Any], page: Path) -> None:
    shown = [row.best for row in table_rows(alike)]
    counts = {law["title"]: sum(best[i] for best in shown) for i, law in enumerate(alike["laws"])}
    (line,) = re.findall(r"Best, or within 5 % of the best: (.*) of 7 rows", page.read_text())
    assert dict(re.findall(r"(\D+?) (\d+)(?:, |$)", line)) == {name: str(count) for name, count in counts.items()}
    assert max(counts.values()) <= 7 <= sum(counts.values())


STILL = {"still": {"reference.amplitude": [0.0], "reference.offset": [0.0], **AT_REST}, "slow": {}}
MISSPELT = {"x": {"reference.frequenzy": [1.0]}}


@pytest.mark.parametrize(
    ("robot", "tune", "words"),
    [
        ({**PAPER, "references": MISSPELT}, {}, "did you mean 'reference.freq"),
        ({"scenario": "late.yaml"}, {}, "robot 'r': the scenario sets imperfections.state_delay; "),
        ({**PAPER, "references": STILL}, {}, "'still' of r: the reference is at rest"),
        (PAPER, {"vary": {"stiffnes": 0.5}}, "'vary' has 'stiffnes'; expected some of payload_mass, "),
        (PAPER, {"imperfections": {"wind": 1.0}}, "'tune': 'imperfections': has 'wind'; expected some of"),
        (PAPER, {"success": 2.0}, "'tune': has 2.0 as 'success'; expected 0 to 1"),
        (PAPER, {"seed": -1}, "'tune': has -1 as 'seed'; expected 0 to"),
        (PAPER, {"settle_after": 0.7}, "'settle_after' is 0.7 and 'duration' 0.6 s"),
    ],
)
def test_what_only_the_jobs_of_a_suite_know_is_refused_in_one_sentence(
    robot: dict[str, Any], tune: dict[str, Any], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "late.yaml").write_text("/**: {ros__parameters: {imperfections.state_delay: 0.001}}\n")
    kind = {**ALIKE, "tune": {**TUNE, **tune}} if tune else QUICK

    def run() -> None:
        compare_run.work(compare_run.jobs(suite.read("mine", {**kind, "robots": {"r": robot}}))[0])

    with pytest.raises(FjrError, match=re.escape(words)):
        run()
