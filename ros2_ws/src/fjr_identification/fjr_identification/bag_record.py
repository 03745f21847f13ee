# SPDX-License-Identifier: Apache-2.0
"""Read a record of motion from a bag in blocks of messages: memory grows with the numbers that are used only."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Message

from fjr_core.errors import RecordError
from fjr_core.numerics.checks import Array
from fjr_monitor.recording.bag import FLOATS, JOINT_STATE, in_order, read_bag
from fjr_monitor.recording.files import BagError, Times
from fjr_monitor.recording.message_types import typestore
from fjr_monitor.recording.signals import first_of_each_stamp, match_stamps
from fjr_msgs_py import names
from fjr_msgs_py.messages.cdr import joint_state_arrays

from .estimation.motion_record import LARGEST, MotionRecord, TimeWindow, record_of_samples
from .record_map import COMMANDS, STATES, BagMap

BLOCK = 4096  # messages that are read together, and between two looks at the window


def record_of_bag(
    path: Path, mapping: BagMap, joints: tuple[str, ...], window: TimeWindow
) -> tuple[MotionRecord, tuple[str, ...]]:
    """Return the record of a bag from the first commanded state on, within the window, and notes on it.

    Effort: the command that answers each state by its stamp, else the last one sent before the next state, else the
    torque of the motors in the states. Raises BagError, RecordError.
    """
    held = read_bag(path).topics
    states = _topic(path, list(held), mapping.namespace, names.JOINT_STATES, needed=True)
    assert states is not None
    commands = _command_topic(path, list(held), mapping)
    if held[states].type_name != JOINT_STATE:
        raise BagError(f"{states} of {path} is a {held[states].type_name}; expected {JOINT_STATE}")
    answers = held[commands].type_name == JOINT_STATE if commands else False
    of_states = _States(states, names.state_names(joints), ("position", "effort"))
    columns: dict[str, _States | _Efforts] = {states: of_states}
    if commands:
        columns[commands] = _States(commands, joints, ("effort",)) if answers else _Efforts(commands, len(joints))
    for count, (name, message) in enumerate(in_order(path, list(columns))):
        columns[name].add(message)
        if count % BLOCK == 0:
            of_states.read()
            if len(of_states.numbers) > LARGEST:
                raise RecordError(f"{states} holds more than {LARGEST:,} numbers; expected fewer: choose a --duration")
            since = (of_states.stamps[-1] - of_states.stamps[0]) * 1e-9 if of_states.stamps else 0.0
            if since > window.start + window.duration + 1.0:  # 1 s for commands that answer late
                break
    for each in columns.values():
        if isinstance(each, _States):
            each.read()
    return _record(path, of_states, columns.get(commands or ""), mapping, joints, window)


class _Columns:
    """Numbers of one topic: stamps and send times [ns], and a row of numbers for each message, without gaps."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.stamps, self.sent, self.numbers = array("q"), array("q"), array("d")

    def arrays(self) -> tuple[Times, Times, Array]:
        """Return stamps, send times (k,) [ns] and rows (k, width)."""
        stamps, sent = (np.array(times, dtype=np.int64) for times in (self.stamps, self.sent))
        return stamps, sent, np.array(self.numbers).reshape(len(stamps), -1)


class _States(_Columns):
    """Fields of the named joints of a JointState topic; absent values are NaN."""

    def __init__(self, name: str, joints: Sequence[str], fields: Sequence[str]) -> None:
        super().__init__(name)
        self._joints, self._fields = list(joints), fields
        self._waiting: list[Message] = []

    def add(self, message: Message) -> None:
        """Take a message, whose numbers are read together with those of others; raise BagError."""
        self._waiting.append(message)
        if len(self._waiting) == BLOCK:
            self.read()

    def read(self) -> None:
        """Read the numbers of the messages that wait; raise BagError."""
        waiting, self._waiting = self._waiting, []
        if waiting and not self._read(waiting):
            for message in waiting:  # names or lengths differ
                if not self._read([message]):
                    raise BagError(
                        f"{self.name} holds a {JOINT_STATE} with an unusual layout; expected little-endian CDR"
                    )

    def _read(self, messages: Sequence[Message]) -> bool:
        """Read messages with the names and lengths of the first; return whether they have them."""
        data = [bytes(message.data) for message in messages]
        try:
            first: Any = typestore().deserialize_cdr(data[0], JOINT_STATE)
            arrays = joint_state_arrays(data, first)
        except Exception as error:  # any error of the decoder
            raise BagError(f"{self.name} holds bytes that are not a {JOINT_STATE} ({error})") from error
        if arrays is None:
            return False
        stamps, values = arrays
        rows, listed = np.full((len(data), len(self._fields), len(self._joints)), np.nan), list(first.name)
        for i, what in enumerate(self._fields):
            for j, joint in enumerate(self._joints):
                if joint in listed and listed.index(joint) < values[what].shape[1]:
                    rows[:, i, j] = values[what][:, listed.index(joint)]
        self.stamps.extend(stamps.tolist())
        self.sent.extend(message.publish_time for message in messages)
        self.numbers.frombytes(rows.tobytes())
        return True


