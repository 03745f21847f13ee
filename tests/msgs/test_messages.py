# SPDX-License-Identifier: Apache-2.0
"""Messages to NumPy and to plain values: joints in any order; what is invalid is refused in one sentence."""

from __future__ import annotations

import re
from functools import partial

import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from hypothesis import given
from hypothesis import strategies as st
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, UInt8MultiArray

from fjr_core import Measurement
from fjr_core.errors import ParameterError
from fjr_msgs_py.messages.joint_states import MessageError, StateReader, picked, read_efforts, read_torques
from fjr_msgs_py.messages.plain import fill, plain
from fjr_msgs_py.names import state_names

NAN = float("nan")
JOINTS, ELBOW = ("shoulder", "elbow", "wrist"), ["elbow", "elbow_motor"]
STATE, OBSERVED = StateReader(("elbow",)), StateReader(("elbow",), Measurement(1, "observer"))
TORQUE = StateReader(("elbow",), Measurement(1, "observer", "torque", K=np.array([[1e-3]])))


def state_of(names: list[str], stamp: int = 1, **fields: list[float]) -> JointState:
    message = JointState(name=names, **fields)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
    return message


six = st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=6, max_size=6)


@given(st.integers(1, 2**31 * 10**9 - 1), six, six, st.permutations(range(6)))
def test_a_state_is_read_in_any_order_of_its_joints(stamp, position, velocity, order) -> None:
    names, *fields = ([values[i] for i in order] for values in (state_names(JOINTS), position, velocity))
    sample = StateReader(JOINTS).read(state_of(names, stamp, position=fields[0], velocity=fields[1]))
    assert sample.stamp == stamp
    assert [*sample.q_l, *sample.q_m] == position
    assert [*sample.dq_l, *sample.dq_m] == velocity


def test_an_observer_needs_no_velocities_and_ignores_them() -> None:
    for velocity in ([], [NAN] * 2, [1.0], [1.0] * 5):
        sample = OBSERVED.read(state_of(ELBOW, position=[1.0, 2.0], velocity=velocity))
        assert (sample.q_l, sample.q_m, sample.dq_l, sample.dq_m) == (1.0, 2.0, None, None)


def test_motor_angles_and_velocities_are_as_in_the_message() -> None:
    fields = {"position": [-3.0, 200.0, 2.0, 1.0], "velocity": [30.0, 400.0, 6.0, 5.0]}
    reader = StateReader(("a", "b"), Measurement(2, gear_ratio=np.array([100.0, -50.0])))
    sample = reader.read(state_of([*reversed(state_names(("a", "b")))], **fields))
    assert (sample.q_l.tolist(), sample.q_m.tolist()) == ([1.0, 2.0], [200.0, -3.0])
    assert (sample.dq_l.tolist(), sample.dq_m.tolist()) == ([5.0, 6.0], [400.0, 30.0])


def test_joint_torques_are_read_in_place_of_motor_positions() -> None:
    message = state_of(["b", "other", "a"], position=[2.0, 9.0, 1.0], effort=[-2.0, 9.0, 3.0])
    sample = StateReader(("a", "b"), Measurement(2, "observer", "torque", K=np.eye(2))).read(message)
    assert (sample.q_l.tolist(), sample.q_m.tolist(), sample.dq_m) == ([1.0, 2.0], [3.0, -2.0], None)


def test_a_sample_is_unchanged_by_the_next_read() -> None:
    first = STATE.read(state_of(ELBOW, position=[1.0, 1.0], velocity=[1.0, 1.0]))
    STATE.read(state_of(ELBOW, position=[0.0, 0.0], velocity=[0.0, 0.0]))
    assert (first.q_l, first.q_m, first.dq_l, first.dq_m) == (1, 1, 1, 1)


@pytest.mark.parametrize(
    ("names", "effort", "expected"),
    [
        (["a", "b", "c"], [1.0, 2.0, 3.0], [1.0, 2.0, 3.0]),
        (["c", "a", "b"], [3.0, 1.0, 2.0], [1.0, 2.0, 3.0]),
        (["b"], [2.0], [0.0, 2.0, 0.0]),
        ([], [], [0.0, 0.0, 0.0]),
    ],
)
def test_a_joint_that_is_not_named_has_no_torque(names: list[str], effort: list[float], expected) -> None:
    assert read_torques(JointState(name=names, effort=effort), ("a", "b", "c")).tolist() == expected


def test_commands_are_read_from_both_topics() -> None:
    assert read_efforts(Float64MultiArray(data=[3.0, -1.0]), ("a", "b")).tolist() == [3.0, -1.0]
    named = JointState(name=["b", "other", "a"], effort=[-1.0, NAN, 3.0])
    assert picked(named, "effort", ("a", "b")).tolist() == [3.0, -1.0]


