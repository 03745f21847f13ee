# SPDX-License-Identifier: Apache-2.0
"""Joint states, effort commands and the time on /clock to NumPy, with a sentence for each message that is refused.

The native loops read the same messages in C (cdr.c), which counts what it refuses; the sentences are written here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from builtin_interfaces.msg import Duration, Time
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from fjr_core.errors import FjrError
from fjr_core.model.joints import JointSample
from fjr_core.numerics.checks import Array

from ..names import state_names
from .cdr import LITTLE_ENDIAN, Form

if TYPE_CHECKING:
    from fjr_core.runtime.measurement_model import Measurement

SECOND = 1_000_000_000  # ns
OR_OBSERVED = ", or the parameter measurement.velocity set to observer"
FIRST_UNSENDABLE = 2**31 * SECOND  # ns; the seconds of a stamp are a signed 32-bit integer


class MessageError(FjrError):
    """A message that is rejected; rejections of the same `kind` are counted and reported together."""

    def __init__(self, kind: str, sentence: str) -> None:
        super().__init__(sentence)
        self.kind = kind


def nanoseconds(stamp: Time) -> int:
    """Return a stamp as integer nanoseconds."""
    return int(stamp.sec) * SECOND + int(stamp.nanosec)


def set_nanoseconds(stamp: Time | Duration, value: int) -> None:
    """Set a stamp or a duration to integer nanoseconds."""
    stamp.sec, stamp.nanosec = divmod(value, SECOND)


def deserialised(data: bytes, kind: type) -> Any:
    """Return a serialised message of a type; raises MessageError if it is none."""
    try:
        return deserialize_message(data, kind)
    except rclpy_implementation.RMWError:
        raise MessageError("not a message", f"{len(data)} bytes are no {kind.__name__}; expected one") from None


def reason_of(data: bytes, read: Callable[[bytes], object]) -> MessageError:
    """Return why a serialised message was refused by C: the error of its reader in Python."""
    try:
        read(data)
    except MessageError as error:
        return error
    if data[:2] == LITTLE_ENDIAN[:2]:
        return MessageError("not a message", f"{len(data)} bytes are no message of this topic; expected one")
    seen, wanted = (header[:2].hex(" ") for header in (data, LITTLE_ENDIAN))
    return MessageError("not a message", f"its CDR header is {seen}; expected {wanted}, little-endian")


def picked(message: JointState, field: str, wanted: Sequence[str]) -> Array:
    """Return a field of the wanted joints, in their order; raises MessageError for an invalid message.

    Messages may list their joints in any order and hold others.
    """
    columns, values = _columns(list(message.name), wanted), np.asarray(getattr(message, field), dtype=float)
    if len(values) != len(message.name):
        observed = OR_OBSERVED if field == "velocity" and not len(values) and message.position else ""
        expected = f"expected {len(message.name)}, one per name{observed}"
        raise MessageError("wrong lengths", f"{field} has length {len(values)}; {expected}")
    return _finite(field, values[columns], wanted)


def _columns(names: list[str], wanted: Sequence[str]) -> list[int]:
    missing = [name for name in wanted if name not in names]
    if missing:
        raise MessageError("missing joints", f"names are {names}; expected {missing} among them")
    twice = [name for name in dict.fromkeys(wanted) if names.count(name) > 1]
    if twice:
        raise MessageError("duplicate joints", f"names are {names}; expected {twice} only once")
    return [names.index(name) for name in wanted]


def _finite(field: str, values: Array, names: Sequence[str]) -> Array:
    bad = [f"{name} = {value}" for name, value in zip(names, values, strict=True) if not np.isfinite(value)]
    if bad:
        observed = OR_OBSERVED if field == "velocity" else ""
        raise MessageError("not finite", f"{field} holds {', '.join(bad)}; expected finite numbers{observed}")
    return values


class StateReader:
    """Reader of JointStates by joint name; other joints are ignored. Gear ratio and stiffness are the step's to apply.

    measurement: None for measured velocities and motor positions. With motor "torque" the motor names are not needed;
    the efforts of the link-side names are the measured joint torques [N m]. names: those that a state needs.
    """

    def __init__(self, joints: tuple[str, ...], measurement: Measurement | None = None) -> None:
        self._n = len(joints)
        self._by_torque = measurement is not None and measurement.by_torque
        self._observed = measurement is not None and measurement.observed
        self.names = list(joints) if self._by_torque else state_names(joints)

    def read(self, message: JointState) -> JointSample:
        """Return the state in the order of the joints, in new arrays; raises MessageError for an invalid message."""
        positions, n = picked(message, "position", self.names), self._n
        motor = picked(message, "effort", self.names) if self._by_torque else positions[n:]
        velocity = () if self._observed else np.split(picked(message, "velocity", self.names), 2)
        stamp = nanoseconds(message.header.stamp)
        if not 0 < stamp < FIRST_UNSENDABLE:
            raise MessageError("no stamp", f"header.stamp is {stamp} ns; expected the time of the measurement")
        return JointSample(stamp, positions[:n], motor, *velocity)


def read_efforts(message: Float64MultiArray, joints: Sequence[str]) -> Array:
    """Return the efforts (n,) [N m] of an unnamed command; raises MessageError."""
    effort = np.array(message.data, dtype=float)
    if effort.shape != (len(joints),):
        raise MessageError("wrong lengths", f"data has length {effort.size}; expected {len(joints)}, one per joint")
    return _finite("data", effort, joints)


def read_torques(message: JointState, joints: Sequence[str]) -> Array:
    """Return the external torques (n,) [N m] on the links, zero for a joint that is not named; raises MessageError."""
    unknown = [name for name in message.name if name not in joints]
    if unknown:
        raise MessageError("unknown joints", f"names are {message.name}; expected some of {list(joints)}")
    torque = np.zeros(len(joints))
    torque[[joints.index(name) for name in message.name]] = picked(message, "effort", message.name)
    return torque


CLOCK_LAYOUT = Form([0, 0])
"""Layout of a serialised Clock, whose stamp is its time."""
