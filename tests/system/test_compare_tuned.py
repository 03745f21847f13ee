# SPDX-License-Identifier: Apache-2.0
"""`fjr compare` with every law tuned to the same uncertainties: results, table, page, invalid sections."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import pytest
import yaml

from fjr_design.studies.comparison.markdown import BEGIN, END, marks
from fjr_design.studies.comparison.results import rows, table_rows
from fjr_msgs_py.console.ending import Exit
from system.executables import fjr_here

pytestmark = pytest.mark.system
TUNE: dict[str, Any] = {
    "vary": {"stiffness": {"log_uniform": [0.5, 2.0]}},
    "imperfections": {"delay": 0.001, "noise": 0.001, "friction": 0.05},
    "candidates": 12,
    "draws": 6,
    "fresh": 20,
    "duration": 0.6,
    "settle_after": 0.3,
}
SUITE: dict[str, Any] = {
    "laws": ["v_dpbc", "lqr", {"label": "v-dPBC + residual", "law": "v_dpbc", "robust": {"residual_gain": 20.0}}],
    "robots": {"one joint": {"scenario": "paper_k31"}},
    "tune": TUNE,
    "duration": 1.0,
    "settle_after": 0.5,
    "margins": ["delay"],
}


def compared(folder: Path, document: dict[str, Any], *arguments: str) -> dict[str, Any]:
    folder.mkdir(exist_ok=True)
    file = folder / "alike.yaml"
    file.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
    fjr_here("compare", str(file), "--output", str(folder), *arguments)
    found: dict[str, Any] = json.loads((folder / "compare_alike" / "comparison.json").read_text())
    return found


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("tuned_alike")


@pytest.fixture(scope="module")
def page(folder: Path) -> Path:
    path = folder / "page.md"
    first, last = marks("alike")
    path.write_text(f"before\n{first}\n{last}\nbetween\n{BEGIN}\nkept\n{END}\n")
    return path


@pytest.fixture(scope="module")
def found(folder: Path, page: Path) -> dict[str, Any]:
    return compared(folder, SUITE, "--cores", "2", "--document", str(page))


def test_every_law_has_its_figures_on_fresh_draws_and_its_parameters(found: dict[str, Any]) -> None:
    for label, result in found["results"]["one joint"].items():
        assert set(result["uncertain"]) == {"rms", "rms_outer", "success", "effort_noise", "effort_peak"}
        assert result["uncertain"]["rms"] <= result["uncertain"]["rms_outer"]
        assert "20 fresh draws" in result["tuning"]
        assert ("robust.residual_gain" in result["gains"]) == (label == "v-dPBC + residual")
    assert found["results"]["one joint"]["lqr"]["gains"]["law.type"] == "lqr"


def test_fresh_figures_are_rows_beside_the_margins(found: dict[str, Any]) -> None:
    drawn = [row for row in rows(found) if row.group == "uncertain"]
    assert [row.what for row in drawn] == [
        "drawn: RMS error [mrad]",
        "drawn: its 95 % [mrad]",
        "drawn: share that tracks",
        "drawn: noise of effort",
    ]
    assert [row.what for row in rows(found) if row.group == "margins"] == ["delay up to"]


def test_the_table_stands_between_the_marks_of_its_suite(found: dict[str, Any], page: Path) -> None:
    before, _, rest = page.read_text().partition(marks("alike")[0])
    table, _, after = rest.partition(marks("alike")[1])
    assert "| drawn: share that tracks |" in table
    assert before == "before\n"
    assert after == f"\nbetween\n{BEGIN}\nkept\n{END}\n"


def test_drawn_figures_of_a_law_that_tracks_too_few_draws_do_not_count(found: dict[str, Any]) -> None:
    changed = copy.deepcopy(found)
    figures = changed["results"]["one joint"]["lqr"]["uncertain"]
    figures |= {"success": 0.94, "rms": 1e-6, "effort_noise": 1e-6}
    drawn = {row.what: row for row in rows(changed) if row.group == "uncertain"}
    assert [drawn[what].best[1] for what in ("drawn: RMS error [mrad]", "drawn: noise of effort")] == [False, False]
    assert drawn["drawn: share that tracks"].values[1].words == "94.0 %"
    figures["success"] = 0.95
    assert next(row for row in rows(changed) if row.what == "drawn: noise of effort").best[1]


def test_rows_are_counted_in_which_a_law_is_best(found: dict[str, Any], page: Path) -> None:
    shown = [row.best for row in table_rows(found)]
    v_dpbc, lqr = (sum(any(best[i] for i in columns) for best in shown) for columns in ((0, 2), (1,)))
    first, second = sorted([("v-dPBC", v_dpbc), ("LQR", lqr)], key=lambda one: -one[1])
    counts = f"{first[0]} {first[1]}, {second[0]} {second[1]} of 7 rows (several laws may share a row)."
    assert f"Best, or within 5 % of the best, with one of its versions: {counts}" in page.read_text()
    assert max(v_dpbc, lqr) <= 7 <= v_dpbc + lqr


def test_the_page_says_how_the_laws_were_tuned(folder: Path, found: dict[str, Any]) -> None:
    text = (folder / "compare_alike" / "comparison.html").read_text()
    assert "Every law is tuned to the same uncertainties" in text
    assert "Drawn plants" in text


def test_results_do_not_depend_on_the_number_of_cores(folder: Path, found: dict[str, Any]) -> None:
    two = {**SUITE, "laws": SUITE["laws"][:2]}
    again = compared(folder / "again", two, "--cores", "1")["results"]["one joint"]
    assert again == {label: found["results"]["one joint"][label] for label in again}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"draw": 5}, "'tune': has 'draw'; expected draws"),
        ({"vary": {"stiffnes": 0.5}}, "'vary' has 'stiffnes'; expected some of stiffness"),
        ({"imperfections": {"wind": 1.0}}, "unknown imperfection 'wind'"),
        ({"candidates": "many"}, "'candidates' is 'many'; expected a number"),
        ({"minimise": ["rms"]}, "'minimise' is ['rms']; expected a mapping"),
        ({"success": 2.0}, "'success' is 2.0; expected 0 to 1"),
        ({"draws": 0}, "'draws' is 0; expected 1 to"),
        ({"settle_after": 0.7}, "'settle_after' is 0.7 and 'duration' 0.6 s"),
    ],
)
def test_invalid_sections_are_refused_in_one_sentence(tmp_path: Path, change: dict[str, Any], words: str) -> None:
    file = tmp_path / "alike.yaml"
    file.write_text(yaml.safe_dump({**SUITE, "tune": {**TUNE, **change}}, sort_keys=False), encoding="utf-8")
    refused = fjr_here(
        "compare", str(file), "--output", str(tmp_path), "--cores", "1", codes=(Exit.FAILED, Exit.NOT_UNDERSTOOD)
    )
    assert words in refused
    assert "Traceback" not in refused
