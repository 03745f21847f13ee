# SPDX-License-Identifier: Apache-2.0
"""NumPy <-> joint states, effort commands and the time on /clock."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from numpy.typing import NDArray
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from fjr_core import FjrError, Measurement
from fjr_core.numerics.checks import Array
from fjr_core.runtime.measurement_model import JointSample

from ..names import state_names
from .cdr import Form, Template, float_array, joint_state

EMPTY: Array = np.zeros(0)
FIRST_UNSENDABLE = 2**31 * 10**9  # ns; the seconds of a stamp are a signed 32-bit integer


class MessageError(FjrError):
    """A message that is rejected; rejections of the same `kind` are counted and reported together."""

    def __init__(self, kind: str, sentence: str) -> None:
        super().__init__(sentence)
        self.kind = kind


def nanoseconds(stamp: Time) -> int:
    """Return a stamp as integer nanoseconds."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def deserialised(data: bytes, kind: type) -> Any:
    """Return a serialised message of a type; raises MessageError if it is none."""
    try:
        return deserialize_message(data, kind)
    except rclpy_implementation.RMWError:
        raise MessageError("not a message", f"{len(data)} bytes are no {kind.__name__}; expected one") from None


class NamedColumns:
    """Index of wanted names in the name list of a message; the result of the last list is cached."""

    def __init__(self, wanted: Sequence[str]) -> None:
        self._wanted = list(wanted)
        self._seen: list[str] | None = None
        self._columns = np.array([], dtype=int)

    def columns(self, names: list[str]) -> NDArray[np.intp]:
        """Return the index of every wanted name; raises MessageError if one is missing or listed twice."""
        if names != self._seen:
            self._columns = self._find(names)
            self._seen = list(names)
        return self._columns

    def _find(self, names: list[str]) -> NDArray[np.intp]:
        missing = [name for name in self._wanted if name not in names]
        if missing:
            raise MessageError("missing joints", f"names are {names}; expected {missing} among them")
        twice = [name for name in self._wanted if names.count(name) > 1]
        if twice:
            raise MessageError("duplicate joints", f"names are {names}; expected {twice} only once")
        return np.array([names.index(name) for name in self._wanted])


class StateReader:
    """Reader of JointStates by joint name; other joints are ignored. Gear ratio and stiffness are the step's to apply.

    measurement: None for measured velocities and motor positions. With motor "torque" the motor names are not needed;
    the efforts of the link-side names are the measured joint torques [N m].
    """

    def __init__(self, joints: tuple[str, ...], measurement: Measurement | None = None) -> None:
        self._n = len(joints)
        self._measurement = measurement or Measurement(self._n)
        self._names = list(joints) if self._measurement.by_torque else state_names(joints)
        self._columns = NamedColumns(self._names)

    @property
    def names(self) -> list[str]:
        """Return the names that a state needs."""
        return list(self._names)

    def read(self, message: JointState) -> JointSample:
        """Return the state in the order of the joints, in new arrays; raises MessageError for an invalid message."""
        columns = self._columns.columns(message.name)
        position = _picked(message, "position", columns, self._names)
        if self._measurement.by_torque:
            positions = position, _picked(message, "effort", columns, self._names)
        else:
            positions = position[: self._n], position[self._n :]
        velocity = None if self._measurement.observed else self._velocities(message, columns)
        stamp = nanoseconds(message.header.stamp)
        if not 0 < stamp < FIRST_UNSENDABLE:
            raise MessageError("no stamp", f"header.stamp is {stamp} ns; expected the time of the measurement")
        if velocity is None:
            return JointSample(stamp, *positions)
        return JointSample(stamp, *positions, velocity[: self._n], velocity[self._n :])

    def _velocities(self, message: JointState, columns: NDArray[np.intp]) -> Array:
        if not message.velocity and message.position:
            raise MessageError(
                "wrong lengths",
                f"velocity has 0 entries; expected {len(message.name)}, one per name, "
                "or the parameter measurement.velocity set to observer",
            )
        return _picked(message, "velocity", columns, self._names)