class _Efforts(_Columns):
    """Numbers of a Float64MultiArray topic."""

    def __init__(self, name: str, n: int) -> None:
        super().__init__(name)
        self._n = n

    def add(self, message: Message) -> None:
        """Take the numbers of a message; raise BagError."""
        try:
            data = np.array(typestore().deserialize_cdr(bytes(message.data), FLOATS).data, dtype=float)
        except Exception as error:  # any error of the decoder
            raise BagError(f"{self.name} holds bytes that are not a {FLOATS} ({error})") from error
        if len(data) != self._n:
            raise BagError(f"{self.name} holds {len(data)} efforts; expected {self._n}")
        self.stamps.append(message.publish_time)
        self.sent.append(message.publish_time)
        self.numbers.frombytes(data.tobytes())


def _topic(path: Path, held: Sequence[str], namespace: str, name: str, needed: bool = False) -> str | None:
    """Return the topic of this name in the namespace, else in any; raise BagError for several, or none if needed."""
    if f"{namespace}/{name}" in held:
        return f"{namespace}/{name}"
    others = [] if namespace else [topic for topic in held if topic.endswith(f"/{name}")]
    if len(others) > 1:
        raise BagError(f"{path} holds {' and '.join(sorted(others))}; expected one, or bag.namespace in a --map")
    if needed and not others:
        raise BagError(
            f"{path} holds no message of {namespace}/{name}; it holds {', '.join(sorted(held)) or 'nothing'}"
        )
    return others[0] if others else None


def _command_topic(path: Path, held: Sequence[str], mapping: BagMap) -> str | None:
    """Return the topic of the efforts; None: those of the states."""
    if mapping.effort == STATES:
        return None
    found = (_topic(path, held, mapping.namespace, name) for name in (names.JOINT_COMMANDS, names.EFFORT_COMMANDS))
    needed = mapping.effort == COMMANDS
    return next(filter(None, found), None) or _topic(path, held, mapping.namespace, names.JOINT_COMMANDS, needed)


def _record(
    path: Path,
    states: _Columns,
    commands: _States | _Efforts | None,
    mapping: BagMap,
    joints: tuple[str, ...],
    window: TimeWindow,
) -> tuple[MotionRecord, tuple[str, ...]]:
    """Return the record of the states with their efforts, and notes on it."""
    n, (stamps, sent, rows) = len(joints), states.arrays()
    if not len(stamps):
        raise RecordError(f"{path} holds no state; expected a record of motion")
    q_l, q_m, tau, u = (rows[:, i * n : (i + 1) * n] for i in range(4))
    notes: tuple[str, ...] = ()
    if commands is None:
        notes = (f"no commands: the effort of {names.motor_name(joints[0])} and so on in the states is the torque",)
    else:
        u, notes = _answers(stamps, sent, commands)
    unknown = np.full_like(q_l, np.nan)
    q_m, tau = (unknown, tau) if mapping.by_torque else (q_m / mapping.gear_ratio, unknown)
    driven = np.flatnonzero(np.isfinite(u).all(axis=1))
    if not len(driven):
        raise RecordError(f"{path} holds no effort of all joints; expected commands, or efforts in the states")
    begin, end = int(driven[0]), int(driven[-1]) + 1
    kept = begin + np.flatnonzero(np.append(True, np.diff(stamps[begin:end]) != 0))  # a waiting plant repeats its state
    u = u[kept]
    answered = np.isfinite(u).all(axis=1)
    u = u[np.maximum.accumulate(np.where(answered, np.arange(len(u)), 0))]  # the last command holds
    t = (stamps[kept] - stamps[kept[0]]) * 1e-9
    table = window.of(t, np.column_stack([t, q_l[kept], q_m[kept], u, tau[kept]]))
    if not len(table):
        raise RecordError(f"{path} holds no samples{window.text}; expected a record of motion")
    q_l, q_m, u, tau = (table[:, 1 + i * n : 1 + (i + 1) * n] for i in range(4))
    _check_finite(path, {"positions of the links": q_l, "positions of the motors": q_m, "joint torques": tau}, joints)
    return record_of_samples(path.name, joints, table[:, 0], q_l, q_m, u, tau, notes)


def _answers(stamps: Times, sent: Times, commands: _States | _Efforts) -> tuple[Array, tuple[str, ...]]:
    """Return the command (k, n) of each state, NaN without one, and a note if some are missing."""
    times, published, efforts = commands.arrays()
    if not len(times):
        raise RecordError(f"{commands.name} holds no command; expected one for each state")
    if isinstance(commands, _Efforts):
        last = np.searchsorted(published, np.append(sent[1:], np.iinfo(np.int64).max)) - 1
        u = np.where(last[:, None] >= 0, efforts[np.maximum(last, 0)], np.nan)
        return u, (f"a command of {commands.name} is taken to answer the last state sent before it",)
    rows = first_of_each_stamp(times)
    place, answered = match_stamps(stamps, times[rows])
    u = np.where(answered[:, None], efforts[rows][place], np.nan)
    ends = np.flatnonzero(answered)
    missing = int((~answered[ends[0] : ends[-1]]).sum()) if len(ends) else 0
    return u, (f"{missing} states have no command: the one before is taken to hold",) if missing else ()


def _check_finite(path: Path, signals: dict[str, Array], joints: Sequence[str]) -> None:
    """Raise RecordError for a signal that is there at some samples only."""
    for what, values in signals.items():
        known = np.isfinite(values)
        for j in np.flatnonzero(known.any(axis=0) & ~known.all(axis=0)):
            row = int(np.argmin(known[:, j]))
            raise RecordError(f"{path}: {what} of {joints[j]} are missing or not finite at sample {row}; expected all")
    if not np.isfinite(values := np.hstack(list(signals.values())[:2])).any():
        raise RecordError(f"{path}: no position of {', '.join(joints)} in its {values.shape[0]} states; expected some")
