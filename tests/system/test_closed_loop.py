# SPDX-License-Identifier: Apache-2.0
"""The installed scenarios over ROS 2: two processes in lock-step, evaluated from the bag by an independent reader.

Runs are bit-identical, also beside a recorder that stands still; two arms run apart.
"""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from fjr_core.config.scenario import load_scenario
from fjr_core.runtime.events import State
from fjr_plant.lock_step import START
from nodes.harness import Listener, Ros, nanoseconds
from nodes.plants import PERIOD
from system.executables import Start, scenario, wait_for
from system.shared_runs import DURATION, Recorded, is_complete, messages, recorded_run, shared_run
from tracking.tracked import Loop

pytestmark = pytest.mark.system

PEAK = {"paper_k31": 26.203, "paper_k3p1": 255.762}  # N m, by an independent integration
ARMS = ("two_link", "arm7")
REACHED = {**dict.fromkeys(PEAK, (2.0, 3e-5)), **dict.fromkeys(ARMS, (3.0, 1e-4))}
"""Time [s] from which on the error [rad] is at most so large."""
paper = pytest.mark.parametrize("recorded", PEAK, indirect=True)
arms = pytest.mark.parametrize("recorded", ARMS, indirect=True)


@pytest.fixture(scope="module", params=DURATION)
def recorded(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    folder = shared_run(tmp_path_factory, request.param)
    return recorded_run(folder, (folder.parent / "said").read_text())


def report_of(run: Recorded) -> dict:
    return json.loads((run.folder / "report.json").read_text())


def test_every_sample_is_in_the_bag_and_all_links_reach_the_reference(recorded: Recorded) -> None:
    since, error = REACHED[recorded.folder.name]
    assert recorded.t[-1] >= DURATION[recorded.folder.name]
    np.testing.assert_array_equal(np.round(np.diff(recorded.t) * 1e9), 1_000_000)
    assert recorded.error[0] >= 0.05 - 1e-9
    assert np.max(recorded.error[recorded.t >= since]) <= error


@paper
def test_peak_effort_is_that_of_the_paper_and_the_last_effort_zero(recorded: Recorded) -> None:
    assert np.max(np.abs(recorded.u)) == pytest.approx(PEAK[recorded.folder.name], rel=0.01)
    *_, (_, last) = messages(recorded.folder, "/effort_controller/commands")
    assert last.data.tolist() == [0.0]


@paper
def test_nodes_agree_with_fjr_core(recorded: Recorded) -> None:
    """Lock-step over ROS equals the sampled loop of fjr_core to rounding if no ramp or limit acts."""
    run = load_scenario(scenario(recorded.folder.name)).simulate(DURATION[recorded.folder.name])
    agree(recorded, run.x, run.u)


@arms
def test_nodes_agree_with_the_control_step_beside_a_plant(recorded: Recorded) -> None:
    made = load_scenario(scenario(recorded.folder.name))
    loop = Loop(made.law, made.reference, made.settings, made.x0)
    loop.run(1.5)  # through the start
    agree(recorded, np.array(loop.states), np.array(loop.efforts))


def agree(nodes: Recorded, x: np.ndarray, u: np.ndarray) -> None:
    k, n = u.shape
    assert np.max(np.abs(nodes.q_l[:k] - x[:, :n])) <= 1e-9
    assert np.max(np.abs(nodes.u[:k] - u)) <= 1e-9 * np.max(np.abs(u))


def test_the_report_has_the_errors_and_efforts_of_the_bag(recorded: Recorded) -> None:
    report, made = report_of(recorded), load_scenario(recorded.folder / "scenario.yaml")
    tracking, duration = report["tracking"], DURATION[recorded.folder.name]
    inside = recorded.t < duration - 1e-9
    error = np.max(recorded.error[inside & (recorded.t >= 2.0)])
    assert tracking["max_error_after_2s_rad"] == pytest.approx(error, rel=1e-6)
    peaks = dict(zip(made.joints, np.abs(recorded.u[inside]).max(axis=0), strict=True))
    assert tracking["peak_effort_by_joint_nm"] == pytest.approx(peaks)
    assert tracking["peak_effort_nm"] == pytest.approx(max(peaks.values()))
    limits = [None] * made.robot.n if made.robot.limits is None else made.robot.limits.effort.tolist()
    assert list(tracking["effort_limit_by_joint_nm"].values()) == limits
    share = tracking["largest_share_of_effort_limit"]
    assert share is None if made.robot.limits is None else 0.0 < share < 1.0
    counts = report["counts"]
    assert counts["nominal"] == counts["published"] == counts["answered"] == round(1000 * duration)
    assert counts["missing"] == counts["gaps"] == counts["unanswered"] == 0


@arms
def test_rate_of_a_run_is_proven_for_the_positions_that_it_visits(recorded: Recorded) -> None:
    storage = report_of(recorded)["storage"]
    assert storage["guarantee_is_proven"] is True
    assert "(proven:" in recorded.said
    sampled = load_scenario(recorded.folder / "scenario.yaml").law.rate(recorded.q_l[::10])
    assert 0.5 * sampled.beta < storage["guaranteed_decay_rate_per_s"] / 2 <= sampled.beta


FALLS = [(3.451, 0.263), (3.62, 0.24), (3.663, 0.208), (3.835, 0.233), (3.926, 0.263)]  # s


@pytest.mark.parametrize(
    ("at", "lost"), [FALLS[0], *(pytest.param(*each, marks=pytest.mark.full) for each in FALLS[1:])]
)
def test_a_fall_within_the_limits_does_not_end_in_a_stop(at: float, lost: float) -> None:
    """Up to 0.99 of a velocity limit, towards a position limit that no transition of join_time or longer respects."""
    made = load_scenario(scenario("arm7"))
    loop = Loop(made.law, made.reference, made.settings, made.x0)
    loop.run(at)
    largest = np.abs(loop.efforts[2000:]).max()
    loop.run(0.1, answered=False)
    loop.u = np.zeros(made.robot.n)  # the plant's command_timeout
    loop.run(lost - 0.1, answered=False)
    before = len(loop.efforts)
    loop.step()
    loop.run_through_transition(0.1)
    assert loop.tracker.state is State.TRACKING, loop.tracker.reason
    assert np.abs(loop.efforts[before:]).max() < 1.5 * largest


# Lock-step between processes.


SAMPLES = 2000
STAMPED = ("/joint_states", "/joint_commands", "/fjr_controller/reference", "/fjr_controller/tracking_error")
EFFORTS = "/effort_controller/commands"


def payloads(folder: Path) -> dict[str, dict[int, bytes]]:
    """Return the bytes of all numbers of each topic by stamp [ns]; of repeated messages the first, to exclude timing.

    An effort has no stamp; it gets that of the stamped command that was published with it. The recording may end
    between the two.
    """
    found: dict[str, list] = {topic: [] for topic in (*STAMPED, EFFORTS)}
    for topic, message in messages(folder, *found):
        found[topic].append(message)
    stamps = {topic: list(map(nanoseconds, found[topic])) for topic in STAMPED}
    bits = {topic: first(stamps[topic], map(numbers, found[topic])) for topic in STAMPED}
    return {**bits, EFFORTS: first(stamps["/joint_commands"], (message.data.tobytes() for message in found[EFFORTS]))}


def numbers(message: Any) -> bytes:
    names = "".join(message.name).encode()
    return names + b"".join(getattr(message, field).tobytes() for field in ("position", "velocity", "effort"))


def first(stamps: list[int], data: Iterable[bytes]) -> dict[int, bytes]:
    """Return the first message of each stamp, of the first samples only: the length of a run may vary."""
    return {stamp: bits for stamp, bits in reversed(list(zip(stamps, data, strict=False))) if stamp < END}


END = START + SAMPLES * PERIOD


def test_two_runs_of_two_processes_are_bit_identical_though_a_recorder_stands_still_for_a_while(
    start: Start, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    options = ("--lockstep", "--no-report", "--duration", "3", "--output", str(tmp_path))
    run = start("fjr", "run", "paper_k31", *options)
    wait_for(lambda: "running for" in run.said_so_far(), "the run")
    os.kill(run.recorder(), signal.SIGSTOP)
    time.sleep(0.2)  # the nodes compute some thousand samples
    os.kill(run.recorder(), signal.SIGCONT)
    code, said = run.end()
    assert code == 0, said
    assert is_complete(tmp_path / "paper_k31")
    one, other = map(payloads, (shared_run(tmp_path_factory, "paper_k31"), tmp_path / "paper_k31"))
    expected = {START + k * PERIOD for k in range(SAMPLES)}
    for topic in (*STAMPED, EFFORTS):
        assert set(one[topic]) == expected, topic
        assert one[topic] == other[topic], topic


SIDES = ("left", "right")
"""Two arms in one ROS domain, each with a separate clock."""


def test_two_arms_with_separate_clocks_run_in_parallel_and_are_distinguishable(ros: Ros, start: Start) -> None:
    observer, clocks = Listener(ros, only=("diagnostics",)), {arm: [] for arm in SIDES}
    paused = ("-p", "lockstep:=true", "-p", "start_paused:=true", "-p", "advance_samples:=1200")
    for arm, heard in clocks.items():
        observer.create_subscription(Clock, f"/{arm}/clock", heard.append, 5000)
        for node, timed in (("plant", paused), ("controller", ("-p", "use_sim_time:=true"))):
            start(node, "--ros-args", "-r", f"__ns:=/{arm}", *timed, "-r", f"/clock:=/{arm}/clock")
    advanced = [observer.request(Trigger, f"/{arm}/fjr_plant/advance") for arm in SIDES]
    names = ("fjr_plant", "fjr_controller", "fjr_controller: certificate")
    expected = {(f"{arm}/{name}", f"{arm}/single_link") for arm in SIDES for name in names}

    def parts() -> set[tuple[str, str]]:
        return {(each.name, each.hardware_id) for message in observer.diagnostics for each in message.status}

    ros.until(lambda: all(each.done() for each in advanced), "the samples of both arms")
    ros.until(lambda: len(parts()) >= len(expected), "the reports of both arms")
    assert parts() == expected
    for heard in clocks.values():
        times = [(message.clock.sec, message.clock.nanosec) for message in heard]
        assert len(set(times)) > 300
        assert times == sorted(times)
    assert observer.count_publishers("/clock") == 0
