# SPDX-License-Identifier: Apache-2.0
"""Messages as plain Python values."""

from __future__ import annotations

import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, UInt8MultiArray

from fjr_msgs_py.messages.plain import plain


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
