# SPDX-License-Identifier: Apache-2.0
"""Hosts of a time base: a native thread, or callbacks of rclpy's executor. Both call the same C."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.publisher import Publisher

from fjr_core import FjrError
from fjr_msgs_py.messages.cdr import LITTLE_ENDIAN
from fjr_msgs_py.messages.joint_states import MessageError
from fjr_msgs_py.native.host import NativeHost, RclpyHost
from fjr_msgs_py.native.loop import Ring
from fjr_msgs_py.native.program import Program
from fjr_msgs_py.node.reports import Health

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


class NativePlantHost(NativeHost):
    """A thread in C, see plant_loop.h; raises NativeError if it cannot be started."""

    def __init__(self, hosted: Hosted) -> None:
        program, plant = hosted.program, hosted.plant
        ffi, lib = program.ffi, program.lib
        self._callbacks = ffi.callback("int(void)", self._work, error=1), ffi.callback("void(void)", self._on_end)
        state = ffi.new("struct fjr_plant_loop*", {"plant": plant, "lock_step": hosted.lock_step})
        super().__init__(hosted.node, program, "fjr_plant", state, hosted.kind, hosted.topic)
        self.use(hosted.publishers)
        self._hosted, self._notes = hosted, Ring(program, "struct fjr_note", NOTES)
        state.work, state.ended = self._callbacks
        state.notes, state.notify, plant.host = self._notes.pointer, plant.notify, state
        plant.send, plant.notify = (ffi.addressof(lib, f"fjr_plant_{name}") for name in ("send", "notify"))
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = hosted.node.create_timer(NOTES_PERIOD, self._read_notes, clock=steady)
        self._action: Callable[[], Any] = lambda: None
        self._result: Any = None
        self._error: BaseException | None = None

    def run(self, action: Callable[[], Any]) -> Any:
        """Run an action on the thread, between two messages, and return its result; its exceptions are raised here."""
        self._action, self._error = action, None
        self.request(0)
        if self._error is not None:
            raise self._error
        return self._result

    def now(self) -> int:
        """Return the time of the steady clock [ns]."""
        return time.monotonic_ns()

    def close(self) -> None:
        """End the thread; a second call does nothing."""
        super().close()
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
        self._hosted.fail(self.reason)


class RclpyPlantHost(RclpyHost):
    """Callbacks of the node's executor; the clock is the steady one, or the node's if it is simulated."""

    def __init__(self, hosted: Hosted, simulated: bool, period: float) -> None:
        """simulated: whether the clock is the node's, set by another publisher of /clock; period: of ticks [s]."""
        clock = hosted.node.get_clock() if simulated else None
        super().__init__(hosted.node, hosted.program, hosted.kind, hosted.topic, clock)
        self._hosted, self._period, self._periodic = hosted, period, None  # type: Hosted, float, Any
        hosted.plant.send = self.publish
        self.use(hosted.publishers)

    def start(self) -> None:
        """Begin to tick."""
        self._periodic = self._ticking(self._period)

    def close(self) -> None:
        """Destroy subscription and timers; a second call does nothing."""
        super().close()
        self._node.destroy_timer(self._periodic)

    def run(self, action: Callable[[], Any]) -> Any:
        """Run an action and return its result."""
        return action()

    def _serve_message(self, message: bytes) -> None:
        data = self._hosted.program.ffi.from_buffer("uint8_t[]", message)
        self._succeeded(self._hosted.command(self._hosted.plant, data, len(message), self.now()))

    def _serve_tick(self) -> None:
        plant = self._hosted.plant
        if self._succeeded(self._hosted.tick(plant, self.now(), self._next)):
            self._tick_by(plant.between)

    def _succeeded(self, fault: int) -> bool:
        if fault:
            self._hosted.fail(str(self.reason))
        return not fault
