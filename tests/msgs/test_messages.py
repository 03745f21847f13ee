# SPDX-License-Identifier: Apache-2.0
"""NumPy <-> messages: written messages are read back in any order; invalid ones are reported."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from fjr_core import Measurement
from fjr_core.runtime.measurement_model import JointSample
from fjr_msgs_py.messages.cdr import Template
from fjr_msgs_py.messages.joint_states import (
    CLOCK_LAYOUT,
    EffortReader,
    EffortWriter,
    JointStateWriter,
    MessageError,
    StateReader,
    TorqueReader,
    time_of,
)
from fjr_msgs_py.names import motor_name, state_names

finite = st.floats(allow_nan=False, allow_infinity=False)
stamps = st.integers(min_value=1, max_value=2**31 * 10**9 - 1)
JOINTS = ("shoulder", "elbow", "wrist")


@given(stamps, st.lists(finite, min_size=6, max_size=6), st.lists(finite, min_size=6, max_size=6), st.randoms())
def test_a_state_is_read_back_in_any_order(stamp: int, position: list[float], velocity: list[float], random) -> None:
    order = list(range(6))
    random.shuffle(order)
    names = [state_names(JOINTS)[i] for i in order]
    writer = JointStateWriter(names)
    sent = writer.fill(stamp, np.array(position)[order], np.array(velocity)[order], np.zeros(6))
    read = StateReader(JOINTS).read(deserialize_message(sent, JointState))
    assert read.stamp == stamp
    assert [*read.q_l, *read.q_m] == position
    assert [*read.dq_l, *read.dq_m] == velocity


@given(stamps, st.lists(finite, min_size=3, max_size=3))
def test_a_command_is_read_back_from_both_topics(stamp: int, effort: list[float]) -> None:
    reader = EffortReader(JOINTS)
    array = deserialize_message(EffortWriter(JOINTS).fill(np.array(effort)), Float64MultiArray)
    assert reader.read_array(array).tolist() == effort
    named = JointStateWriter(JOINTS).fill(stamp, effort=np.array(effort))
    read_stamp, read_effort = reader.read_named(deserialize_message(named, JointState))
    assert read_stamp == stamp
    assert read_effort.tolist() == effort


texts = st.sampled_from(["elbow", motor_name("elbow"), "other", ""])
numbers = st.lists(st.floats(), max_size=4)


@given(st.lists(texts, max_size=4), numbers, numbers, st.integers(0, 3))
def test_an_arbitrary_state_is_rejected_or_read_as_finite(names, position, velocity, stamp) -> None:
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


def test_the_cached_order_follows_the_names() -> None:
    reader = StateReader(("elbow",))
    for names, expected in (
        (["elbow", "elbow_motor"], 1.0),
        (["elbow_motor", "elbow"], 2.0),
        (["elbow", "elbow_motor"], 1.0),
    ):
        message = JointStateWriter(names).fill(1, np.array([1.0, 2.0]), np.zeros(2))
        assert reader.read(deserialize_message(message, JointState)).q_l == expected


@pytest.mark.parametrize(
    ("message", "kind", "words"),
    [
        (JointState(), "missing joints", r"names are \[\]; expected \['elbow', 'elbow_motor'\] among them"),
        (JointState(name=["elbow"]), "missing joints", r"expected \['elbow_motor'\] among them"),
        (JointState(name=["elbow", "elbow_motor", "elbow"]), "duplicate joints", r"expected \['elbow'\] only once"),
        (
            JointState(name=["elbow", "elbow_motor"], position=[0.0]),
            "wrong lengths",
            "position has 1 entries; expected 2",
        ),
    ],
)
def test_the_error_names_the_value_and_the_expectation(message: JointState, kind: str, words: str) -> None:
    with pytest.raises(MessageError, match=words) as caught:
        StateReader(("elbow",)).read(message)
    assert caught.value.kind == kind


def state_of(names: list[str], stamp: int = 1, **fields: list[float]) -> JointState:
    message = JointState(name=names, **fields)
    message.header.stamp.nanosec = stamp
    return message


def test_a_state_without_velocities_is_rejected_unless_an_observer_is_used() -> None:
    message = state_of(state_names(JOINTS), position=[float(i) for i in range(6)])
    with pytest.raises(MessageError, match="velocity has 0 entries; expected 6.*measurement.velocity set to observer"):
        StateReader(JOINTS).read(message)
    sample = StateReader(JOINTS, Measurement(3, "observer")).read(message)
    assert [*sample.q_l, *sample.q_m] == [0, 1, 2, 3, 4, 5]
    assert sample.dq_l is sample.dq_m is None


def test_an_observer_ignores_the_velocities() -> None:
    names, position = ["elbow", "elbow_motor"], [1.0, 2.0]
    reader = StateReader(("elbow",), Measurement(1, "observer"))
    for velocity in ([float("nan")] * 2, [1.0], [1.0] * 5):
        sample = reader.read(state_of(names, position=position, velocity=velocity))
        assert (sample.q_l, sample.q_m, sample.dq_l, sample.dq_m) == (1.0, 2.0, None, None)


def test_motor_angles_and_velocities_are_as_in_the_message() -> None:
    message = state_of(
        [*reversed(state_names(("a", "b")))], position=[-3.0, 200.0, 2.0, 1.0], velocity=[30.0, 400.0, 6.0, 5.0]
    )
    sample = StateReader(("a", "b"), Measurement(2, gear_ratio=np.array([100.0, -50.0]))).read(message)
    assert (sample.q_l.tolist(), sample.q_m.tolist()) == ([1.0, 2.0], [200.0, -3.0])
    assert (sample.dq_l.tolist(), sample.dq_m.tolist()) == ([5.0, 6.0], [400.0, 30.0])


def test_joint_torques_are_read_in_place_of_motor_positions() -> None:
    message = state_of(["b", "other", "a"], position=[2.0, 9.0, 1.0], effort=[-2.0, 9.0, 3.0])
    sample = StateReader(("a", "b"), Measurement(2, "observer", "torque", K=np.eye(2))).read(message)
    assert sample.q_l.tolist() == [1.0, 2.0]
    assert sample.q_m.tolist() == [3.0, -2.0]
    assert sample.dq_m is None


@pytest.mark.parametrize(
    ("fields", "kind"),
    [
        ({"position": [1.0, 2.0]}, "wrong lengths"),
        ({"position": [1.0, 2.0], "effort": [float("nan"), 0.0]}, "not finite"),
    ],
)
def test_joint_torques_must_be_finite(fields: dict, kind: str) -> None:
    reader = StateReader(("elbow",), Measurement(1, "observer", "torque", K=np.array([[1e-3]])))
    with pytest.raises(MessageError) as caught:
        reader.read(state_of(["elbow", "elbow_motor"], **fields))
    assert caught.value.kind == kind
    assert "\n" not in str(caught.value)


def test_huge_finite_numbers_are_accepted() -> None:
    message = state_of(["elbow", "elbow_motor"], position=[1e308, -1e308], velocity=[1e308, 1e308])
    assert StateReader(("elbow",)).read(message).q_m == -1e308


def test_a_sample_is_unchanged_by_the_next_read() -> None:
    reader, names = StateReader(("elbow",)), ["elbow", "elbow_motor"]
    first = reader.read(state_of(names, position=[1.0, 1.0], velocity=[1.0, 1.0]))
    reader.read(state_of(names, position=[0.0, 0.0], velocity=[0.0, 0.0]))
    assert (first.q_l, first.q_m, first.dq_l, first.dq_m) == (1, 1, 1, 1)


def test_a_writer_clears_fields_that_are_not_given() -> None:
    writer = JointStateWriter(JOINTS)
    values = np.arange(3.0)
    sent = writer.fill(2_000_000_003, values, effort=values + 1)
    values[:] = 9
    for _ in range(2):
        wire = deserialize_message(writer.fill(5_000_000_006, velocity=np.arange(3.0) + 2), JointState)
        assert [wire.position.tolist(), wire.velocity.tolist(), wire.effort.tolist()] == [[], [2, 3, 4], []]
        assert (wire.header.stamp.sec, wire.header.stamp.nanosec) == (5, 6)
        wire = deserialize_message(writer.fill(1, np.arange(3.0)), JointState)
        assert [wire.position.tolist(), wire.velocity.tolist(), wire.effort.tolist()] == [[0, 1, 2], [], []]
    wire = deserialize_message(sent, JointState)
    assert [wire.position.tolist(), wire.velocity.tolist(), wire.effort.tolist()] == [[0, 1, 2], [], [1, 2, 3]]
    assert (wire.header.stamp.sec, wire.header.stamp.nanosec) == (2, 3)


TORQUED = ("a", "b", "c")
CASES = {
    "all": (["a", "b", "c"], [1.0, 2.0, 3.0], [1.0, 2.0, 3.0]),
    "another order": (["c", "a", "b"], [3.0, 1.0, 2.0], [1.0, 2.0, 3.0]),
    "some": (["b"], [2.0], [0.0, 2.0, 0.0]),
    "none": ([], [], [0.0, 0.0, 0.0]),
}


@pytest.mark.parametrize("case", CASES)
def test_a_joint_that_is_not_named_has_no_torque(case: str) -> None:
    names, effort, expected = CASES[case]
    torque = TorqueReader(TORQUED).read(JointState(name=names, effort=effort))
    assert torque.tolist() == expected


BAD = {
    "unknown joints": (["a", "d"], [1.0, 2.0], "expected some of"),
    "duplicate joints": (["a", "a"], [1.0, 2.0], "only once"),
    "wrong lengths": (["a"], [1.0, 2.0], "expected 1, one per name"),
    "not finite": (["a", "b"], [1.0, float("nan")], "finite"),
}


@pytest.mark.parametrize("kind", BAD)
def test_an_invalid_torque_is_rejected(kind: str) -> None:
    names, effort, words = BAD[kind]
    with pytest.raises(MessageError, match=words) as refused:
        TorqueReader(TORQUED).read(JointState(name=names, effort=effort))
    assert refused.value.kind == kind


def test_the_clock_message_holds_the_nanoseconds() -> None:
    message = Template(CLOCK_LAYOUT, ())
    message.stamp(12_345_678_901)
    assert time_of(deserialize_message(message.serialised(), Clock)) == 12_345_678_901
