# SPDX-License-Identifier: Apache-2.0
"""External torques: any subset of the joints by name; invalid messages are rejected."""

from __future__ import annotations

import pytest
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from fjr_msgs_py.messages.cdr import Template
from fjr_msgs_py.messages.joint_states import CLOCK_LAYOUT, MessageError, TorqueReader, time_of

JOINTS = ("a", "b", "c")
CASES = {
    "all": (["a", "b", "c"], [1.0, 2.0, 3.0], [1.0, 2.0, 3.0]),
    "another order": (["c", "a", "b"], [3.0, 1.0, 2.0], [1.0, 2.0, 3.0]),
    "some": (["b"], [2.0], [0.0, 2.0, 0.0]),
    "none": ([], [], [0.0, 0.0, 0.0]),
}


@pytest.mark.parametrize("case", CASES)
def test_a_joint_that_is_not_named_has_no_torque(case: str) -> None:
    names, effort, expected = CASES[case]
    torque = TorqueReader(JOINTS).read(JointState(name=names, effort=effort))
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
        TorqueReader(JOINTS).read(JointState(name=names, effort=effort))
    assert refused.value.kind == kind


def test_the_clock_message_holds_the_nanoseconds() -> None:
    message = Template(CLOCK_LAYOUT, ())
    message.stamp(12_345_678_901)
    assert time_of(deserialize_message(message.serialised(), Clock)) == 12_345_678_901
