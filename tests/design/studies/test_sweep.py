# SPDX-License-Identifier: Apache-2.0
"""Sweeps: draws, store, resumption, independence of the workers, sensitivities."""

from __future__ import annotations

import pickle
import subprocess
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from fjr_core import ParameterError
from fjr_core.errors import MissingPackageError
from fjr_design.batch import draws
from fjr_design.studies import sensitivity, study, sweep, sweep_run
from fjr_design.studies.study import StoreError, Workers, threads
from fjr_design.studies.sweep import Columns, Sweep
from fjr_design.studies.sweep_run import carry_out, jobs_of
from fjr_msgs_py.console.ending import Interrupted
from fuzzing import refused
from time_limits import HANG

SCENARIO = "/**: {ros__parameters: {}}"
"""The stiff joint of the paper."""
VARY: dict[str, Any] = {
    "stiffness": {"uniform": [0.5, 1.5]},
    "link_damping": {"log_uniform": [0.3, 3.0], "each_joint": True},
    "gravity": {"normal": [1.0, 0.05]},
    "delay": {"uniform": [0.0, 0.01]},
    "velocity_noise": 1e-3,
}


def with_values(values: str) -> str:
    return SCENARIO.replace("{}", f"{{{values}}}")


def sweep_of(runs: int = 45, vary: dict[str, Any] = VARY, **changes: Any) -> Sweep:
    drawn = {name: draws.read(name, given) for name, given in vary.items()}
    values = {"duration": 0.2, "settle_after": 0.1, "success": {"rms": 0.3}, **changes}
    return Sweep("test", SCENARIO, runs, drawn, **values)


def opened(folder: Path, plan: Sweep | None = None, program: str = "program") -> AbstractContextManager[study.Store]:
    return study.open_store(folder, (plan or sweep_of()).text, program)


def done(folder: Path, plan: Sweep, cores: int = 1) -> bytes:
    with opened(folder, plan) as kept, threads(cores) as workers:
        return carry_out(plan, kept, workers, threading.Event()).read_bytes()


class LogNormal:
    """exp of a truncated normal distribution of the logarithm."""

    logarithm = stats.truncnorm(-4, 4, np.log(2.0), 0.5)

    def cdf(self, value: Any) -> Any:
        return self.logarithm.cdf(np.log(value))

    def ppf(self, share: Any) -> Any:
        return np.exp(self.logarithm.ppf(share))

    def support(self) -> Any:
        return tuple(np.exp(self.logarithm.support()))


@pytest.mark.parametrize(
    ("given", "oracle"),
    [
        ({"uniform": [0.5, 1.5]}, stats.uniform(0.5, 1.0)),
        ({"log_uniform": [0.3, 3.0]}, stats.loguniform(0.3, 3.0)),
        ({"normal": [1.0, 0.1]}, stats.truncnorm(-4, 4, 1.0, 0.1)),
        ({"log_normal": [2.0, 0.5]}, LogNormal()),
    ],
)
def test_draws_have_the_requested_distribution(given: dict[str, Any], oracle: Any) -> None:
    one = draws.read("stiffness", given)
    values = one.drawn("stiffness", 7, 0, 20_000, 1)[:, 0]
    assert stats.kstest(values, oracle.cdf).pvalue > 1e-3
    assert one.range == pytest.approx(oracle.support())
    shares = np.linspace(0, 1, 11)
    assert one.at(shares) == pytest.approx(oracle.ppf(shares))
    assert one.share(one.at(shares)) == pytest.approx(shares, abs=1e-9)


def test_draws_are_independent_across_joints_names_and_seeds() -> None:
    one = draws.read("stiffness", {"uniform": [0.0, 1.0], "each_joint": True})
    drawn = one.drawn("stiffness", 1, 0, 5000, 7)
    others = [one.drawn("gravity", 1, 0, 5000, 7), one.drawn("stiffness", 2, 0, 5000, 7)]
    together = np.hstack([drawn, *others])
    assert np.corrcoef(together.T) == pytest.approx(np.eye(21), abs=0.06)


