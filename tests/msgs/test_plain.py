# SPDX-License-Identifier: Apache-2.0
"""Messages as plain Python values."""

from __future__ import annotations

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, UInt8MultiArray

from fjr_core.errors import ParameterError
from fjr_msgs_py.messages.plain import fill, plain


def test_fields_keep_their_order_and_arrays_are_lists() -> None:
    message = JointState(name=["a", "b"], position=[1.0, float("inf")])
    message.header.stamp.sec, message.header.frame_id = 7, "world"
    assert list(plain(message)) == ["header", "name", "position", "velocity", "effort"]
    assert plain(message)["header"] == {"stamp": {"sec": 7, "nanosec": 0}, "frame_id": "world"}
    assert plain(message)["position"] == [1.0, float("inf")]
    assert plain(message)["velocity"] == []


def test_nested_messages_and_bytes_survive_yaml() -> None:
    status = DiagnosticStatus(level=DiagnosticStatus.WARN, name="x: y", values=[KeyValue(key="k", value="é\n")])
    label = MultiArrayDimension(label="V", size=1, stride=1)
    array = Float64MultiArray(data=[0.5])
    array.layout.dim = [label]
    for message in (DiagnosticArray(status=[status]), array, UInt8MultiArray(data=bytes([1, 2, 3]))):
        assert yaml.safe_load(yaml.safe_dump(plain(message))) == plain(message)
    assert plain(status)["level"] == 1
    assert plain(array)["layout"]["dim"] == [{"label": "V", "size": 1, "stride": 1}]
    assert plain(UInt8MultiArray(data=bytes([1, 2, 3])))["data"] == [1, 2, 3]


def test_fill_is_the_inverse_of_plain() -> None:
    state = JointState(name=["a", "b"], position=[1.0, -2.0])
    state.header.stamp.sec = 7
    status = DiagnosticArray(status=[DiagnosticStatus(level=DiagnosticStatus.WARN, values=[KeyValue(key="k")])])
    for message in (state, status, UInt8MultiArray(data=bytes([1, 2, 3]))):
        made = type(message)(check_fields=True)
        fill(made, plain(message))
        assert made == message


def test_fill_takes_integers_as_floats() -> None:
    message = Float64MultiArray(check_fields=True)
    fill(message, {"data": [1, 2]})
    assert list(message.data) == [1.0, 2.0]


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