class EffortReader:
    """Reader of effort commands."""

    def __init__(self, joints: tuple[str, ...]) -> None:
        self._joints = list(joints)
        self._columns = NamedColumns(joints)

    def read_array(self, message: Float64MultiArray) -> Array:
        """Return the efforts (n,) [N m] of an unnamed command; raises MessageError."""
        effort = np.array(message.data, dtype=float)
        if effort.shape != (len(self._joints),):
            raise MessageError(
                "wrong lengths", f"data has {effort.size} entries; expected {len(self._joints)}, one per joint"
            )
        return _finite("data", effort, self._joints)

    def read_named(self, message: JointState) -> tuple[int, Array]:
        """Return stamp [ns] of the answered state and efforts (n,) [N m] of a named command; raises MessageError."""
        columns = self._columns.columns(message.name)
        return nanoseconds(message.header.stamp), _picked(message, "effort", columns, self._joints)


class JointStateWriter:
    """Writer of JointStates: one serialised message, reused."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = list(names)
        self._lengths: tuple[int, ...] = ()

    def fill(self, stamp: int, position: Array = EMPTY, velocity: Array = EMPTY, effort: Array = EMPTY) -> bytes:
        """Return the serialised message with this stamp [ns] and these fields."""
        lengths = len(position), len(velocity), len(effort)
        if lengths != self._lengths:
            self._template = Template(joint_state(self._names, lengths), lengths)
            self._lengths = lengths
        template = self._template
        template.stamp(stamp)
        for own, values in zip(template.fields, (position, velocity, effort), strict=True):
            own[:] = values
        return template.serialised()


class EffortWriter:
    """Writer of unnamed effort commands: one serialised Float64MultiArray in the order of the joints, reused."""

    def __init__(self, joints: tuple[str, ...]) -> None:
        n = len(joints)
        self._template = Template(float_array(",".join(joints), n), [n])

    def fill(self, effort: Array) -> bytes:
        """Return the serialised message with these efforts (n,) [N m]."""
        self._template.fields[0][:] = effort
        return self._template.serialised()


def _picked(message: JointState, field: str, columns: NDArray[np.intp], names: Sequence[str]) -> Array:
    values = np.asarray(getattr(message, field), dtype=float)
    if len(values) != len(message.name):
        raise MessageError(
            "wrong lengths", f"{field} has {len(values)} entries; expected {len(message.name)}, one per name"
        )
    return _finite(field, values.take(columns), names)


def _finite(field: str, values: Array, names: Sequence[str]) -> Array:
    if not values.dot(values) < math.inf and not np.isfinite(values).all():  # the squares may overflow
        bad = [f"{name} = {value}" for name, value in zip(names, values, strict=True) if not np.isfinite(value)]
        raise MessageError("not finite", f"{field} holds {', '.join(bad)}; expected finite numbers")
    return values


class TorqueReader:
    """Reader of external torques: JointStates whose efforts act on the links of some joints."""

    def __init__(self, joints: tuple[str, ...]) -> None:
        self._row = {name: row for row, name in enumerate(joints)}

    def read(self, message: JointState) -> Array:
        """Return the torques (n,) [N m], zero for a joint that is not named; raises MessageError."""
        names = message.name
        unknown = [name for name in names if name not in self._row]
        if unknown:
            raise MessageError("unknown joints", f"names are {names}; expected some of {list(self._row)}")
        if len(set(names)) < len(names):
            raise MessageError("duplicate joints", f"names are {names}; expected each joint only once")
        effort = np.array(message.effort, dtype=float)
        if len(effort) != len(names):
            raise MessageError(
                "wrong lengths", f"effort has {len(effort)} entries; expected {len(names)}, one per name"
            )
        if not np.isfinite(effort).all():
            raise MessageError("not finite", f"effort holds {effort.tolist()}; expected finite numbers")
        torque = np.zeros(len(self._row))
        torque[[self._row[name] for name in names]] = effort
        return torque


def time_of(message: Clock) -> int:
    """Return the time of a message [ns]."""
    return nanoseconds(message.clock)


CLOCK_LAYOUT = Form([0, 0])
"""Layout of a serialised message, whose stamp is its time."""
