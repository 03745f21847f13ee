# SPDX-License-Identifier: Apache-2.0
"""Lock-step between two processes: runs are bit-identical, also beside a recorder that stands still."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from fjr_plant.lock_step import START
from nodes.harness import nanoseconds
from nodes.plants import PERIOD
from system.executables import Start, wait_for
from system.recorded import is_complete, messages, record
from system.shared_runs import shared_run

pytestmark = pytest.mark.system

DURATION = 1.0  # s
SAMPLES = 1000
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


def test_two_runs_of_two_processes_are_bit_identical(tmp_path: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    folders = shared_run(tmp_path_factory, "paper_k31"), record("paper_k31", DURATION, tmp_path).folder
    one, other = map(payloads, folders)
    expected = {START + k * PERIOD for k in range(SAMPLES)}
    for topic in (*STAMPED, EFFORTS):
        assert set(one[topic]) == expected, topic
        assert one[topic] == other[topic], topic


def test_recorder_that_stands_still_for_a_while_loses_no_sample(start: Start, tmp_path: Path) -> None:
    output = tmp_path / "runs"
    options = ("--lockstep", "--no-report", "--duration", "3", "--output", str(output))
    run = start("fjr", "run", "paper_k31", *options)
    wait_for(lambda: "running for" in run.said_so_far(), "the run")
    os.kill(run.recorder(), signal.SIGSTOP)
    time.sleep(0.2)  # the nodes compute some thousand samples
    os.kill(run.recorder(), signal.SIGCONT)
    code, said = run.end()
    assert code == 0, said
    assert is_complete(output / "paper_k31")
