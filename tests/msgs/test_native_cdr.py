# SPDX-License-Identifier: Apache-2.0
"""Messages read and written in place by C equal those of rclpy, whatever the bytes."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout

from fjr_core import Measurement
from fjr_msgs_py.messages.cdr import float_array, joint_state
from fjr_msgs_py.messages.joint_states import EffortWriter, JointStateWriter, MessageError, StateReader
from fjr_msgs_py.names import state_names
from fjr_msgs_py.native.loop import NativeMessage, NativeReader
from fjr_msgs_py.native.program import Program, common_headers, common_sources
from fuzzing import fuzzed

JOINTS = ("elbow", "wr")
NAMES = state_names(JOINTS)
POSITION, VELOCITY, EFFORT = 1, 2, 4
KINDS = ("", "not a message", "missing joints", "duplicate joints", "wrong lengths", "not finite")

names = st.sampled_from([NAMES, NAMES, NAMES, NAMES[::-1], [*NAMES, "more"], list(JOINTS), [], ["elbow"] * 4])
any_number = st.sampled_from([0.0, -0.0, 1.5, -2.25, 1e-310, 1e200, np.inf, -np.inf, np.nan])
numbers = st.one_of(st.just([0.5, -1.5, 2.0, 3e-5]), st.lists(any_number, max_size=5))
stamps = st.tuples(st.integers(1, 2**31 - 2), st.sampled_from([0, 1, 10**9 - 1, 10**9]))
frames = st.sampled_from(["", "base", "b\u00e4se"])
JOINT_STATES = st.builds(
    lambda names, position, velocity, effort, frame, stamp: stamped(
        JointState(name=names, position=position, velocity=velocity, effort=effort), frame, *stamp
    ),
    *(names, numbers, numbers, numbers, frames, stamps),
)


def stamped(message: JointState, frame: str, sec: int, nanosec: int) -> JointState:
    message.header.frame_id = frame
    message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
    return message


@cache
def program() -> Program:
    return Program("fjr_test_messages", common_headers(), common_sources())


def by_c(reader: NativeReader, data: bytes) -> object:
    """Return stamp and values, or the kind of the rejection."""
    found = program().lib.fjr_read_joint_state(reader.pointer, program().ffi.from_buffer(data), len(data))
    if found:
        return KINDS[found]
    return reader.pointer.stamp, *(value.tobytes() for value in reader.values if value is not None)


def by_python(reader: StateReader, data: bytes) -> object:
    try:
        sample = reader.read(deserialize_message(data, JointState))
    except rclpy_implementation.RMWError:
        return "not a message"
    except MessageError as error:
        return error.kind
    sides = (sample.q_l, sample.q_m, sample.dq_l, sample.dq_m)
    joined = [np.concatenate(pair).tobytes() for pair in (sides[:2], sides[2:]) if pair[0] is not None]
    return sample.stamp, *joined


@pytest.mark.parametrize(("velocity", "wanted"), [("measured", POSITION | VELOCITY), ("observer", POSITION)])
@fuzzed(200)
@given(st.lists(JOINT_STATES, min_size=1, max_size=6))
def test_states_equal_those_of_the_reader_in_python_for_any_previous_message(velocity, wanted, sent) -> None:
    native = NativeReader(program(), NAMES, wanted)
    reader = StateReader(JOINTS, Measurement(2, velocity=velocity))
    for message in sent:
        data = serialize_message(message)
        assert by_c(native, data) == by_python(reader, data)


@fuzzed(300)
@given(JOINT_STATES, st.data())
def test_damaged_bytes_are_read_as_rclpy_reads_them_or_rejected(message, data) -> None:
    native, reader = NativeReader(program(), NAMES, POSITION | VELOCITY), StateReader(JOINTS)
    by_c(native, serialize_message(message))
    damaged = bytearray(serialize_message(message))
    for _ in range(data.draw(st.integers(0, 3))):
        damaged[data.draw(st.integers(4, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    sent = bytes(damaged[: data.draw(st.integers(0, len(damaged)))])
    try:
        expected = by_python(reader, sent)
    except UnicodeDecodeError:  # of a name or frame that is not UTF-8
        return
    found = by_c(native, sent)
    if isinstance(found, str) and isinstance(expected, str):
        return
    if not isinstance(found, str) and found[0] <= 0:  # the host checks the stamp
        found = "no stamp"
    assert found == expected


@fuzzed(200)
@given(st.binary(max_size=200))
def test_any_bytes_are_read_within_their_length(data) -> None:
    native = NativeReader(program(), NAMES, POSITION | VELOCITY | EFFORT)
    by_c(native, b"\x00\x01\x00\x00" + data)
    program().lib.fjr_read_array(program().ffi.new("double[2]"), 2, program().ffi.from_buffer(data), len(data))


@given(st.lists(any_number, max_size=4), st.lists(st.sampled_from(["", "a", "label"]), max_size=3))
def test_arrays_equal_those_of_rclpy(values, labels) -> None:
    dimensions = [MultiArrayDimension(label=label, size=2, stride=1) for label in labels]
    data = serialize_message(Float64MultiArray(layout=MultiArrayLayout(dim=dimensions, data_offset=7), data=values))
    read = program().ffi.new("double[2]")
    found = program().lib.fjr_read_array(read, 2, program().ffi.from_buffer(data), len(data))
    kind = "wrong lengths" if len(values) != 2 else "" if np.isfinite(values).all() else "not finite"
    assert KINDS[found] == kind
    assert kind or np.array(list(read)).tobytes() == np.array(values).tobytes()


@given(stamps, st.tuples(any_number, any_number))
def test_messages_written_in_place_equal_those_of_the_writers(stamp, values) -> None:
    stamp, numbers = stamp[0] * 10**9 + stamp[1], np.array(values)
    named = NativeMessage(program(), joint_state(JOINTS, (2, 0, 2)), (2, 0, 2))
    array = NativeMessage(program(), float_array(",".join(JOINTS), 2), (2,))
    lib, view = program().lib, program().ffi.from_buffer("double[]", numbers)
    lib.fjr_put_stamp(named.pointer, stamp)
    lib.fjr_put_numbers(named.pointer, 0, view)
    lib.fjr_put_numbers(named.pointer, 2, view)
    lib.fjr_put_numbers(array.pointer, 0, view)
    assert named.serialised() == JointStateWriter(JOINTS).fill(stamp, position=numbers, effort=numbers)
    assert array.serialised() == EffortWriter(JOINTS).fill(numbers)