@pytest.mark.parametrize("n", [1, 3, 4, 7])
def test_the_draws_of_a_run_are_independent_of_other_runs(n: int) -> None:
    one = draws.read("stiffness", {"normal": [1.0, 0.1], "each_joint": True})
    whole = one.drawn("stiffness", 3, 0, 20, n)
    parts = [one.drawn("stiffness", 3, begin, 5, n) for begin in (0, 5, 10, 15)]
    assert np.array_equal(np.vstack(parts), whole)


def test_part_of_a_study_is_bit_identical_when_run_alone() -> None:
    plan = sweep_of()
    whole, middle = plan.part(0, 45), plan.part(13, 29)
    for name, column in middle.items():
        assert column.tobytes() == whole[name][13:29].tobytes(), name
    assert whole["success"].any()
    assert not whole["success"].all()
    assert set(whole) >= {"run", "stiffness", "link_damping.joint1", "rms.joint1", "lost_at", "power"}
    assert "velocity_noise" not in whole


def test_payload_position_does_not_depend_on_the_partition() -> None:
    plan = sweep_of(vary={"payload_mass": 0.1, "payload_position": {"uniform": [0.0, 0.1]}})
    drawn = plan.draws(0, 6).columns("payload_position", 1)
    assert np.array_equal(plan.draws(3, 6).columns("payload_position", 1), drawn[3:])
    assert len(set(drawn[:, 0])) == 6
    fixed = sweep_of(vary={"payload_mass": {"uniform": [0.1, 0.2]}, "payload_position": [0.1, 0.2, 0.3]})
    for runs in (1, 2, 3, 4):
        assert fixed.draws(0, runs).columns("payload_position", 1).tolist() == [[0.1, 0.2, 0.3]] * runs


def test_a_study_reaches_another_process_as_its_text_and_is_made_of_it_once() -> None:
    plan = sweep_of()
    again, *others = (pickle.loads(pickle.dumps(plan)) for _ in range(3))
    assert again is not plan
    assert (again, again.text) == (plan, plan.text)
    assert all(other is again for other in others)
    assert again.part(3, 5)["rms.joint1"].tobytes() == plan.part(3, 5)["rms.joint1"].tobytes()


def test_success_is_stable_and_within_every_limit() -> None:
    limits = {"rms": 0.2, "effort_peak": 26.4, "effort_noise": 1.0}
    columns = sweep_of(success=sweep.read({"scenario": "a", "vary": VARY, "success": limits})["success"]).part(0, 45)
    wanted = np.logical_and.reduce([columns["stable"], *(columns[f"{name}.joint1"] <= limits[name] for name in limits)])
    assert np.array_equal(columns["success"], wanted)
    assert 0 < wanted.sum() < columns["stable"].sum()


def test_table_is_byte_identical_for_any_number_of_cores_and_any_order(tmp_path: Path) -> None:
    plan = sweep_of()
    one = done(tmp_path / "one", plan)
    assert done(tmp_path / "more", plan, cores=4) == one
    with opened(tmp_path / "backwards", plan) as kept:
        for key, (_, begin, end) in reversed(jobs_of(plan).items()):
            kept.keep(key, plan.part(begin, end))
    assert done(tmp_path / "backwards", plan) == one


def test_finished_parts_are_not_run_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan, stop, asked = sweep_of(), threading.Event(), []

    def counted(plan: Sweep, begin: int, end: int) -> Columns:
        asked.append(begin)
        return part(plan, begin, end)

    part = Sweep.part
    monkeypatch.setattr(Sweep, "part", counted)
    with opened(tmp_path / "a", plan) as kept, threads(1) as workers:
        with pytest.raises(Interrupted) as ended:
            kept.run(workers, counted, jobs_of(plan), stop, lambda columns: stop.set())
        assert ended.value.kept == tmp_path / "a"
        there = sum(map(kept.holds, jobs_of(plan)))
        assert 0 < there < 5
    first = set(asked)
    asked.clear()
    table = done(tmp_path / "a", plan)
    assert len(asked) == 5 - there
    assert len(first | set(asked)) == 5
    assert table == done(tmp_path / "b", plan)
    asked.clear()
    assert done(tmp_path / "a", plan) == table  # complete: the table is only read
    assert asked == []