efforts, torques = partial(read_efforts, joints=("a", "b")), partial(read_torques, joints=("a", "b", "c"))
REFUSED = [
    (STATE.read, JointState(), "missing joints", "names are []; expected ['elbow', 'elbow_motor'] among them"),
    (STATE.read, JointState(name=["elbow"]), "missing joints", "expected ['elbow_motor'] among them"),
    (STATE.read, JointState(name=[*ELBOW, "elbow"]), "duplicate joints", "expected ['elbow'] only once"),
    (STATE.read, JointState(name=ELBOW, position=[0.0]), "wrong lengths", "position has length 1; expected 2"),
    (
        *(STATE.read, JointState(name=ELBOW, position=[0.0, 0.0]), "wrong lengths"),
        "velocity has length 0; expected 2, one per name, or the parameter measurement.velocity set to observer",
    ),
    (OBSERVED.read, JointState(name=ELBOW, position=[0.0, 0.0]), "no stamp", "header.stamp is 0 ns"),
    (STATE.read, JointState(name=ELBOW, position=[0.0, NAN]), "not finite", "position holds elbow_motor = nan"),
    (
        *(STATE.read, JointState(name=ELBOW, position=[0.0, 0.0], velocity=[NAN, NAN]), "not finite"),
        "expected finite numbers, or the parameter measurement.velocity set to observer",
    ),
    (TORQUE.read, JointState(name=ELBOW, position=[1.0, 2.0]), "wrong lengths", "effort has length 0; expected 2"),
    (TORQUE.read, JointState(name=["elbow"], position=[1.0], effort=[NAN]), "not finite", "effort holds elbow = nan"),
    (efforts, Float64MultiArray(data=[1.0]), "wrong lengths", "data has length 1; expected 2, one per joint"),
    (efforts, Float64MultiArray(data=[1.0, NAN]), "not finite", "data holds b = nan; expected finite numbers"),
    (torques, JointState(name=["a", "d"], effort=[1.0, 2.0]), "unknown joints", "expected some of ['a', 'b', 'c']"),
    (torques, JointState(name=["a", "a"], effort=[1.0, 2.0]), "duplicate joints", "expected ['a'] only once"),
    (torques, JointState(name=["a"], effort=[1.0, 2.0]), "wrong lengths", "effort has length 2; expected 1"),
    (torques, JointState(name=["a", "b"], effort=[1.0, NAN]), "not finite", "effort holds b = nan"),
]


@pytest.mark.parametrize(("read", "message", "kind", "words"), REFUSED)
def test_a_refusal_names_what_was_seen_and_expected(read, message, kind: str, words: str) -> None:
    with pytest.raises(MessageError, match=re.escape(words)) as refused:
        read(message)
    assert refused.value.kind == kind
    assert "\n" not in str(refused.value)


# Messages as plain Python values.


def test_nested_messages_and_bytes_survive_yaml_and_fields_keep_their_order() -> None:
    status = DiagnosticStatus(level=DiagnosticStatus.WARN, name="x: y", values=[KeyValue(key="k", value="é\n")])
    label = MultiArrayDimension(label="V", size=1, stride=1)
    array = Float64MultiArray(data=[0.5])
    array.layout.dim = [label]
    for message in (DiagnosticArray(status=[status]), array, UInt8MultiArray(data=bytes([1, 2, 3]))):
        assert yaml.safe_load(yaml.safe_dump(plain(message))) == plain(message)
    state = JointState(name=["a", "b"], position=[1.0, float("inf")])
    state.header.stamp.sec, state.header.frame_id = 7, "world"
    header = {"stamp": {"sec": 7, "nanosec": 0}, "frame_id": "world"}
    fields = {"header": header, "name": ["a", "b"], "position": [1.0, float("inf")], "velocity": [], "effort": []}
    assert list(plain(state).items()) == list(fields.items())
    assert plain(status)["level"] == 1
    assert plain(array)["layout"]["dim"] == [{"label": "V", "size": 1, "stride": 1}]
    assert plain(UInt8MultiArray(data=bytes([1, 2, 3])))["data"] == [1, 2, 3]


def test_fill_is_the_inverse_of_plain_and_takes_integers_as_floats() -> None:
    state = JointState(name=["a", "b"], position=[1.0, -2.0])
    state.header.stamp.sec = 7
    status = DiagnosticArray(status=[DiagnosticStatus(level=DiagnosticStatus.WARN, values=[KeyValue(key="k")])])
    for message in (state, status, UInt8MultiArray(data=bytes([1, 2, 3]))):
        made = type(message)(check_fields=True)
        fill(made, plain(message))
        assert made == message
    numbers = Float64MultiArray(check_fields=True)
    fill(numbers, {"data": [1, 2]})
    assert list(numbers.data) == [1.0, 2.0]


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"nam": ["a"]}, "'nam' is not a field of JointState; expected header (std_msgs/Header), "),
        ({"name": "a"}, "name is 'a'; expected sequence<string>"),
        ({"name": [1]}, r"name is \[1\]; expected sequence<string>"),
        ({"position": ["a"]}, "expected sequence<double>"),
        ({"header": {"stamp": {"sec": 2**40}}}, "sec is 1099511627776; expected int32"),
        ([1], "expected a mapping with header"),
    ],
)
def test_values_that_do_not_fit_are_refused(values: object, sentence: str) -> None:
    with pytest.raises(ParameterError, match=sentence.replace("(", r"\(").replace(")", r"\)")):
        fill(JointState(check_fields=True), values)
