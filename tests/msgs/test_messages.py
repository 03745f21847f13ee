# SPDX-License-Identifier: Apache-2.0
"""numpy <-> messages: what is written is read back, in any order; what cannot be read is named."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from fjr_msgs_py.messages import EffortReader, EffortWriter, JointSample, JointStateWriter, MessageError, StateReader
from fjr_msgs_py.names import motor_name, state_names

finite = st.floats(allow_nan=False, allow_infinity=False)
stamps = st.integers(min_value=1, max_value=2**31 * 10**9 - 1)
JOINTS = ("shoulder", "elbow", "wrist")


@given(stamps, st.lists(finite, min_size=6, max_size=6), st.lists(finite, min_size=6, max_size=6), st.randoms())
def test_a_state_survives_the_wire_in_any_order(
    stamp: int, position: list[float], velocity: list[float], random
) -> None:
    order = list(range(6))
    random.shuffle(order)
    names = [state_names(JOINTS)[i] for i in order]
    writer = JointStateWriter(names)
    sent = writer.fill(stamp, np.array(position)[order], np.array(velocity)[order], np.zeros(6))
    read = StateReader(JOINTS).read(deserialize_message(serialize_message(sent), JointState))
    assert read.stamp == stamp
    assert [*read.q_l, *read.q_m] == position
    assert [*read.dq_l, *read.dq_m] == velocity


@given(stamps, st.lists(finite, min_size=3, max_size=3))
def test_a_command_survives_the_wire_on_both_topics(stamp: int, effort: list[float]) -> None:
    reader = EffortReader(JOINTS)
    array = deserialize_message(serialize_message(EffortWriter(JOINTS).fill(np.array(effort))), Float64MultiArray)
    assert reader.read_array(array).tolist() == effort
    named = JointStateWriter(JOINTS).fill(stamp, effort=np.array(effort))
    read_stamp, read_effort = reader.read_named(deserialize_message(serialize_message(named), JointState))
    assert read_stamp == stamp
    assert read_effort.tolist() == effort


texts = st.sampled_from(["elbow", motor_name("elbow"), "other", ""])
numbers = st.lists(st.floats(), max_size=4)


@given(st.lists(texts, max_size=4), numbers, numbers, st.integers(0, 3))
def test_any_other_state_is_refused_in_one_sentence_or_read_as_finite(names, position, velocity, stamp) -> None:
    message = JointState(name=names, position=position, velocity=velocity)
    message.header.stamp.nanosec = stamp
    sample, error = attempt(message)
    if error is None:
        assert np.isfinite([sample.q_l, sample.q_m, sample.dq_l, sample.dq_m]).all()
    else:
        assert error.kind
        assert "expected" in str(error)
        assert "\n" not in str(error)


def attempt(message: JointState) -> tuple[JointSample | None, MessageError | None]:
    try:
        return StateReader(("elbow",)).read(message), None
    except MessageError as error:
        return None, error


def test_the_remembered_order_follows_the_names() -> None:
    reader = StateReader(("elbow",))
    for names, expected in (
        (["elbow", "elbow_motor"], 1.0),
        (["elbow_motor", "elbow"], 2.0),
        (["elbow", "elbow_motor"], 1.0),
    ):
        message = JointStateWriter(names).fill(1, np.array([1.0, 2.0]), np.zeros(2))
        assert reader.read(message).q_l == expected


@pytest.mark.parametrize(
    ("message", "kind", "words"),
    [
        (JointState(name=["elbow"]), "missing joints", r"expected \['elbow_motor'\] among them"),
        (JointState(name=["elbow", "elbow_motor", "elbow"]), "duplicate joints", r"expected \['elbow'\] only once"),
        (
            JointState(name=["elbow", "elbow_motor"], position=[0.0]),
            "wrong lengths",
            "position has 1 entries; expected 2",
        ),
    ],
)
def test_the_sentence_says_what_was_seen_and_expected(message: JointState, kind: str, words: str) -> None:
    with pytest.raises(MessageError, match=words) as caught:
        StateReader(("elbow",)).read(message)
    assert caught.value.kind == kind
