# SPDX-License-Identifier: Apache-2.0
"""Suites, sweeps and kept results of any content are read or refused in one sentence."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from fjr_core.files.text_file import is_sealed, write_text
from fjr_design.studies import suite
from fjr_design.studies.compare_run import read_kept
from fjr_design.studies.study import open_store
from fjr_design.studies.sweep import Sweep
from fjr_design.studies.sweep_file import Options, planned, usual
from fjr_monitor.report.write import known_of
from fjr_msgs_py.scenarios import library
from fuzzing import answer, bytes_of, documents, fuzzed

SUITE = """
laws: [v_dpbc, {label: own, law: pd_gravity, robust: {integral_gain: 1.0}}]
robots: {paper_k31: {scenario: paper_k31, references: {slow: {reference.frequency: [0.1]}}}}
imperfections: {late: {delay: 1.0}}
margins: [delay]
duration: 2.0
"""
SWEEP = """
scenario: paper_k31
vary: {stiffness: {uniform: [0.7, 1.3], each_joint: true}, delay: {uniform: [0.0, 0.001]}, payload_mass: 0.1}
success: {peak: 0.1}
set: {publish_rate: 500.0}
runs: 20
duration: 0.1
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("plans")


def read_suite(folder: Path, data: bytes) -> str:
    path = folder / "suite.yaml"
    path.write_bytes(data)
    return answer(lambda: suite.load(path))


def read_sweep(folder: Path, data: bytes) -> str:
    path = folder / "sweep.yaml"
    path.write_bytes(data)
    return answer(lambda: planned(str(path), Options(1, None, folder, {}, {})))


@fuzzed(25)
@given(text=documents(yaml.safe_load(SUITE)))
def test_suites_with_misplaced_values(folder: Path, text: str) -> None:
    read_suite(folder, text.encode())


@fuzzed(30)
@given(text=documents(yaml.safe_load(SWEEP)))
def test_sweeps_with_misplaced_values(folder: Path, text: str) -> None:
    read_sweep(folder, text.encode())


@pytest.mark.parametrize("name", ["x" * 5000, "a/" * 3000, "..", "/dev/zero", ""])
def test_sweep_of_an_impossible_path_is_refused(name: str, folder: Path) -> None:
    assert read_sweep(folder, yaml.safe_dump({**yaml.safe_load(SWEEP), "scenario": name}).encode())
    assert answer(lambda: library.find(name))
    assert answer(lambda: library.find(name, "suite"))


def plan() -> Sweep:
    text = "/**: {ros__parameters: {compile: false}}"
    return Sweep("small", text, 20, usual(1e-3), duration=0.1)


COLUMNS = {"run": np.arange(10), "success": np.ones(10, bool)}


def filled(folder: Path) -> Path:
    with open_store(folder, plan().text, "program") as store:
        store.keep("first", COLUMNS)
        assert store.holds("first")
    return next((folder / "parts").glob("*.parquet"))


@fuzzed(8)
@given(data=st.data())
def test_changed_part_is_computed_again(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    folder = tmp_path_factory.mktemp("store")
    part = filled(folder)
    content = data.draw(bytes_of(part.read_bytes()))
    same = content == part.read_bytes()
    part.write_bytes(content)
    with open_store(folder, plan().text, "program") as store:
        assert store.holds("first") == same


def test_changed_table_is_refused(tmp_path: Path) -> None:
    filled(tmp_path)
    with open_store(tmp_path, plan().text, "program") as store:
        store.keep("second", COLUMNS)
        table = store.write_table(["first", "second"])
        assert pq.read_table(table).num_rows == 20
    table.write_bytes(table.read_bytes()[:-1] + b"x")

    def taken_up() -> None:
        with open_store(tmp_path, plan().text, "program"):
            pass

    assert "SHA-256" in answer(taken_up)


@pytest.mark.parametrize("text", ["[" * 100_000, "[]", "3", "{", '{"program": []}', "\0"])
def test_invalid_study_file_is_refused(text: str, tmp_path: Path) -> None:
    filled(tmp_path)
    (tmp_path / "study.json").write_text(text)

    def taken_up() -> None:
        with open_store(tmp_path, plan().text, "program"):
            pass

    assert answer(taken_up)


def test_changed_kept_result_is_computed_again(tmp_path: Path) -> None:
    path = tmp_path / "job.json"
    write_text(path, json.dumps({"law": "v_dpbc"}), sealed=True)
    assert read_kept(tmp_path, "job") == {"law": "v_dpbc"}
    for text in ('{"law": "v_dpbd"}', "[]", "[" * 100_000):
        path.write_text(text)
        assert not is_sealed(path)
        assert read_kept(tmp_path, "job") is None
    path.write_text('{"law": "v_dpbc"}')
    (tmp_path / "job.json.sha256").unlink()
    assert read_kept(tmp_path, "job") is None


@pytest.mark.parametrize("text", ["[" * 100_000, "[]", '{"planned_s": "5", "not_recorded": [], "failure": 3}'])
def test_invalid_entries_of_an_earlier_report_are_ignored(text: str, tmp_path: Path) -> None:
    (tmp_path / "report.json").write_text(text)
    assert known_of(tmp_path / "report.json") == {}
