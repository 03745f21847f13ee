# SPDX-License-Identifier: Apache-2.0
"""Hosts of a time base: a native thread, or callbacks of rclpy's executor. Both call the same C."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Protocol

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.publisher import Publisher

from fjr_core import FjrError
from fjr_msgs_py import names
from fjr_msgs_py.messages.cdr import LITTLE_ENDIAN
from fjr_msgs_py.messages.joint_states import MessageError
from fjr_msgs_py.native.loop import NativeLoop, NativeSubscription, Ring, publisher_address
from fjr_msgs_py.native.program import Program
from fjr_msgs_py.node.reports import Health

from .native import NO_TIME

COUNTERS = (
    "states published",
    "commands received",
    "ticks skipped",
    "states unanswered",
    "states sent again",
    "answers to other states",
    "command timeouts",
    "time lost",
    "clock jumps back",
)
"""Names of enum fjr_counter."""
EXPECTED = COUNTERS[:6]
UNWANTED = {
    "command timeouts": "no command for longer than command_timeout: effort set to zero",
    "time lost": "too far behind the clock: the backlog is skipped and stamps lag by it",
    "clock jumps back": "the clock jumped back: stamps continue from its new time",
}
REFUSALS = ("", "not a message", "missing joints", "duplicate joints", "wrong lengths", "not finite")
"""Kinds of refused commands by enum fjr_reading."""


class Events:
    """Handlers of the rare events of a plant; `error` is the FjrError that one of them raised."""

    error: FjrError | None = None

    def __init__(
        self, program: Any, health: Health, read: Callable[[bytes], None], others: Mapping[int, Callable[[int], None]]
    ) -> None:
        """read: reads a serialised command and raises MessageError; others: handlers by enum fjr_event, with value."""
        self._ffi, self._lib, self._health = program.ffi, program.lib, health
        self._read, self._others = read, others
        declared = "int(void*, int32_t, int64_t, const uint8_t*, size_t)"
        self.notify = self._ffi.callback(declared, self._on_event, error=1)

    def counts(self, plant: Any) -> dict[str, int]:
        """Return the counters of a plant; unwanted ones only if they are not 0."""
        refused = zip((f"command refused: {kind}" for kind in REFUSALS), plant.refused, strict=True)
        full = plant.states.overflows + plant.commands.overflows
        unwanted = [*zip(COUNTERS[6:], plant.count[6 : len(COUNTERS)], strict=True), *refused]
        unwanted.append(("messages beyond the capacity of a channel", full))
        counts = dict(zip(EXPECTED, plant.count[0:6], strict=True))
        return {**counts, **{name: count for name, count in unwanted if count}}

    def _on_event(self, _: Any, event: int, value: int, data: Any, size: int) -> int:
        try:
            if event == self._lib.FJR_COUNTED:
                self._health.tell(COUNTERS[value], UNWANTED[COUNTERS[value]])
            elif event == self._lib.FJR_COMMAND_REFUSED:
                self._health.tell_refusal("command", self._refusal(value, bytes(self._ffi.buffer(data, size))))
            else:
                self._others[event](value)
        except FjrError as error:
            self.error = error
            return 1
        return 0

    def _refusal(self, reading: int, data: bytes) -> MessageError:
        """Return the reason of a refused message as Python states it."""
        try:
            self._read(data)
        except MessageError as error:
            return error
        if data[:2] == LITTLE_ENDIAN[:2]:
            return MessageError(REFUSALS[reading], "the message is invalid")
        seen, wanted = (header[:2].hex(" ") for header in (data, LITTLE_ENDIAN))
        return MessageError(REFUSALS[reading], f"its CDR header is {seen}; expected {wanted}, little-endian")


NOTES, NOTES_PERIOD = 16, 0.05  # events that wait for Python, at most; s


class Hosted(NamedTuple):
    """What a host serves: a plant in C, its commands, and the publishers by enum fjr_output.

    command, tick: its functions in C. fail: called with a description after a fault; it does not raise.
    """

    node: Node
    program: Program
    plant: Any
    lock_step: bool
    kind: type
    topic: str
    publishers: list[Publisher]
    command: Callable[[Any, Any, int, int], int]
    tick: Callable[[Any, int, Any], int]
    fail: Callable[[str], None]


class PlantHost(Protocol):
    """What serves messages and ticks of a plant."""

    def start(self) -> None:
        """Begin to serve."""

    def run(self, action: Callable[[], Any]) -> Any:
        """Run an action between two messages and return its result; its exceptions are raised here."""

    def now(self) -> int:
        """Return the time [ns] of the clock that times the ticks."""

    def close(self) -> None:
        """Stop serving."""


class NativePlantHost:
    """A thread in C, see plant_loop.h; raises NativeError if it cannot be started."""

    def __init__(self, hosted: Hosted) -> None:
        program = hosted.program
        ffi, lib = program.ffi, program.lib
        self._hosted = hosted
        self.subscription = NativeSubscription(hosted.node, hosted.kind, hosted.topic, names.LATEST)
        self._callbacks = ffi.callback("int(void)", self._work, error=1), ffi.callback("void(void)", self._on_end)
        self.state = ffi.new("struct fjr_plant_loop*", {"plant": hosted.plant, "lock_step": hosted.lock_step})
        self.state.work, self.state.ended = self._callbacks
        for k, publisher in enumerate(hosted.publishers):
            self.state.publisher[k] = publisher_address(program, publisher)
        functions = (ffi.addressof(lib, f"fjr_plant_on_{what}") for what in ("message", "tick", "request", "end"))
        self._struct = ffi.new("struct fjr_host*", [self.state, *functions])
        self._loop = NativeLoop(program, self._struct, [self.subscription], hosted.publishers)
        self.state.loop = self._loop.pointer
        self._notes, self.state.notify = Ring(program, "struct fjr_note", NOTES), hosted.plant.notify
        self.state.notes, hosted.plant.host = self._notes.pointer, self.state
        hosted.plant.send, hosted.plant.notify = (
            ffi.addressof(lib, f"fjr_plant_{name}") for name in ("send", "notify")
        )
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = hosted.node.create_timer(NOTES_PERIOD, self._read_notes, clock=steady)
        self._action: Callable[[], Any] = lambda: None
        self._result: Any = None
        self._error: BaseException | None = None

    def start(self) -> None:
        """Start the thread."""
        self._loop.start()

    def run(self, action: Callable[[], Any]) -> Any:
        """Run an action on the thread, between two messages."""
        self._action, self._error = action, None
        self._loop.request(0)
        if self._error is not None:
            raise self._error
        return self._result

    def now(self) -> int:
        """Return the time of the steady clock [ns]."""
        return time.monotonic_ns()

    def close(self) -> None:
        """End the thread; a second call does nothing."""
        if self._loop.pointer:
            self._loop.close()
            self.subscription.close()
            self._hosted.node.destroy_timer(self._timer)

    def _read_notes(self) -> None:
        """Report the events that the thread kept."""
        ffi, null = self._hosted.program.ffi, self._hosted.program.ffi.NULL
        for note in self._notes.take():
            data = ffi.from_buffer("uint8_t[]", note["data"][: note["size"]])
            self.state.notify(null, int(note["event"]), int(note["value"]), data, int(note["size"]))

    def _work(self) -> int:
        try:
            self._result = self._action()
        except BaseException as error:
            self._error = error
        return 0

    def _on_end(self) -> None:
        self._hosted.fail(self._loop.reason)


class RclpyPlantHost:
    """Callbacks of the node's executor; the clock is the steady one, or the node's if it is simulated."""

    def __init__(self, hosted: Hosted, simulated: bool, period: float) -> None:
        """simulated: whether the clock is the node's, set by another publisher of /clock; period: of ticks [s]."""
        self._hosted, node, ffi = hosted, hosted.node, hosted.program.ffi
        self._clock = node.get_clock() if simulated else Clock(clock_type=ClockType.STEADY_TIME)
        self._simulated = simulated
        self._next = ffi.new("int64_t*")
        self._send = ffi.callback("int(void*, int32_t, const struct fjr_message*)", self._publish, error=1)
        hosted.plant.send = self._send
        self._subscription = node.create_subscription(
            hosted.kind, hosted.topic, self._on_command, names.LATEST, raw=True
        )
        self._period = period
        self._between = node.create_timer(1.0, self._on_tick, clock=self._clock)
        self._between.cancel()

    def start(self) -> None:
        """Begin to tick."""
        self._hosted.node.create_timer(self._period, self._on_tick, clock=self._clock)

    def run(self, action: Callable[[], Any]) -> Any:
        """Run an action."""
        return action()

    def close(self) -> None:
        """Do nothing: the node destroys its subscriptions and timers."""

    def now(self) -> int:
        """Return the time of the clock [ns]."""
        return int(self._clock.now().nanoseconds) if self._simulated else time.monotonic_ns()

    def _on_command(self, message: bytes) -> None:
        data = self._hosted.program.ffi.from_buffer("uint8_t[]", message)
        self._succeeded(self._hosted.command(self._hosted.plant, data, len(message), self.now()))

    def _on_tick(self) -> None:
        if not self._between.is_canceled():
            self._between.cancel()
        now, plant = self.now(), self._hosted.plant
        if self._succeeded(self._hosted.tick(plant, now, self._next)) and plant.between != NO_TIME:
            self._between.timer_period_ns = max(plant.between - now, 1)
            self._between.reset()

    def _succeeded(self, fault: int) -> bool:
        if fault:
            self._hosted.fail("")
        return not fault

    def _publish(self, _: Any, output: int, message: Any) -> int:
        self._hosted.publishers[output].publish(bytes(self._hosted.program.ffi.buffer(message.bytes, message.size)))
        return 0
