# SPDX-License-Identifier: Apache-2.0
"""Serialised messages read and written in place, by C and by NumPy, equal those of rclpy, whatever the bytes."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import Stores, get_typestore
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout

from fjr_core import Measurement
from fjr_msgs_py.messages.cdr import FIELDS, HEADER, float_array, joint_state, joint_state_arrays
from fjr_msgs_py.messages.joint_states import CLOCK_LAYOUT, MessageError, StateReader
from fjr_msgs_py.names import state_names
from fjr_msgs_py.native.loop import NativeMessage, NativeReader
from fjr_msgs_py.native.program import Program
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
    return Program("fjr_test_messages", [], [])


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
@fuzzed(100)
@given(st.lists(JOINT_STATES, min_size=1, max_size=6))
def test_states_equal_those_of_the_reader_in_python_for_any_previous_message(velocity, wanted, sent) -> None:
    native = NativeReader(program(), NAMES, wanted)
    reader = StateReader(JOINTS, Measurement(2, velocity=velocity))
    for message in sent:
        data = serialize_message(message)
        assert by_c(native, data) == by_python(reader, data)


@fuzzed(150)
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


@fuzzed(100)
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


@fuzzed(40)
@given(st.lists(st.text("ab_", min_size=1, max_size=9), min_size=1, max_size=7, unique=True), stamps, st.integers(0, 7))
def test_messages_written_in_place_are_those_of_rclpy_and_have_no_byte_more(joints, stamp, fields) -> None:
    """rosbags, which reads the bags, rejects trailing bytes."""
    n, lib, store, time = len(joints), program().lib, get_typestore(Stores.ROS2_JAZZY), stamp[0] * 10**9 + stamp[1]
    values = np.resize([1.5, -0.0, np.inf, 1e-310], n)
    lengths = tuple(n if fields >> i & 1 else 0 for i in range(3))
    filled = {name: values.tolist() for name, length in zip(FIELDS, lengths, strict=True) if length}
    dim = MultiArrayDimension(label=",".join(joints), size=n, stride=n)
    array = Float64MultiArray(layout=MultiArrayLayout(dim=[dim]), data=values)
    state = stamped(JointState(name=joints, **filled), "", *divmod(time, 10**9))
    clock = Clock(clock=state.header.stamp)
    for form, counts, message in (
        (joint_state(joints, lengths), lengths, state),
        (float_array(dim.label, n), (n,), array),
        (CLOCK_LAYOUT, (), clock),
    ):
        native = NativeMessage(program(), form)
        if message is not array:
            lib.fjr_put_stamp(native.pointer, time)
        for k, length in enumerate(counts):
            if length:
                lib.fjr_put_numbers(native.pointer, k, program().ffi.from_buffer("double[]", values))
        data = native.serialised()
        assert deserialize_message(data, type(message)) == message
        kind = f"{type(message).__module__.split('.')[0]}/msg/{type(message).__name__}"
        assert bytes(store.serialize_cdr(store.deserialize_cdr(data, kind), kind)) == data


def recorded(
    names: tuple[str, ...] = ("a", "joint_2", "ä"), lengths: tuple[int, ...] = (3, 2, 0), frame: str = ""
) -> list:
    rng, made = np.random.default_rng(1), []
    for k in range(20):
        message = JointState(name=list(names))
        message.header.frame_id = frame
        message.header.stamp.sec, message.header.stamp.nanosec = int(rng.integers(-(2**31), 2**31)), 50_000_000 * k
        for field, length in zip(FIELDS, lengths, strict=True):
            setattr(message, field, np.where(rng.random(length) < 0.1, np.nan, rng.normal(size=length)).tolist())
        made.append(message)
    return made


@pytest.mark.parametrize(
    ("lengths", "frame"), [((3, 2, 0), ""), ((3, 3, 3), "world"), ((0, 0, 0), ""), ((1, 0, 2), "world")]
)
def test_stamps_and_numbers_are_those_of_the_recorded(lengths: tuple[int, ...], frame: str) -> None:
    sent = recorded(lengths=lengths, frame=frame)
    arrays = joint_state_arrays([serialize_message(message) for message in sent], sent[0])
    assert arrays is not None
    stamps, values = arrays
    assert stamps.tolist() == [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in sent]
    for name, length in zip(FIELDS, lengths, strict=True):
        wanted = np.array([getattr(message, name) for message in sent]).reshape(len(sent), length)
        np.testing.assert_array_equal(values[name], wanted)


def test_padding_may_hold_anything() -> None:
    sent = recorded(lengths=(3, 3, 3))
    whole = [serialize_message(message) for message in sent]
    form = joint_state(sent[0].name, (3, 3, 3))
    padding = np.ones(len(whole[0]), dtype=bool)
    for part in (*form.spans, *(slice(8 * start - HEADER, 8 * start + 24 - HEADER) for start in form.starts)):
        padding[part] = False
    assert padding.any()
    rows = np.array([list(message) for message in whole], dtype=np.uint8)
    rows[:, padding] = np.random.default_rng(2).integers(0, 256, (len(rows), padding.sum()))
    assert joint_state_arrays([row.tobytes() for row in rows], sent[0]) is not None


def test_only_bytes_of_the_layout_of_the_first_message_are_read() -> None:
    sent = recorded()
    data = [serialize_message(message) for message in sent]
    for other in ((("a", "joint_3", "ä"),), (("a", "joint_2", "ä"), (3, 3, 0)), (("a", "joint_2", "ä"), (2, 3, 0))):
        assert joint_state_arrays([*data, serialize_message(recorded(*other)[0])], sent[0]) is None
    assert joint_state_arrays([*data, serialize_message(recorded(frame="b")[0])], sent[0]) is None
    assert joint_state_arrays([b"\x00\x00" + one[2:] for one in data], sent[0]) is None, "another order of bytes"
    assert joint_state_arrays(data, sent[1]) is None, "another first message"
    assert joint_state_arrays([data[0][:20]], sent[0]) is None
