# SPDX-License-Identifier: Apache-2.0
"""Join the DDS domain before a node loads, so that other participants are discovered meanwhile.

The participant belongs to the context of the process: it is created with the first node and shared by all others. A
hidden node, which has no topics, stands in until the real one is built.
"""

from __future__ import annotations

import os
import signal
import time
from contextlib import suppress
from typing import Any

import rclpy
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.signals import SignalHandlerOptions

from .loading import SIGNALS
from .log_folder import ensure_log_folder
from .scheduling import ahead_of_new_threads

SOON, LATER = 0.2, 0.4
"""Time [s] in which a participant discovers the publishers of the others: if it hears their first answer, if not."""

_initialised = False
_hidden: Any = None
_discovered_at: float | None = None


def join() -> None:
    """Initialise rclpy with the command line of the process, and join; SIGINT and SIGTERM leave and exit from then on.

    Fast DDS announces a participant before it listens, and another one on this machine answers at once: the answer is
    lost unless the thread that receives it waits meanwhile. Without it the other one is discovered at its next periodic
    announcement.
    An error is not reported here: the caller of `initialise`, or the first node, meets it again.
    """
    global _initialised, _hidden, _discovered_at
    with suppress(rclpy_implementation.RCLError):
        initialise(None)
        _initialised = True
        context = rclpy.get_default_context().handle
        with context, ahead_of_new_threads() as ahead:
            _hidden = rclpy_implementation.Node(f"_starting_{os.getpid()}", "/", context, None, False, False)
        _discovered_at = time.monotonic() + (SOON if ahead else LATER)
        for number in SIGNALS:
            signal.signal(number, _exit)


def initialise(args: list[str] | None) -> None:
    """Initialise rclpy for the process, unless `join` has done so; args: command line, None: sys.argv."""
    if not _initialised:
        ensure_log_folder()
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)


def discovered_at() -> float:
    """Return the time [s, steady clock] from which on the publishers of others are known; without `join`, LATER."""
    return time.monotonic() + LATER if _discovered_at is None else _discovered_at


def hand_over() -> None:
    """Destroy the hidden node; the participant remains if another node has been created."""
    global _hidden
    if _hidden is not None:
        _hidden.destroy_when_not_in_use()
        _hidden = None


def _exit(*_: object) -> None:
    """Leave the domain and end the process, which has nothing else to shut down while it loads."""
    hand_over()
    rclpy.try_shutdown()
    os._exit(0)