@pytest.mark.parametrize(
    ("changes", "program", "words"),
    [
        ({"runs": 50}, "program", "holds another study .runs is 45, not 50.*another --output"),
        ({"seed": 3}, "program", "seed is 0, not 3"),
        ({"vary": {**VARY, "gravity": 1.1}}, "program", "vary differs in gravity"),
        ({"success": {}}, "program", "success differs in rms"),
        ({}, "new", "another version of this program"),
    ],
)
def test_store_of_another_study_is_refused(tmp_path: Path, changes: Any, program: str, words: str) -> None:
    with opened(tmp_path), pytest.raises(StoreError, match="in use by another process"), opened(tmp_path):
        pass
    with pytest.raises(StoreError, match=words), opened(tmp_path, sweep_of(**changes), program):
        pass


@pytest.mark.parametrize("left", ["table.parquet", "parts/000000000-000000010.parquet"])
def test_results_without_their_study_file_or_with_a_damaged_one_are_refused(tmp_path: Path, left: str) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / left).write_bytes(b"of another sweep")
    with pytest.raises(StoreError, match="without their study.json"), opened(tmp_path):
        pass
    assert not (tmp_path / "study.json").exists()
    (tmp_path / "study.json").write_text("{")
    with pytest.raises(StoreError, match="cannot be read"), opened(tmp_path):
        pass


def test_missing_pyarrow_error_says_how_to_install_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    with (
        pytest.raises(MissingPackageError, match=r"pyarrow is not installed; .* -m pip install pyarrow$"),
        opened(tmp_path),
    ):
        pass
    assert list(tmp_path.iterdir()) == []


def test_commands_without_a_study_do_not_need_pyarrow() -> None:
    modules = "fjr_bringup.cli.run", "fjr_design.cli.check", "fjr_design.cli.gains", "fjr_identification.cli.identify"
    code = f"import sys, {', '.join(modules)}; sys.exit('pyarrow' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], timeout=HANG).returncode == 0


def test_number_of_pending_parts_is_bounded(tmp_path: Path) -> None:
    plan, most = sweep_of(runs=300), [0]

    class Watching:
        def submit(self, *arguments: Any) -> Any:
            future = inner.submit(*arguments)
            most[0] = max(most[0], inner._work_queue.qsize())
            return future

    with opened(tmp_path, plan) as kept, threads(1) as workers:
        inner: Any = workers.executor
        watched = Workers(Watching(), 1)  # type: ignore[arg-type]
        carry_out(plan, kept, watched, threading.Event())
    assert most[0] <= study.AHEAD


def test_a_worker_without_this_program_is_refused(tmp_path: Path) -> None:
    plan = sweep_of()

    class Elsewhere:
        def submit(self, *_: Any) -> Future[Any]:
            failed: Future[Any] = Future()
            failed.set_exception(ModuleNotFoundError("No module named 'fjr_core'"))
            return failed

    workers = Workers(Elsewhere(), 1, remote=True)  # type: ignore[arg-type]
    with (
        opened(tmp_path, plan) as kept,
        pytest.raises(study.WorkerError, match="No module named 'fjr_core'.*; expected this version of fjr_core"),
    ):
        carry_out(plan, kept, workers, threading.Event())


