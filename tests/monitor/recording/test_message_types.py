# SPDX-License-Identifier: Apache-2.0
"""Messages that rclpy serialised are read as they were written; a definition that cannot be read is named."""

from __future__ import annotations

from pathlib import Path

import pytest
from rclpy.serialization import serialize_message
from rosbags.serde import SerdeError
from sensor_msgs.msg import JointState

from fjr_monitor.recording import message_types
from fjr_monitor.recording.message_types import SchemaError, definition, deserialize

TYPE = "sensor_msgs/msg/JointState"


@pytest.mark.parametrize("names", [[], ["a"], ["abcd", "e"]], ids=len)
@pytest.mark.parametrize("measured", [(), ("position",), ("position", "velocity"), ("effort",)], ids=str)
def test_bytes_behind_empty_sequences_do_not_count(names: list[str], measured: tuple[str, ...]) -> None:
    sent = JointState(name=names, **{field: [1.5 + i for i in range(len(names))] for field in measured})
    read = deserialize(serialize_message(sent), TYPE)
    assert read.name == names
    for field in ("position", "velocity", "effort"):
        assert list(getattr(read, field)) == list(getattr(sent, field))


@pytest.mark.parametrize("change", [lambda data: data[:-9], lambda data: data + bytes(17), lambda _: b"\0\1"])
def test_other_bytes_are_refused(change) -> None:
    data = serialize_message(JointState(name=["a"], position=[1.0], velocity=[2.0], effort=[3.0]))
    with pytest.raises(SerdeError):
        deserialize(change(data), TYPE)


@pytest.mark.parametrize("text", [b"other_msgs/Missing part", b"no = definition", b"int32 \xff"])
def test_a_definition_that_cannot_be_read_is_named(
    text: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "msg").mkdir()
    (tmp_path / "msg" / "Odd.msg").write_bytes(text)
    monkeypatch.setattr(message_types, "get_package_share_directory", lambda _: str(tmp_path))
    for _ in range(2):  # a type is not registered by half
        with pytest.raises(SchemaError, match="no definition of message type .* is installed here"):
            definition("odd_msgs/msg/Odd")
