# SPDX-License-Identifier: Apache-2.0
"""Lend a control step to the thread of a native loop; Python then changes it by requests and reads a copy."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from fjr_core.runtime.control_step import ControlStep
from fjr_msgs_py.native.loop import Loop
from fjr_msgs_py.native.program import Program


class OwnedStep:
    """The functions of step.h that change a controller, executed by the thread between two messages.

    All other functions and constants are those of the library: they read the controller in Python, which is the copy.
    While it is lent, an object of this class stands in for `lib` of the control step.
    """

    def __init__(self, step: ControlStep, program: Program, loop: Loop, controller: Any) -> None:
        """controller: struct fjr_controller* of the thread."""
        self._step, self._program, self._loop, self._controller = step, program, loop, controller
        self._lib = step.lib

    def __getattr__(self, name: str) -> Any:
        return getattr(self._lib, name)

    def lend(self) -> None:
        """Give the controller to the thread, before it starts."""
        ffi = self._program.ffi
        ffi.memmove(self._controller, self._step.controller, ffi.sizeof("struct fjr_controller"))
        self._step.lib = self

    def take_back(self) -> None:
        """Give the controller back to Python, after the thread has ended."""
        self.read()
        self._step.lib = self._lib

    def read(self) -> None:
        """Bring the controller in Python up to date."""
        self.request("FJR_COPY")

    @contextmanager
    def between_samples(self) -> Iterator[None]:
        """Let states wait until the end of the block, with the controller in Python up to date."""
        self._loop.hold(True)
        try:
            self.read()
            yield
        finally:
            self._loop.hold(False)

    def check_silence(self, now: int) -> None:
        """Send the stop effort once per silence; now [ns]: of the clock of the stamps."""
        self.request("FJR_CHECK_SILENCE", time=now)

    def send_stop(self) -> None:
        """Send the stop effort if a command was sent."""
        self.request("FJR_SEND_STOP")

    def fjr_start(self, _: Any, reference: Any) -> None:
        """Start again at the next sample."""
        self.request("FJR_START", reference)

    def fjr_apply(self, _: Any, settings: Any) -> None:
        """Replace the settings."""
        self.request("FJR_APPLY", settings)

    def fjr_use_gains(self, _: Any, gains: Any, hold_damping: Any) -> None:
        """Replace the gains."""
        self.request("FJR_USE_GAINS", gains, hold_damping)

    def fjr_follow(self, _: Any, reference: Any, start: int) -> None:
        """Track a reference from a stamp on."""
        self.request("FJR_FOLLOW", reference, time=start)

    def fjr_hold(self, _: Any) -> None:
        """Come to a standstill."""
        self.request("FJR_DO_HOLD")

    def fjr_resume(self, _: Any) -> None:
        """End a stop."""
        self.request("FJR_DO_RESUME")

    def request(self, kind: str, first: Any = None, second: Any = None, time: int = 0) -> None:
        """Let the thread serve a request of enum fjr_controller_request, and wait for it."""
        ffi, null = self._program.ffi, self._program.ffi.NULL
        arguments = (null if first is None else first, null if second is None else second, time)
        self._loop.request(getattr(self._program.lib, kind), ffi.new("struct fjr_arguments*", arguments))