WIDE = draws.read("stiffness", {"uniform": [0.5, 1.5]})
MAKE: dict[str, Callable[[Any], object]] = {
    "file": sweep.read,
    "study": lambda changes: sweep_of(**changes),
    "scenario": lambda values: Sweep("test", with_values(values), 45, {"stiffness": WIDE}),
}
LEFT_OUT = "sets imperfections.actuator_lag; expected the default here: a sweep draws these itself, use 'vary'"
REFUSED: list[tuple[str, Any, str]] = [
    ("file", {"scenario": "a", "varry": {}}, "did you mean 'vary'?"),
    ("file", {"scenario": "a", "vary": {"stiffness": 1.0}}, "draws nothing"),
    ("file", {"scenario": "a", "vary": [1]}, "expected a mapping"),
    ("file", {"scenario": "a", "vary": {"stiffness": {"uniform": [1.5, 0.5]}}}, "goes from 1.5 to 0.5"),
    ("file", {"scenario": "a", "vary": {"stiffness": {"uniform": [1, 2, 3]}}}, "has 3 numbers; expected two"),
    ("file", {"scenario": "a", "vary": {"stiffness": {"gaussian": [1, 2]}}}, "expected {uniform"),
    ("file", {"scenario": "a", "vary": {"stiffness": {"log_uniform": [0, 2]}}}, "expected more than 0"),
    ("file", {"scenario": "a", "vary": {"stiffness": {"normal": [1, 0]}}}, "standard deviation 0"),
    ("file", {"scenario": "a", "vary": {"stiffness": {"uniform": "wide"}}}, "expected a list of finite numbers"),
    ("file", {"scenario": "a", "vary": {"stiffness": "wide"}}, "expected {uniform"),
    ("file", {"scenario": "a", "runs": 10.5, "vary": VARY}, "expected a whole number"),
    ("file", {"scenario": "a", "success": {"rms": "small"}, "vary": VARY}, "expected a number"),
    ("file", {"scenario": "a", "success": {"rms": np.nan}, "vary": VARY}, "'success': has nan as 'rms'; expected a"),
    ("file", {"scenario": "a", "success": {"error": 1.0}, "vary": VARY}, "'success': has 'error'; expected some of"),
    ("file", {"scenario": "a", "runs": 0, "vary": VARY}, "has 0 as 'runs'; expected 1 to 1e+09"),
    ("file", {"scenario": "a", "seed": -1, "vary": VARY}, "has -1 as 'seed'; expected 0 to 1.84467e+19"),
    ("file", {"scenario": "a", "runs": np.inf, "vary": VARY}, "has inf as 'runs'; expected a whole number"),
    ("file", {"scenario": "a", "duration": 10**400, "vary": VARY}, "as 'duration'; expected a number"),
    ("study", {"vary": {"stifness": {"uniform": [1, 2]}}}, "'vary' has 'stifness'"),
    ("study", {"vary": {"stiffness": {"normal": [1.0, 0.3]}}}, "the minimum of stiffness is -0.2"),
    ("study", {"vary": {"delay": {"uniform": [-1e-3, 1e-3]}}}, "the minimum of delay is -0.001"),
    ("study", {"vary": {"delay": {"uniform": [0, 1e-3], "each_joint": True}}}, "expected one value for all joints"),
    ("study", {"vary": {**VARY, "gravity": [1.0, 1.1]}}, "'vary': gravity has 2 numbers; expected a single one"),
    ("study", {"vary": {**VARY, "payload_position": [0.1, 0.2]}}, "payload_position has 2 numbers; expected 1 or 3"),
    ("scenario", "integrator: implicit_midpoint", "'integrator' is 'implicit_midpoint'; expected 'rk4'"),
    ("scenario", "imperfections.actuator_lag: [0.01]", LEFT_OUT),
]


@pytest.mark.parametrize(("what", "given", "words"), REFUSED)
def test_an_invalid_file_study_or_scenario_is_refused_in_one_sentence(what: str, given: Any, words: str) -> None:
    refused(ParameterError, lambda: MAKE[what](given), words)


def test_limits_observer_and_ramp_of_the_scenario_act_in_a_study() -> None:
    own = "limits: {effort: [20.0], link_velocity: [3.0]}, measurement: {velocity: observer}, start: {ramp_time: 0.05}"
    drawn = {"gravity": draws.read("gravity", {"uniform": [0.9, 1.1]})}
    plain, limited = (
        Sweep("test", given, 4, drawn, duration=0.2, settle_after=0.1).part(0, 4)
        for given in (SCENARIO, with_values(own))
    )
    assert limited["effort_peak.joint1"].max() <= 20.0 < plain["effort_peak.joint1"].min()
    assert list(limited["cause"]) == ["link velocity"] * 4
    assert (limited["stopped"] < 0.1).all()
    assert limited["stable"].all()
    assert not limited["success"].any()
    assert plain["success"].all()
    assert np.isinf(plain["stopped"]).all()


