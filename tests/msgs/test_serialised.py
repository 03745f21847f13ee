# SPDX-License-Identifier: Apache-2.0
"""What is read from serialised messages is what rclpy and the readers of messages make of them, bit by bit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from fjr_core import Measurement
from fjr_msgs_py.messages import EffortReader, JointStateWriter, MessageError, StateReader
from fjr_msgs_py.names import state_names
from fjr_msgs_py.serialised import SerialisedEfforts, SerialisedStates

JOINTS = ("elbow", "wr")
NAMES = state_names(JOINTS)
MEASUREMENTS = (
    None,
    Measurement(2, velocity="observer"),
    Measurement(2, gear_ratio=[2.0, 3.0]),
)

names = st.sampled_from([NAMES, NAMES, NAMES, NAMES[::-1], [*NAMES, "more"], list(JOINTS), [], ["elbow"] * 4])
any_number = st.sampled_from([0.0, -0.0, 1.5, -2.25, 1e-310, 1e200, np.inf, -np.inf, np.nan])
numbers = st.one_of(st.just([0.5, -1.5, 2.0, 3e-5]), st.lists(any_number, max_size=5))
messages = st.builds(
    lambda names, position, velocity, effort, frame, sec, nanosec: stamped(
        JointState(name=names, position=position, velocity=velocity, effort=effort), frame, sec, nanosec
    ),
    *(names, numbers, numbers, numbers, st.sampled_from(["", "base", "b\u00e4se"])),
    *(st.one_of(st.integers(-1, 2**31 - 1), st.just(2**31 - 1)), st.sampled_from([0, 1, 10**9 - 1, 10**9, 2**32 - 1])),
)


def stamped(message: JointState, frame: str, sec: int, nanosec: int) -> JointState:
    message.header.frame_id = frame
    message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
    return message


def outcome(read, message) -> object:
    """A sample or an answer as bytes, or the sentence of the refusal."""
    try:
        found = read(message)
    except MessageError as error:
        return str(error)
    return [part.tobytes() if isinstance(part, np.ndarray) else part for part in found]


@pytest.mark.parametrize("measurement", MEASUREMENTS)
@given(st.lists(messages, min_size=1, max_size=6))
def test_states_are_those_that_rclpy_reads_whatever_came_before(measurement, sent) -> None:
    plain, serialised = StateReader(JOINTS, measurement), SerialisedStates(StateReader(JOINTS, measurement))
    for message in sent:
        data = serialize_message(message)
        for _ in range(2):
            assert outcome(serialised.read, data) == outcome(plain.read, deserialize_message(data, JointState))


@given(st.lists(messages, min_size=1, max_size=6))
def test_commands_are_those_that_rclpy_reads_whatever_came_before(sent) -> None:
    plain, serialised = EffortReader(NAMES), SerialisedEfforts(EffortReader(NAMES))
    for message in sent:
        data = serialize_message(message)
        for _ in range(2):
            assert outcome(serialised.read, data) == outcome(plain.read_named, deserialize_message(data, JointState))


@given(st.lists(st.tuples(st.floats(-9, 9), st.integers(1, 2**31 * 10**9 - 1)), min_size=3, max_size=9))
def test_a_stream_of_states_is_deserialised_once(sent) -> None:
    asked = []

    class Counted(StateReader):
        def read(self, message):
            asked.append(message)
            return super().read(message)

    reader, writer = SerialisedStates(Counted(JOINTS)), JointStateWriter(NAMES)
    for value, stamp in sent:
        q = np.full(4, value)
        sample = reader.read(writer.fill(stamp, q, q + 1, q))
        assert (sample.stamp, *sample.q_l, *sample.dq_m) == (stamp, value, value, value + 1, value + 1)
    assert len(asked) == 1


@pytest.mark.parametrize("cut", [0, 3, 4, 11, 40, -1, -9])
def test_bytes_that_are_no_state_are_refused_in_one_sentence(cut: int) -> None:
    reader, writer = SerialisedStates(StateReader(JOINTS)), JointStateWriter(NAMES)
    q = np.arange(4.0)
    whole = writer.fill(1, q, q, q).rstrip(b"\0")
    reader.read(writer.fill(1, q, q, q))
    with pytest.raises(MessageError, match="expected"):
        reader.read(whole[:cut])


def test_an_effort_keeps_its_numbers_when_the_next_is_read() -> None:
    reader, writer = SerialisedEfforts(EffortReader(JOINTS)), JointStateWriter(JOINTS)
    for value in (1.0, 2.0):
        first = reader.read(writer.fill(1, effort=np.full(2, value)))[1]
        reader.read(writer.fill(2, effort=np.zeros(2)))
        assert first.tolist() == [value, value]
