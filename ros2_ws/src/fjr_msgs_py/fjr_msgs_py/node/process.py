# SPDX-License-Identifier: Apache-2.0
"""Run a node as a process: errors in one sentence, signals that allow a last command, exit code."""

from __future__ import annotations

import gc
import signal
import sys
import time
from collections.abc import Callable, Mapping
from typing import Any

import rclpy
import rclpy.exceptions
from rclpy.duration import Duration
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.publisher import Publisher

from fjr_core import FjrError
from fjr_core.config.process import NATIVE, process_settings

from ..names import STEADY
from . import participant
from .loading import index_modules, resume_garbage_collection
from .parameters import ParameterNode
from .scheduling import apply_process_settings, freeze_garbage, yield_to_loops

try:
    from rclpy.experimental.events_executor import EventsExecutor
except ImportError:  # an older rclpy of a ROS 2 Jazzy installation
    EventsExecutor = None

POLL = 0.1  # s; longest delay of the response to a signal
ROUND = 60.0  # s; longest time in the events executor, each of which leaks a few bytes (rclpy 7.1.6)
COLLECTION = 1.0  # s; between two garbage collections
LAST_MESSAGES = 0.5  # s; in which a lost message is sent again ten times (config/fastdds.xml)


def run(make_node: Callable[[], ParameterNode], args: list[str] | None = None) -> int:
    """Run a node until SIGINT or SIGTERM; return the exit code.

    Exit code 0: ended by a signal. 1: could not start, or ended by an FjrError; one sentence on standard error gives
    the reason. A started node always gets node.stop(); an unexpected exception then propagates to the caller.
    Exceptions of tasks of the events executor cannot be caught: rclpy 7.1.6 crashes, so a task must not raise.
    """
    stopped: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda received, _: stopped.append(received))
    node = None
    try:
        participant.initialise(args)
        index_modules()
        ParameterNode.process_arguments = sys.argv if args is None else args
        ParameterNode.in_process = True
        node = make_node()
        node.host = NodeProcess(node)
    except (FjrError, *_ROS_ERRORS) as error:
        why = "" if isinstance(error, FjrError) else "ROS 2 refused the arguments or the parameter file: "
        print(f"cannot start: {why}{' '.join(str(error).split())}", file=sys.stderr, flush=True)
        _end(node)
        return 1
    finally:
        ParameterNode.process_arguments = ()
        participant.hand_over()
        resume_garbage_collection()
    try:
        node.host.spin(stopped)
        if node.ended is not None:
            print(f"ended: {node.ended}", file=sys.stderr, flush=True)
    finally:
        try:
            node.stop()
        finally:
            _end(node)
    return 0 if node.ended is None else 1


class NodeProcess:
    """The process of a node: its settings, and the loop that serves the callbacks of the node."""

    _granted = ""

    def __init__(self, node: ParameterNode) -> None:
        """Apply the process settings of the node; raises ParameterError."""
        self._node = node
        self._kind = process_settings(node.values).executor
        self._apply(node.values)

    def apply_process_settings(self, values: Mapping[str, Any]) -> None:
        """Apply the process settings of the values after large objects were built; raises ParameterError."""
        self._apply(values)
        freeze_garbage()

    def _apply(self, values: Mapping[str, Any]) -> None:
        settings = process_settings(values)
        granted, refusals = apply_process_settings(settings)
        for refusal in refusals:
            self._node.get_logger().warning(refusal)
        if granted != self._granted and settings.executor == NATIVE and not values.get("lockstep", False):
            self._granted = granted
            self._node.get_logger().info(granted)
        if settings.executor == NATIVE:
            yield_to_loops()

    def spin(self, stopped: list[int]) -> None:
        """Serve callbacks until `stopped` holds a signal or the node has ended.

        A full collection takes 0.1 ms, because all older objects are frozen, and releases the memory of Python's free
        lists: without it they grow for minutes.
        """
        self._node.create_timer(COLLECTION, gc.collect, clock=STEADY)
        executor, spin = self._executor(stopped)
        executor.add_node(self._node)
        try:
            while not stopped and not self._node.over.done() and rclpy.ok():
                spin()
        except ExternalShutdownException:
            pass
        except FjrError as error:  # of a callback that the node does not wrap, such as an action's
            self._node.ended = error
        executor.remove_node(self._node)

    def _executor(self, stopped: list[int]) -> tuple[Executor, Callable[[], None]]:
        """Return the selected executor (single-threaded if rclpy has no other) and a spin that signals end in POLL.

        Without a timeout the events executor of rclpy 7.1.6 runs no callback. Python handles signals in a callback.
        """
        if self._kind == "single" or EventsExecutor is None:
            single = SingleThreadedExecutor()
            return single, lambda: single.spin_once(timeout_sec=POLL)
        events = EventsExecutor()

        def look() -> None:
            if stopped or not rclpy.ok():
                self._node.over.set_result(None)

        self._node.create_timer(POLL, look, clock=STEADY)
        return events, lambda: events.spin_until_future_complete(self._node.over, ROUND)


def _end(node: ParameterNode | None) -> None:
    participant.stop_discovery(node and node.handle)
    if node is not None:
        node.destroy_node()
    rclpy.try_shutdown()


def flush(*publishers: Publisher, seconds: float = LAST_MESSAGES) -> None:
    """Wait until all published messages are acknowledged, at most `seconds` in all.

    A subscriber whose process was killed acknowledges none, and is forgotten only seconds later.
    """
    end = time.monotonic() + seconds
    for publisher in publishers:
        publisher.wait_for_all_acked(Duration(seconds=max(0.0, end - time.monotonic())))


_ROS_ERRORS = (
    rclpy_implementation.RCLError,
    rclpy.exceptions.ParameterException,
    rclpy.exceptions.InvalidNodeNameException,
    rclpy.exceptions.InvalidNamespaceException,
)
