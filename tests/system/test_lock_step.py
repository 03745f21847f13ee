# SPDX-License-Identifier: Apache-2.0
"""Lock-step between processes: runs are bit-identical, also beside a recorder that stands still; two arms run apart."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest
from rosgraph_msgs.msg import Clock

from fjr_plant.lock_step import START
from nodes.harness import Listener, Ros, nanoseconds
from nodes.plants import PERIOD
from system.executables import Start, wait_for
from system.shared_runs import is_complete, messages, shared_run

pytestmark = pytest.mark.system

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


ARMS = ("left", "right")
"""Two arms in one ROS domain, each with a separate clock."""


def test_two_arms_with_separate_clocks_run_in_parallel_and_are_distinguishable(ros: Ros, start: Start) -> None:
    observer, clocks = Listener(ros, only=("diagnostics",)), {arm: [] for arm in ARMS}
    for arm in ARMS:
        for node, timed in (("plant", "lockstep:=true"), ("controller", "use_sim_time:=true")):
            start(node, "--ros-args", "-r", f"__ns:=/{arm}", "-p", timed, "-r", f"/clock:=/{arm}/clock")
    names = ("fjr_plant", "fjr_controller", "fjr_controller: certificate")
    expected = {(f"{arm}/{name}", f"{arm}/single_link") for arm in ARMS for name in names}

    def parts() -> set[tuple[str, str]]:
        return {(each.name, each.hardware_id) for message in observer.diagnostics for each in message.status}

    ros.until(lambda: len(parts()) >= len(expected), "the reports of both arms")
    assert parts() == expected
    for arm, heard in clocks.items():  # last, as thousands of messages a second keep the others waiting
        observer.create_subscription(Clock, f"/{arm}/clock", heard.append, 5000)

    def times(arm: str) -> list[tuple[int, int]]:
        return [(message.clock.sec, message.clock.nanosec) for message in clocks[arm]]

    ros.until(lambda: all(len(set(times(arm))) > 300 for arm in ARMS), "both clocks")
    assert all(times(arm) == sorted(times(arm)) for arm in ARMS)
    assert observer.count_publishers("/clock") == 0
