# SPDX-License-Identifier: Apache-2.0
"""The life of a node's process: errors in one sentence, signals that let the last command out, exit code."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable
from typing import Any, Protocol

import rclpy
import rclpy.exceptions
from rclpy.duration import Duration
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.publisher import Publisher
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from fjr_core import FjrError
from fjr_core.process_parameters import process_care

from .scheduling import freeze_garbage, take_care

try:
    from rclpy.experimental.events_executor import EventsExecutor
except ImportError:  # an older rclpy of a ROS 2 Jazzy installation
    EventsExecutor = None

POLL = 0.1  # s; how soon a signal is seen when no message comes


class StoppableNode(Protocol):
    """A node with checked parameter values and last words."""

    values: dict[str, Any]

    def get_logger(self) -> Any:
        """As of rclpy's Node."""

    def stop(self) -> None:
        """Send what must be sent before the process ends."""

    def destroy_node(self) -> None:
        """As of rclpy's Node."""


def run(make_node: Callable[[], StoppableNode], args: list[str] | None = None) -> int:
    """Run a node until SIGINT or SIGTERM; return the exit code.

    0: ended by a signal. 1: could not start or go on; one sentence on standard error says why. A node that
    has started has its last words (node.stop()) either way.
    """
    stopped: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda received, _: stopped.append(received))
    node = None
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        node = make_node()
        care = process_care(node.values)
    except (FjrError, *_ROS_ERRORS) as error:
        print(_sentence(error), file=sys.stderr, flush=True)
        _end(node)
        return 1
    for refusal in take_care(care):
        node.get_logger().warning(refusal)
    freeze_garbage()
    code = 0
    try:
        _spin(node, care.executor, stopped)
    except FjrError as error:
        print(f"ended: {error}", file=sys.stderr, flush=True)
        code = 1
    try:
        node.stop()
    finally:
        _end(node)
    return code


def _spin(node: StoppableNode, kind: str, stopped: list[int]) -> None:
    executor, spin = _executor(kind)
    executor.add_node(node)
    try:
        while not stopped and rclpy.ok():
            spin()
    except ExternalShutdownException:
        pass
    executor.remove_node(node)


def _executor(kind: str) -> tuple[Executor, Callable[[], None]]:
    """The executor that is asked for, or "single" where rclpy has no other, with a spin that returns within POLL.

    Without a time limit the events executor runs no callback and ignores signals in rclpy 7.1.6; a future kept
    from one spin to the next would collect callbacks.
    """
    if kind == "single" or EventsExecutor is None:
        single = SingleThreadedExecutor()
        return single, lambda: single.spin_once(timeout_sec=POLL)
    events = EventsExecutor()
    return events, lambda: events.spin_until_future_complete(Future(), POLL)


def _end(node: StoppableNode | None) -> None:
    if node is not None:
        node.destroy_node()
    rclpy.try_shutdown()


def flush(*publishers: Publisher, seconds: float = 0.2) -> None:
    """Wait until readers have acknowledged what was published, at most `seconds`."""
    for publisher in publishers:
        publisher.wait_for_all_acked(Duration(seconds=seconds))


_ROS_ERRORS = (
    rclpy_implementation.RCLError,
    rclpy.exceptions.ParameterException,
    rclpy.exceptions.InvalidNodeNameException,
    rclpy.exceptions.InvalidNamespaceException,
)


def _sentence(error: Exception) -> str:
    text = " ".join(str(error).split())
    if isinstance(error, FjrError):
        return f"cannot start: {text}"
    return f"cannot start: ROS 2 refused the arguments or the parameter file: {text}"
