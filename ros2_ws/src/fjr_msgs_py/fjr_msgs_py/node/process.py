# SPDX-License-Identifier: Apache-2.0
"""The life of a node's process: errors in one sentence, signals that let the last command out, exit code."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Mapping
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
from fjr_core.config.process import process_care

from .log_folder import ensure_log_folder
from .parameters import CheckedParameters
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

    0: ended by a signal. 1: could not start, or ended by an FjrError of its own; one sentence on standard error
    says why. A node that has started has its last words (node.stop()) whatever ends it; an exception that nobody
    foresaw goes on to the caller after them. Only what a task of the events executor raises cannot be met: rclpy
    7.1.6 crashes the process then, so a task must let nothing escape.
    """
    stopped: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda received, _: stopped.append(received))
    node = None
    ensure_log_folder()
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        CheckedParameters.process_arguments = sys.argv if args is None else args
        node = make_node()
        host = _Host(node)
    except (FjrError, *_ROS_ERRORS) as error:
        print(_sentence(error), file=sys.stderr, flush=True)
        _end(node)
        return 1
    finally:
        CheckedParameters.process_arguments = ()
    try:
        host.spin(stopped)
        if host.ended is not None:
            print(f"ended: {host.ended}", file=sys.stderr, flush=True)
    finally:
        try:
            node.stop()
        finally:
            _end(node)
    return 0 if host.ended is None else 1


class _Host:
    """The process as its node sees it (failure.Host), and the loop that serves the node's callbacks."""

    ended: FjrError | None = None

    def __init__(self, node: StoppableNode) -> None:
        """Take care for the node's cycles; raises ParameterError."""
        self._node = node
        self._kind = process_care(node.values).executor
        self._round: Future = Future()
        self.take_care(node.values)
        if isinstance(node, CheckedParameters):
            node.host = self

    def take_care(self, values: Mapping[str, Any]) -> None:
        """Give the process what the values ask for, and freeze what is built."""
        for refusal in take_care(process_care(values)):
            self._node.get_logger().warning(refusal)
        freeze_garbage()

    def end(self, error: FjrError) -> None:
        """Serve no further callback; for a callback."""
        self.ended = error
        self._round.set_result(None)

    def spin(self, stopped: list[int]) -> None:
        """Serve callbacks until a signal is in `stopped` or the node has ended."""
        executor, spin = self._executor()
        executor.add_node(self._node)
        try:
            while not stopped and self.ended is None and rclpy.ok():
                spin()
        except ExternalShutdownException:
            pass
        except FjrError as error:  # of a callback that the node does not know of, as an action's
            self.ended = error
        executor.remove_node(self._node)

    def _executor(self) -> tuple[Executor, Callable[[], None]]:
        """The executor that is asked for, or "single" where rclpy has no other, with a spin that ends within POLL.

        Without a time limit the events executor runs no callback and ignores signals in rclpy 7.1.6; a future kept
        from one spin to the next would collect callbacks.
        """
        if self._kind == "single" or EventsExecutor is None:
            single = SingleThreadedExecutor()
            return single, lambda: single.spin_once(timeout_sec=POLL)
        events = EventsExecutor()

        def spin() -> None:
            self._round = Future()
            events.spin_until_future_complete(self._round, POLL)

        return events, spin


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
