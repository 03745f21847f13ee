# SPDX-License-Identifier: Apache-2.0
"""Every host of the control step sends the same efforts for the same inputs, bit by bit, under every kind of fault."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import yaml
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from faults import fault_rows
from faults.fault_rows import JOINT, NONSENSE
from faults.peers import Tamper
from hosts import recording
from hosts.comparison import HOSTS, Comparison
from hosts.efforts import reference_replay
from hosts.inputs import Input, Kind, Sequence, with_ticks

pytestmark = pytest.mark.system
FAULTS: dict[range, Tamper] = {
    range(100, 130): fault_rows.not_a_number(),
    range(150, 160): fault_rows.renamed(),
    range(180, 200): fault_rows.twice(),
    range(220, 240): fault_rows.aged(15),
    range(260, 280): fault_rows.frozen(),
    range(300, 450): fault_rows.dropped(),
    range(460, 500): fault_rows.stuck(),
    range(550, 600): fault_rows.jumped(10),
    range(645, 646): fault_rows.turned(),
}
"""Faults of the states by the samples at which they act."""
LIMITED = {"controller": {"limits.effort": [1.5], "limits.link_velocity": [20.0]}}
SAMPLES, RESTARTED, ASKED = 700, 650, 140
HAPPENED = {"states older than the last", "jumps doubted", "reference restarts", "silences", "forward jumps",
            "recoveries", "efforts saturated", "states frozen", "stops: position jump"}  # fmt: skip


@pytest.fixture(scope="module")
def comparison() -> Iterator[Comparison]:
    with Comparison() as made:
        yield made


def faulty() -> Sequence:
    """Return states of a joint with all faults, a refused request and a restart of the controller, in real time."""
    sequence, _ = recording.of_study("faults", yaml.safe_dump(JOINT.document(LIMITED)), SAMPLES)
    inputs: list[Input] = []
    for k, each in enumerate(sequence.inputs):
        tamper = next((how for when, how in FAULTS.items() if k in when), lambda message: [message])
        for message in tamper(deserialize_message(each.raw, JointState)):
            inputs.append(Input(Kind.STATE, each.time, serialize_message(message)))
        if k == ASKED:
            inputs.append(Input(Kind.PARAMETERS, each.time, parameters=NONSENSE))
        if k == RESTARTED:
            inputs.append(Input(Kind.RESTART, each.time))
    return Sequence("faults", sequence.document, False, with_ticks(inputs, recording.TICK))


def test_every_host_sends_the_same_bits_for_faulty_states(comparison: Comparison) -> None:
    sequence = faulty()
    end = recording.START + RESTARTED * recording.SECOND // 1000
    before = Sequence("", sequence.document, False, tuple(x for x in sequence.inputs if x.time < end))
    counters = reference_replay(before).counters
    assert {name for name in HAPPENED if counters[name]} == HAPPENED
    compared = comparison.compared(sequence)
    assert compared.different == dict.fromkeys(HOSTS, 0)
    assert len(set(compared.sent.values())) == 2  # in ros2_control a repeated stamp is no sample


def test_nodes_over_the_middleware_and_exported_c_send_the_same_bits_after_requests(comparison: Comparison) -> None:
    sequence = recording.of_requests()
    counters = reference_replay(sequence).counters
    once = ("stops: tracking error", "resumes", "gains changed", "settings changed", "holds")
    assert [counters[name] for name in once] == [1] * len(once)
    assert counters["efforts saturated"]
    compared = comparison.compared(sequence)
    assert compared.equal
    assert min(compared.sent.values()) == max(compared.sent.values()) >= sequence.states


def test_every_host_finds_wrong_wiring_with_the_same_sample(comparison: Comparison) -> None:
    """Some hosts compare after the effort was sent, the others before the next one is computed."""
    sequence = recording.of_wrong_wiring(LIMITED)  # with the programs of the first test
    replay = reference_replay(sequence)
    stopped = np.flatnonzero(replay.efforts.any(axis=1))[-1]
    assert replay.counters["stops: wiring"] == 1
    assert 8 < stopped <= 20
    assert comparison.compared(sequence).different == dict.fromkeys(HOSTS, 0)
