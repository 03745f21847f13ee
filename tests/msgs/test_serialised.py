# SPDX-License-Identifier: Apache-2.0
"""Readers of serialised messages equal rclpy and the message readers bit by bit."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout

from fjr_core import Measurement
from fjr_msgs_py.messages.cdr import FIELDS
from fjr_msgs_py.messages.cdr.readers import SerialisedStates
from fjr_msgs_py.messages.joint_states import EffortWriter, JointStateWriter, MessageError, StateReader
from fjr_msgs_py.names import state_names

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
    """Return a sample or a command as bytes, or the message of the rejection."""
    try:
        found = read(message)
    except MessageError as error:
        return str(error)
    return [part.tobytes() if isinstance(part, np.ndarray) else part for part in found]


@pytest.mark.parametrize("measurement", MEASUREMENTS)
@given(st.lists(messages, min_size=1, max_size=6))
def test_states_equal_those_of_rclpy_for_any_previous_message(measurement, sent) -> None:
    plain, serialised = StateReader(JOINTS, measurement), SerialisedStates(StateReader(JOINTS, measurement))
    for message in sent:
        data = serialize_message(message)
        for _ in range(2):
            assert outcome(serialised.read, data) == outcome(plain.read, deserialize_message(data, JointState))


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
def test_truncated_states_are_rejected_in_one_sentence(cut: int) -> None:
    reader, writer = SerialisedStates(StateReader(JOINTS)), JointStateWriter(NAMES)
    q = np.arange(4.0)
    whole = writer.fill(1, q, q, q).rstrip(b"\0")
    reader.read(writer.fill(1, q, q, q))
    with pytest.raises(MessageError, match="expected"):
        reader.read(whole[:cut])


@given(st.lists(st.text("ab_", min_size=1, max_size=9), min_size=1, max_size=7, unique=True), st.integers(0, 7))
def test_a_written_message_has_exactly_its_serialised_size(names: list[str], fields: int) -> None:
    """rosbags, which reads the bags, rejects trailing bytes."""
    filled = {name: np.arange(float(len(names))) for i, name in enumerate(FIELDS) if fields >> i & 1}
    store = get_typestore(Stores.ROS2_JAZZY)
    state = JointStateWriter(names).fill(3_000_000_004, **filled)
    read = store.deserialize_cdr(state, "sensor_msgs/msg/JointState")
    assert bytes(store.serialize_cdr(read, "sensor_msgs/msg/JointState")) == state
    assert {name: getattr(read, name).tolist() for name in filled} == {name: filled[name].tolist() for name in filled}
    effort = EffortWriter(tuple(names)).fill(np.arange(float(len(names))))
    array = store.deserialize_cdr(effort, "std_msgs/msg/Float64MultiArray")
    assert bytes(store.serialize_cdr(array, "std_msgs/msg/Float64MultiArray")) == effort
    assert array.data.tolist() == list(range(len(names)))
    dim = MultiArrayDimension(label=",".join(names), size=len(names), stride=len(names))
    wanted = Float64MultiArray(layout=MultiArrayLayout(dim=[dim]), data=array.data)
    assert deserialize_message(effort, Float64MultiArray) == wanted


def big_endian(stamp: int, numbers: list[float]) -> bytes:
    """Return a state of NAMES serialised in the other byte order."""
    pattern, values = ">4xiII4sI", [*divmod(stamp, 10**9), 1, b"", len(NAMES)]
    for name in NAMES:
        text = name.encode() + b"\0"
        pattern, values = f"{pattern}I{len(text) + -len(text) % 4}s", [*values, len(text), text]
    for _ in FIELDS:
        gap = -(struct.calcsize(pattern)) % 8  # offsets include the 4-byte header; a length of 4 follows
        pattern, values = f"{pattern}I{gap}x{len(numbers)}d", [*values, len(numbers), *numbers]
    data = struct.pack(pattern, *values)
    return b"\x00\x00" + data[2:]


def test_states_of_the_other_byte_order_are_read() -> None:
    reader = SerialisedStates(StateReader(JOINTS))
    for stamp, value in ((5, 0.0), (6_000_000_007, 1.25), (8, -0.5)):
        sample = reader.read(big_endian(stamp, [value] * 4))
        assert (sample.stamp, *sample.q_l, *sample.dq_m) == (stamp, value, value, value, value)