def test_a_study_can_vary_the_effort_limit_beyond_that_of_the_scenario() -> None:
    limited = with_values("limits: {effort: [20.0]}")
    drawn = {"effort_limit": draws.read("effort_limit", {"uniform": [22.0, 24.0]})}
    found = Sweep("test", limited, 4, drawn, duration=0.2, settle_after=0.1).part(0, 4)
    assert np.array_equal(found["effort_peak.joint1"], found["effort_limit"])


def test_friction_too_steep_for_the_steps_is_refused() -> None:
    steep = {**VARY, "coulomb_m": {"uniform": [0.0, 1.0]}, "smoothing": 0.01}
    sweep_of(vary={**steep, "smoothing": 0.2}).refuse_stiff_friction()
    sweep_of().refuse_stiff_friction()
    with pytest.raises(ParameterError, match="friction may damp at 2.5e.04 1/s, too fast for steps of 0.25 ms"):
        sweep_of(vary=steep).refuse_stiff_friction()


def test_sensitivity_index_identifies_the_deciding_parameter() -> None:
    """The index is 1 for the only influence, 0 for no influence, and 1/2 for each of two equal influences."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform(size=(2, 40_000))
    place = (sensitivity.BINS * x).astype(int)
    assert sensitivity.index(place, x > 0.5) == pytest.approx(1.0, abs=1e-9)
    assert sensitivity.index(place, y) == pytest.approx(0.0, abs=2e-3)
    assert sensitivity.index(place, x + y) == pytest.approx(0.5, abs=0.01)


def test_confidence_interval_is_that_of_wilson() -> None:
    for count, of in ((0, 20), (7, 20), (20, 20), (680, 1000)):
        wanted = stats.binomtest(count, of).proportion_ci(method="wilson")
        assert sensitivity.interval(count, of) == (pytest.approx(wanted.low), pytest.approx(wanted.high))


@pytest.fixture
def table() -> tuple[Sweep, Columns]:
    plan = sweep_of(runs=200)
    return plan, plan.part(0, 200)


def test_summary_agrees_with_the_table(table: tuple[Sweep, Columns]) -> None:
    plan, columns = table
    found = sensitivity.summarised(plan, columns.__getitem__)
    assert (found.runs, found.succeeded, found.stable) == (200, columns["success"].sum(), columns["stable"].sum())
    rms = columns["rms.joint1"][columns["stable"]]
    assert found.quantiles["rms"][-1] == rms.max()
    assert np.mean(rms <= found.quantiles["rms"][0]) == pytest.approx(0.5, abs=0.01)
    assert found.effects[0].name == "delay"
    assert not columns["success"][found.failed]
    assert columns["rms.joint1"][found.worst] == columns["rms.joint1"][columns["success"]].max()


def test_the_name_of_a_page_is_escaped(table: tuple[Sweep, Columns], tmp_path: Path) -> None:
    plan, columns = table
    named = replace(plan, name="<b onload=x>")
    found = sensitivity.summarised(named, columns.__getitem__)
    sweep_run.write_page(named, found, sweep_run.sweep_plots(named, columns.__getitem__, found), tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert "<b onload" not in page
    assert page.count("&lt;b onload=x&gt;") > 1


def test_a_study_cannot_vary_what_only_the_built_in_plant_has() -> None:
    plan = Sweep("s", with_values('plant: {type: "own_code:Ideal"}'), 1, {"stiffness": draws.read("stiffness", 1.1)})
    with pytest.raises(ParameterError, match="stiffness of a run is not nominal; expected the nominal value for a"):
        plan.part(0, 1)
