# SPDX-License-Identifier: Apache-2.0
"""numpy <-> messages: the only place where joint states and commands are read or built."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from builtin_interfaces.msg import Time
from numpy.typing import NDArray
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from fjr_core import FjrError, Measurement

from ..names import state_names
from .cdr.layout import Template, float_array, joint_state

Array = NDArray[np.float64]
EMPTY: Array = np.zeros(0)
FIRST_UNSENDABLE = 2**31 * 10**9  # ns: the seconds of a stamp have 31 bits, and an answer has its state's stamp


class MessageError(FjrError):
    """A message that is refused; `kind` groups the refusals that are counted and reported together."""

    def __init__(self, kind: str, sentence: str) -> None:
        super().__init__(sentence)
        self.kind = kind


class JointSample(NamedTuple):
    """A measured state: stamp [ns], positions [rad] and velocities [rad/s] of links and motors, each (n,).

    Velocities are None where the measurement leaves them to an observer.
    """

    stamp: int
    q_l: Array
    q_m: Array
    dq_l: Array | None = None
    dq_m: Array | None = None


def nanoseconds(stamp: Time) -> int:
    """A message's stamp as integer nanoseconds."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def set_stamp(message: JointState, stamp: int) -> None:
    """Stamp a message with integer nanoseconds."""
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 1_000_000_000)


class NamedColumns:
    """Finds the wanted names in a message's name list; the order of the last message is remembered."""

    def __init__(self, wanted: Sequence[str]) -> None:
        self._wanted = list(wanted)
        self._seen: list[str] | None = None
        self._columns = np.array([], dtype=int)

    def columns(self, names: list[str]) -> NDArray[np.intp]:
        """Index of every wanted name, in the wanted order; raises MessageError when one is absent or twice there."""
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
    """Reads JointStates of the joints of a robot, in any order and among any others, as the measurement says.

    measurement: None is measured velocities and motor positions of ratio 1. With motor "torque" the motors' names
    need not be there; the joints' own efforts are the sensors' torques [N m].
    """

    def __init__(self, joints: tuple[str, ...], measurement: Measurement | None = None) -> None:
        self._n = len(joints)
        self._measurement = measurement or Measurement(self._n)
        self._names = list(joints) if self._measurement.by_torque else state_names(joints)
        self._columns = NamedColumns(self._names)
        self._ratio = np.asarray(self._measurement.gear_ratio) if self._measurement.geared else None
        K = self._measurement.K
        self._compliance = None if K is None else np.linalg.inv(K)

    def read(self, message: JointState) -> JointSample:
        """The state in the order of the joints, in arrays of its own; MessageError for anything that is not one."""
        columns = self._columns.columns(message.name)
        q_l, q_m = self._positions(message, columns)
        velocity = None if self._measurement.observed else self._velocities(message, columns)
        stamp = nanoseconds(message.header.stamp)
        if not 0 < stamp < FIRST_UNSENDABLE:
            raise MessageError("no stamp", f"header.stamp is {stamp} ns; expected the time of the measurement")
        return JointSample(stamp, q_l, q_m) if velocity is None else JointSample(stamp, q_l, q_m, *velocity)

    def takes_as_is(self, message: JointState) -> bool:
        """Whether a state is the message's numbers as they are, in their order."""
        return message.name == self._names and self._ratio is None and self._compliance is None

    def sides(self, position: Array, velocity: Array, **_: Array) -> tuple[Array, ...]:
        """A sample's views of numbers (2n,) that are taken as they are."""
        fields = (position,) if self._measurement.observed else (position, velocity)
        return tuple(side for field in fields for side in (field[: self._n], field[self._n :]))

    def _positions(self, message: JointState, columns: NDArray[np.intp]) -> tuple[Array, Array]:
        position = _picked(message, "position", columns, self._names)
        if self._compliance is None:
            return self._sides("position", position)
        torque = _picked(message, "effort", columns, self._names)
        q_m = position + self._compliance.dot(torque)
        return position, _finite("q_l + K^-1 effort", q_m, self._names)

    def _velocities(self, message: JointState, columns: NDArray[np.intp]) -> tuple[Array, Array]:
        if not message.velocity and message.position:
            raise MessageError(
                "wrong lengths",
                f"velocity has 0 entries; expected {len(message.name)}, one per name, "
                "or the parameter measurement.velocity set to observer",
            )
        return self._sides("velocity", _picked(message, "velocity", columns, self._names))

    def _sides(self, field: str, values: Array) -> tuple[Array, Array]:
        """Link sides and motor sides (n,), the latter divided by the gear ratio."""
        link, motor = values[: self._n], values[self._n :]
        if self._ratio is not None:
            with np.errstate(over="ignore"):
                motor /= self._ratio
            _finite(f"{field} / gear_ratio", motor, self._names[self._n :])
        return link, motor


class EffortReader:
    """Reads effort commands of the joints of a robot."""

    def __init__(self, joints: tuple[str, ...]) -> None:
        self._joints = list(joints)
        self._columns = NamedColumns(joints)

    def read_array(self, message: Float64MultiArray) -> Array:
        """Efforts (n,) [N m] of an unnamed command; raises MessageError."""
        effort = np.array(message.data, dtype=float)
        if effort.shape != (len(self._joints),):
            raise MessageError(
                "wrong lengths", f"data has {effort.size} entries; expected {len(self._joints)}, one per joint"
            )
        return _finite("data", effort, self._joints)

    def takes_as_is(self, message: JointState) -> bool:
        """Whether a command is the message's numbers as they are, in their order."""
        return message.name == self._joints

    def read_named(self, message: JointState) -> tuple[int, Array]:
        """Stamp [ns] of the answered state and efforts (n,) [N m] of a stamped command; raises MessageError."""
        columns = self._columns.columns(message.name)
        return nanoseconds(message.header.stamp), _picked(message, "effort", columns, self._joints)


class JointStateWriter:
    """A serialised JointState, filled again and again."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = list(names)
        self._lengths: tuple[int, ...] = ()

    def fill(self, stamp: int, position: Array = EMPTY, velocity: Array = EMPTY, effort: Array = EMPTY) -> bytes:
        """The message with this stamp [ns] and these fields, for a publisher."""
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
    """A serialised Float64MultiArray in the order of the joints, filled again and again."""

    def __init__(self, joints: tuple[str, ...]) -> None:
        n = len(joints)
        self._template = Template(float_array(",".join(joints), n), [n])

    def fill(self, effort: Array) -> bytes:
        """The message with these efforts (n,) [N m], for a publisher."""
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
    """Reads JointStates whose efforts are torques on the links of any subset of the joints."""

    def __init__(self, joints: tuple[str, ...]) -> None:
        self._row = {name: row for row, name in enumerate(joints)}

    def read(self, message: JointState) -> Array:
        """Torques (n,) [N m], zero for a joint that is not named; raises MessageError."""
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
