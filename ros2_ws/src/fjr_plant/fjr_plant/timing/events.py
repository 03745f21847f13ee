# SPDX-License-Identifier: Apache-2.0
"""Counters and rare events of a plant in C (enum fjr_counter, enum fjr_event), for log and /diagnostics."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from fjr_core import FjrError
from fjr_msgs_py.messages.cdr.layout import LITTLE_ENDIAN
from fjr_msgs_py.messages.joint_states import MessageError
from fjr_msgs_py.node.diagnostics import Health

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
