# SPDX-License-Identifier: Apache-2.0
"""What a controller receives, in order, as every host of the control step can be fed with it."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import JointState

from faults.peers import stamp_of
from fjr_core.config.scenario import Scenario, parse_scenario
from fjr_msgs_py.messages.joint_states import MessageError, StateReader, deserialised

SECOND = 10**9  # ns
HEADER = struct.Struct("<iI")  # stamp of a serialised JointState, at byte 4


class Kind(IntEnum):
    """Kind of an input.

    TICK: a check for silence, in real time. RESTART: a new controller. CHANGE: new gains and limits. PARAMETERS: values
    to be refused. In a table only: states that the nodes refuse, NOT_FINITE with numbers, REFUSED without.
    """

    STATE, TICK, HOLD, RESUME, CHANGE, RESTART, PARAMETERS, NOT_FINITE, REFUSED = range(9)


@dataclass(frozen=True)
class Input:
    """An input at `time` [ns] of the clock of the arrivals; a state as it was serialised, or parameters by name."""

    kind: Kind
    time: int
    raw: bytes = b""
    parameters: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Sequence:
    """Recorded inputs of a controller; document: its parameter file. simulated: the stamps are the time.

    published: the nodes get the states over the middleware, in simulated time.
    changed: document with the parameters that a CHANGE sets, too.
    """

    name: str
    document: str
    simulated: bool
    inputs: tuple[Input, ...]
    rounds: int = 1
    published: bool = False
    changed: str = ""

    @cached_property
    def scenario(self) -> Scenario:
        """The scenario that the document describes."""
        return parse_scenario(self.name, self.document)

    @cached_property
    def changed_scenario(self) -> Scenario:
        """The scenario after a CHANGE."""
        return parse_scenario(self.name, self.changed) if self.changed else self.scenario

    @property
    def states(self) -> int:
        """Number of states that arrive, in all rounds."""
        return self.rounds * sum(each.kind is Kind.STATE for each in self.inputs)

    @property
    def has_requests(self) -> bool:
        """True if the controller is asked to hold, to resume or to change; no update of ros2_control does that."""
        return any(each.kind in (Kind.HOLD, Kind.RESUME, Kind.CHANGE) for each in self.inputs)

    @cached_property
    def shift(self) -> int:
        """Time from one round to the next [ns], of arrivals and stamps: longer than both, in whole seconds."""
        stamps = [stamp_of(each.raw) for each in self.inputs if each.kind is Kind.STATE]
        longest = max(max(stamps) - min(stamps), self.inputs[-1].time - self.inputs[0].time)
        return (longest // SECOND + 2) * SECOND

    def repeated(self) -> Iterator[Input]:
        """Yield the inputs of all rounds."""
        for number in range(self.rounds):
            shift = number * self.shift
            for each in self.inputs:
                raw = shifted(each.raw, shift) if each.kind is Kind.STATE and shift else each.raw
                yield Input(each.kind, each.time + shift, raw, each.parameters)

    def table_of(self, number: int) -> NDArray[Any]:
        """Return the inputs of a round as struct input of input.h."""
        table = self.table.copy()
        for name in ("time", "stamp"):
            table[name] += number * self.shift
        return table

    @cached_property
    def table(self) -> NDArray[Any]:
        """The inputs of the first round."""
        joints = self.scenario.joints
        reader, rows = StateReader(joints), np.zeros(len(self.inputs), dtype(len(joints)))
        for row, each in zip(rows, self.inputs, strict=True):
            row["kind"], row["time"] = each.kind, each.time
            if each.kind is Kind.STATE:
                row["stamp"] = stamp_of(each.raw)
                _write_sample(row, deserialised(each.raw, JointState), reader)
        return rows


def _write_sample(row: Any, message: JointState, reader: StateReader) -> None:
    """Write the sample of a message, or why the nodes refuse it."""
    try:
        sample = reader.read(message)
    except MessageError as error:
        row["kind"] = Kind.NOT_FINITE if error.kind == "not finite" else Kind.REFUSED
        if row["kind"] == Kind.NOT_FINITE:
            row["link"], row["motor"] = np.split(np.array(message.position), 2)
            row["velocity"] = message.velocity
        return
    row["link"], row["motor"] = sample.q_l, sample.q_m
    row["velocity"] = np.concatenate([sample.dq_l, sample.dq_m])


def dtype(n: int) -> np.dtype[Any]:
    """Return struct input of input.h; the fields from `stamp` on are struct fjr_sample."""
    return np.dtype(
        [("kind", "i8"), ("time", "i8"), ("stamp", "i8"), ("link", "f8", (n,)), ("motor", "f8", (n,)),
         ("velocity", "f8", (2 * n,))]
    )  # fmt: skip


def shifted(raw: bytes, nanoseconds: int) -> bytes:
    """Return a serialised JointState with another stamp."""
    return raw[:4] + HEADER.pack(*divmod(stamp_of(raw) + nanoseconds, SECOND)) + raw[4 + HEADER.size :]


def with_ticks(inputs: list[Input], period: int) -> tuple[Input, ...]:
    """Return the inputs, sorted by time, with a tick every `period` ns from the first to a second after the last."""
    first, last = inputs[0].time, inputs[-1].time + SECOND
    ticks = [Input(Kind.TICK, time) for time in range(first + period, last, period)]
    return tuple(sorted([*inputs, *ticks], key=lambda each: each.time))
