# SPDX-License-Identifier: Apache-2.0
"""`make bench` compares models of the same arm and reports missed bounds."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from mmap import mmap
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

import bench.__main__ as command
from bench import bare, build, figures, identification_peers, memory, nodes, real_time, sweep
from bench.arm import arm7, forward_dynamics, random_motion, rigid_arm7
from bench.build import chain_urdf, joint_names
from bench.figures import Figure, in_turns, kept, page, placed, put, ratio, table
from bench.nodes import Seen, Tap
from fjr_core import TrackingLaw, robot_from_urdf
from fjr_core.monitoring.certificate import Certificate
from fjr_msgs_py import names
from fjr_msgs_py.scenarios import library
from time_limits import HANG


@pytest.mark.parametrize("n", [3, 8])
def test_certificate_has_a_constant_multiple_of_the_operations_of_the_law(n: int) -> None:
    robot = robot_from_urdf(chain_urdf(n), joint_names(n), stiffness=5000.0, motor_inertia=0.3)
    law = TrackingLaw(robot, build.GAINS)
    operations = law.measured_expression.n_instructions()
    assert Certificate(law).function.n_instructions() <= build.LARGEST_RATIO * operations


@pytest.mark.parametrize("seed", range(5))
def test_rigid_arm_agrees_with_pinocchio(seed: int) -> None:
    links, model = arm7().robot.links, rigid_arm7()
    q, dq, tau = random_motion(links.n, seed)
    expected = pin.aba(model, model.createData(), q, dq, tau)
    found = forward_dynamics(links)(q, dq, tau).full().ravel()
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-10 * np.max(np.abs(expected)))


def test_blocks_of_calls_alternate_and_neighbouring_ones_are_compared() -> None:
    order: list[str] = []
    times = in_turns({"a": lambda: order.append("a"), "b": lambda: order.append("b")}, repeats=3)
    changes = [name for name, before in zip(order[1:], order[:-1], strict=True) if name != before]
    assert changes[-5:] == ["b", "a", "b", "a", "b"]
    assert all(seconds.shape == (3,) for seconds in times.values())
    assert ratio(np.array([1.0, 10.0, 3.0]), np.array([2.0, 20.0, 1.0])) == 0.5


@pytest.mark.parametrize(("value", "verdict"), [(1.0, "yes"), (1.8, "yes, not the aim"), (2.1, "NO")])
def test_table_shows_whether_bound_and_aim_are_met(value: float, verdict: str) -> None:
    figure = Figure("law", value, "", bound=2.0, aim=1.5, parts={"law [us]": 2.5})
    assert figure.row()[4] == verdict
    assert "law [us] 2.5" in table([figure])
    assert Figure("loop", value, "x real time", bound=1.8, at_least=True).holds == (value >= 1.8)
    assert Figure("free", 1e9, "s").holds


@pytest.mark.parametrize(("value", "code"), [(1.0, 0), (3.0, 1)])
def test_missed_bound_is_reported_last_and_fails_the_command(
    value: float, code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    one, two = Figure("one", value, "", bound=2.0), Figure("two", 1.0, "s")
    benches = {"law": command.Bench(lambda: [one]), "step": command.Bench(lambda: [two])}
    monkeypatch.setattr(command, "BENCHES", benches)
    monkeypatch.setattr("sys.argv", ["bench", "--output", str(tmp_path / "deep" / "bench.json")])
    assert command.main() == code
    assert ("missed: one" in capsys.readouterr().out) == bool(code)
    document = json.loads((tmp_path / "deep" / "bench.json").read_text())
    assert [figure["value"] for figure in document["figures"]] == [value, 1.0]
    assert document["versions"]["mujoco"] == mujoco.__version__


def test_figures_of_one_day_are_written_together_and_others_dropped(tmp_path: Path) -> None:
    file = tmp_path / "bench.json"
    command.write([Figure("one", 1.0, "s"), Figure("two", 1.0, "s")], file)
    document = command.write([Figure("two", 2.0, "s", bound=3.0, parts={"part [ms]": 4.0})], file)
    assert [(each["name"], each["value"]) for each in document["figures"]] == [("one", 1.0), ("two", 2.0)]
    assert "| two | 2 s | <= 3 |  | yes | part [ms] 4 |" in page(document)
    document["date"] = "2026-01-01T00:00:00"
    file.write_text(json.dumps(document))
    assert [each["name"] for each in command.write([Figure("three", 1.0, "s")], file)["figures"]] == ["three"]


def test_sides_alternate_by_blocks_and_the_first_round_is_discarded() -> None:
    times = np.repeat(np.arange(3.0 * 2 * bare.BLOCKS), bare.BLOCK)
    found = bare.rounds(times, ["ours", "bare"], 3)
    assert [each[:: bare.BLOCK] for each in found["ours"]] == [[8.0, 10.0, 12.0, 14.0], [16.0, 18.0, 20.0, 22.0]]
    assert [each[:: bare.BLOCK] for each in found["bare"]] == [[9.0, 11.0, 13.0, 15.0], [17.0, 19.0, 21.0, 23.0]]


def test_driver_measures_a_bare_node_in_its_own_process() -> None:
    echo = nodes.bare("echo", "-r", f"__ns:=/{real_time.BARE}", priority=0)
    times = np.array(real_time.latencies(1, (real_time.BARE,), [echo])[real_time.BARE])
    assert times.shape == (1, bare.BLOCKS * bare.BLOCK)
    assert np.all(times > 0)


def test_bare_nodes_exchange_states_and_commands() -> None:
    with nodes.running(nodes.bare("ping", priority=0), nodes.bare("pong", priority=0)), Tap() as tap:
        first = tap.next(names.JOINT_STATES, HANG)
        assert tap.next(names.JOINT_STATES, HANG).stamp > first.stamp


def test_states_answered_in_time_and_samples_are_counted_by_their_stamps() -> None:
    """In time: by a command before the next state."""
    states = np.array([[1, 100], [2, 200], [3, 300], [4, 400]])
    commands = np.array([[1, 150], [2, 301], [4, 450]])
    assert real_time.in_time(states, commands).tolist() == [True, False, False]
    assert real_time.samples_per_second(Seen(5_000_000, 100), Seen(2_005_000_000, 500_000_100)) == pytest.approx(4000)


def test_memory_growth_is_the_slope_after_the_first_minute_of_a_process_that_runs() -> None:
    seconds = np.arange(0.0, 300.0)
    kilobytes = np.where(seconds < 60, 50_000 + 100 * seconds, 56_000 + 0.2 * seconds)
    found = memory.figure("plant", seconds, kilobytes)
    assert found.value == pytest.approx(12.0)
    assert found.holds
    before = memory.resident(os.getpid())
    with mmap(-1, 64 << 20) as held:  # pages of its own, as the heap may have free ones
        held[::4096] = bytes(len(held) // 4096)
        assert memory.resident(os.getpid()) - before == pytest.approx(len(held) / 1024, rel=0.2)
    with subprocess.Popen([sys.executable, "-S", "-c", ""]) as process:
        process.wait()
    with pytest.raises(RuntimeError, match="has ended"):
        memory.resident(process.pid)


def test_study_agrees_with_scipy_and_mujoco() -> None:
    loop, drawn = replace(sweep.loop(), duration=0.4, settle_after=0.1), sweep.draws(3)
    ours = loop.run(drawn).rms[:, 0]
    for peer, agrees in ((sweep.scipy_peer, 1e-8), (sweep.mujoco_peer, 1e-11)):
        theirs = [peer(loop, drawn, run) for run in range(3)]
        assert theirs == pytest.approx(ours.tolist(), rel=agrees)


def test_identification_and_mujoco_find_the_same_joint_in_the_same_record() -> None:
    case = identification_peers.case_of(library.load("paper_k31"), 0.9, seed=0)
    for found in (identification_peers.ours(case), identification_peers.theirs(case, pieces=3)):
        np.testing.assert_allclose(found.values[:2], list(case.truth.values())[:2], rtol=1e-2)
        assert np.all(found.low < found.high)


def test_results_are_computed_once_and_one_that_was_cut_off_again(tmp_path: Path) -> None:
    file, computed = tmp_path / "study" / "one.json", []

    def result() -> list[int]:
        computed.append(len(computed))
        if len(computed) == 1:
            raise KeyboardInterrupt
        return computed

    with pytest.raises(KeyboardInterrupt):
        kept(file, result)
    assert [kept(file, result) for _ in range(2)] == [[0, 1], [0, 1]]


def test_tables_stand_between_the_marks_of_their_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(figures, "TABLES", tmp_path)
    page = tmp_path / "page.md"
    page.write_text("".join(f"{name}\n\n<!-- {name}: by x -->\nold\n<!-- end of {name} -->\n" for name in "ab"))
    for _ in range(2):
        put("page.md", "b", ["new", "| row |"])
    assert (placed("page.md", "a"), placed("page.md", "b")) == ("old\n", "\nnew\n| row |\n\n")
    assert page.read_text().endswith("<!-- b: by x -->\n\nnew\n| row |\n\n<!-- end of b -->\n")
    with pytest.raises(ValueError, match="lacks '<!-- c: "):
        put("page.md", "c", [])
