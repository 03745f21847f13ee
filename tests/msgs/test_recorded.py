# SPDX-License-Identifier: Apache-2.0
"""Messages of a recorded topic that are read at once equal those that rclpy deserialises one by one."""

from __future__ import annotations

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from fjr_msgs_py.messages.cdr import FIELDS, HEADER, joint_state, joint_state_arrays


def messages(
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


@pytest.mark.parametrize("lengths", [(3, 2, 0), (3, 3, 3), (0, 0, 3), (0, 0, 0), (1, 0, 2)])
@pytest.mark.parametrize("frame", ["", "world"])
def test_stamps_and_numbers_are_those_of_the_messages(lengths: tuple[int, ...], frame: str) -> None:
    sent = messages(lengths=lengths, frame=frame)
    arrays = joint_state_arrays([serialize_message(message) for message in sent], sent[0])
    assert arrays is not None
    stamps, values = arrays
    assert stamps.tolist() == [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in sent]
    for name, length in zip(FIELDS, lengths, strict=True):
        wanted = np.array([getattr(message, name) for message in sent]).reshape(len(sent), length)
        np.testing.assert_array_equal(values[name], wanted)


def test_padding_may_hold_anything() -> None:
    sent = messages(lengths=(3, 3, 3))
    whole = [serialize_message(message) for message in sent]
    form = joint_state(sent[0].name, (3, 3, 3))
    padding = np.ones(len(whole[0]), dtype=bool)
    for part in (*form.spans, *(slice(8 * start - HEADER, 8 * start + 24 - HEADER) for start in form.starts)):
        padding[part] = False
    assert padding.any()
    rows = np.array([list(message) for message in whole], dtype=np.uint8)
    rows[:, padding] = np.random.default_rng(2).integers(0, 256, (len(rows), padding.sum()))
    assert joint_state_arrays([row.tobytes() for row in rows], sent[0]) is not None


@pytest.mark.parametrize(
    "other",
    [messages(("a", "joint_3", "ä")), messages(lengths=(3, 3, 0)), messages(lengths=(2, 3, 0)), messages(frame="b")],
    ids=["names", "size", "lengths", "frame"],
)
def test_a_message_of_another_layout_is_not_read_as_the_first(other: list[JointState]) -> None:
    sent = messages()
    assert joint_state_arrays([serialize_message(message) for message in (*sent, other[0])], sent[0]) is None


def test_bytes_in_another_order_and_bytes_that_are_not_the_first_message_are_refused() -> None:
    sent = messages()
    data = [serialize_message(message) for message in sent]
    assert joint_state_arrays([b"\x00\x00" + one[2:] for one in data], sent[0]) is None
    assert joint_state_arrays(data, sent[1]) is None
    assert joint_state_arrays([data[0][:20]], sent[0]) is None
