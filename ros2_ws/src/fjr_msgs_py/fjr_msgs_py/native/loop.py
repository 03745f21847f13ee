# SPDX-License-Identifier: Apache-2.0
"""The thread of a native loop: start, requests, end. See loop.h."""

from __future__ import annotations

import atexit
import os
from collections.abc import Sequence
from contextlib import ExitStack
from typing import Any

from rclpy.publisher import Publisher

from .entities import NativeSubscription
from .program import NativeError, Program

LARGEST = 1 << 16  # bytes of a message that is taken without allocation
_running: set[Loop] = set()


class Loop:
    """A thread that serves subscriptions by the callbacks of a host in C (struct fjr_host)."""

    def __init__(
        self,
        program: Program,
        host: Any,
        subscriptions: Sequence[NativeSubscription],
        publishers: Sequence[Publisher] = (),
    ) -> None:
        """Create the loop. publishers: those that the host uses; they live while the thread runs."""
        self._program, self._host, self._subscriptions = program, host, tuple(subscriptions)
        self._held = ExitStack()
        self.use(publishers)
        addresses = [program.ffi.cast("void*", each.address) for each in subscriptions]
        self.pointer = program.lib.fjr_loop_create(host, addresses, len(addresses), LARGEST)
        if not self.pointer:
            raise NativeError("the loop cannot be created (out of memory)")

    def use(self, publishers: Sequence[Publisher]) -> None:
        """Replace the publishers that the host uses; not while the thread runs."""
        self._publishers = tuple(publishers)

    def start(self, priority: int = 0) -> None:
        """Start the thread, at this SCHED_FIFO priority if the system allows it; raises NativeError."""
        for entity in (*self._subscriptions, *self._publishers):
            self._held.enter_context(entity.handle)
        error = self._program.lib.fjr_loop_start(self.pointer, priority)
        if error:
            self._held.close()
            raise NativeError(f"the thread of the loop cannot be started ({os.strerror(error)})")
        _running.add(self)

    def stop(self) -> None:
        """End the thread and wait for it; without a thread do nothing."""
        self._program.lib.fjr_loop_stop(self.pointer)
        self._held.close()
        _running.discard(self)

    def close(self) -> None:
        """End the thread and free its memory."""
        self.stop()
        if self.pointer:
            self._program.lib.fjr_loop_destroy(self.pointer)
            self.pointer = self._program.ffi.NULL

    def request(self, kind: int, argument: Any = None) -> int:
        """Let the thread call the host's on_request between two messages; return the result."""
        ffi = self._program.ffi
        return int(self._program.lib.fjr_loop_request(self.pointer, kind, ffi.NULL if argument is None else argument))

    def hold(self, hold: bool) -> None:
        """Let messages wait from the end of the next request on, or take them again."""
        self._program.lib.fjr_loop_hold(self.pointer, hold)

    @property
    def runs(self) -> bool:
        """True while the thread runs."""
        return bool(self._program.lib.fjr_loop_runs(self.pointer))

    @property
    def reason(self) -> str:
        """Why the thread has failed; empty if it has not."""
        return self._program.ffi.string(self._program.lib.fjr_loop_reason(self.pointer)).decode(errors="replace")


@atexit.register
def _end_all() -> None:
    """End threads that nobody has ended; they must not call a Python that is shut down."""
    for loop in tuple(_running):
        loop.stop()
