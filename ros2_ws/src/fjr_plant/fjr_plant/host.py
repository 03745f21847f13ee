# SPDX-License-Identifier: Apache-2.0
"""Hosts of a time base: a native thread, or callbacks of rclpy's executor. Both call the same C."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from typing import Any

from rclpy.node import Node

from fjr_core import FjrError
from fjr_msgs_py import names
from fjr_msgs_py.native.loop import NativeLoop, NativeSubscription, RclpyHost, Ring
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


class Events:
    """Handlers of the rare events of a plant; `error` is the FjrError that one of them raised."""

    error: FjrError | None = None

    def __init__(self, program: Any, health: Health, on: dict[int, Callable[[int], None]]) -> None:
        """on: handlers by enum fjr_event, with value."""
        self._lib, self._health, self.on = program.lib, health, on
        self.notify = program.ffi.callback("int(int32_t, int64_t)", self._on_event, error=1)

    def counts(self, plant: Any) -> dict[str, int]:
        """Return the counters of a plant; unwanted ones only if they are not 0."""
        full = plant.states.overflows + plant.commands.overflows
        unwanted = [*zip(COUNTERS[6:], plant.count[6 : len(COUNTERS)], strict=True)]
        unwanted.append(("messages beyond the capacity of a channel", full))
        counts = dict(zip(EXPECTED, plant.count[0:6], strict=True))
        return {**counts, **{name: count for name, count in unwanted if count}}

    def _on_event(self, event: int, value: int) -> int:
        try:
            if event == self._lib.FJR_COUNTED:
                self._health.say("warn", COUNTERS[value], UNWANTED[COUNTERS[value]])
            else:
                self.on[event](value)
        except FjrError as error:
            self.error = error
            return 1
        return 0


Callbacks = Mapping[str, Any]  # fields of struct fjr_callbacks, without on_request and on_end
Fail = Callable[[str], None]  # called with a description after a fault; it does not raise
NOTES, NOTES_PERIOD = 16, 0.05  # events that wait for Python, at most; s


class NativePlantHost(NativeLoop):
    """A thread in C; raises NativeError if it cannot be started."""

    def __init__(self, node: Node, program: Program, callbacks: Callbacks, kind: type, topic: str, fail: Fail) -> None:
        """kind, topic: of the commands."""
        ffi, plant = program.ffi, callbacks["self"]
        self._fail, self._node, self._notes = fail, node, Ring(program, "struct fjr_note", NOTES)
        own = {
            "on_request": ffi.callback("int(void*, int32_t, void*)", self._work, error=1),
            "on_end": ffi.callback("void(void*, int32_t)", self._on_end),
        }
        super().__init__(program, {**callbacks, **own}, [NativeSubscription(node, kind, topic, names.LATEST)])
        self._plant, plant.host, plant.notes = plant, self.pointer, self._notes.pointer
        plant.send = ffi.addressof(program.lib, "fjr_loop_publish")
        profile = os.environ.get("FASTRTPS_DEFAULT_PROFILES_FILE", "")
        if profile.endswith("fjr_bringup/config/fastdds.xml"):  # others may acknowledge messages after seconds only
            plant.settle = ffi.addressof(program.lib, "fjr_loop_settle")
        self._timer = node.create_timer(NOTES_PERIOD, self._read_notes, clock=names.STEADY)
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
        self._node.destroy_timer(self._timer)

    def _read_notes(self) -> None:
        """Report the events that the thread kept."""
        for note in self._notes.take():
            self._plant.notify(int(note["event"]), int(note["value"]))

    def _work(self, *_: Any) -> int:
        try:
            self._result = self._action()
        except BaseException as error:
            self._error = error
        return 0

    def _on_end(self, _: Any, outcome: int) -> None:
        if outcome > 0:
            self._fail(self.reason)


class RclpyPlantHost(RclpyHost):
    """Callbacks of the node's executor; the clock is the steady one, or the node's if it is simulated."""

    def __init__(
        self,
        node: Node,
        program: Program,
        callbacks: Callbacks,
        kind: type,
        topic: str,
        fail: Fail,
        simulated: bool,
        period: float,
    ) -> None:
        """As NativePlantHost. simulated: whether the clock is the node's, set by another; period: of ticks [s]."""
        super().__init__(node, program, callbacks, kind, topic, node.get_clock() if simulated else None)
        self._plant, self._fail, self._period, self._periodic = callbacks["self"], fail, period, None
        self._plant.send = self.publish

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

    def _goes_on(self, outcome: int) -> bool:
        if outcome:
            self._fail(str(self.reason))
        return not outcome

    def _tick_by(self, _: int) -> None:
        """Let a tick come at the next state that leaves between two ticks of the period."""
        super()._tick_by(self._plant.between)
