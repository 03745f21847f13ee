# SPDX-License-Identifier: Apache-2.0
"""Run a node as a process: errors in one sentence, signals that allow a last command, exit code.

An FjrError of a callback ends the node; a request or message that raises anything else is refused.
"""

from __future__ import annotations

import gc
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from typing import Any, ClassVar

import rclpy
import rclpy.exceptions
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.duration import Duration
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.task import Future

from fjr_core import FjrError
from fjr_core.config.process import NATIVE, process_settings

from ..names import STEADY
from . import participant
from .loading import index_modules, on_signals, resume_garbage_collection
from .scheduling import apply_process_settings, freeze_garbage, yield_to_loops

try:
    from rclpy.experimental.events_executor import EventsExecutor
except ImportError:  # an older rclpy of a ROS 2 Jazzy installation
    EventsExecutor = None

LONGEST = 500  # characters of a sentence about a request
POLL = 0.1  # s; longest delay of the response to a signal
ROUND = 60.0  # s; longest time in the events executor, each of which leaks a few bytes (rclpy 7.1.6)
COLLECTION = 1.0  # s; between two garbage collections
LAST_MESSAGES = 0.5  # s; in which a lost message is sent again ten times (config/fastdds.xml)


class EndingNode(Node):
    """Mixin of a node that ends if a callback of a timer, subscription or service raises an FjrError.

    Later callbacks then do nothing, and the process exits with the message of the error. No message and no request ends
    the node with another exception: it is refused with one sentence in the log. rclpy's own services and its
    subscription to /clock raise such exceptions, for example for a parameter of an unknown type.
    """

    values: dict[str, Any]
    process_arguments: ClassVar[Sequence[str]] = ()
    """The command line of the process, if rclpy.init received it."""
    in_process: ClassVar[bool] = False
    """Whether process.run runs the node; it then looks at `ended` itself."""
    host: NodeProcess | None = None
    """The process of the node, if it has one."""
    ended: FjrError | None = None
    """The error that ended the node."""
    over: Future
    """Done once the process of the node is to end."""
    unexpected: Exception | None = None
    """The latest exception that is no FjrError, of a message or a request."""

    def __init__(self, *arguments: Any, **keywords: Any) -> None:
        self.over = Future()
        super().__init__(*arguments, **keywords)

    def end(self, error: FjrError) -> None:
        """End the node: its process exits with the error, or the error is logged if the node has no process."""
        self.ended = error
        self.over.set_result(None)
        if not self.in_process:
            self.get_logger().error(f"ended: {error}")

    def stop(self) -> None:
        """Send the last messages before the process ends."""

    def built(self) -> None:
        """Report to the process that the objects of the callbacks are built; raises ParameterError."""
        if self.host is not None:
            self.host.apply_process_settings(self.values)

    def create_timer(self, seconds: float, callback: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """Create a timer as rclpy's Node does; an FjrError of the callback ends the node."""
        return super().create_timer(seconds, self._ending(callback), *args, **kwargs)

    def create_subscription(self, kind: Any, name: str, callback: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """Create a subscription as rclpy's Node does; an FjrError of the callback ends the node."""
        return super().create_subscription(kind, name, self._ending(callback, f"a message on {name}"), *args, **kwargs)

    def create_service(self, kind: Any, name: str, callback: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """Create a service as rclpy's Node does; an FjrError of the callback ends the node after the response."""
        return super().create_service(kind, name, self._ending(callback, f"a request to {name}"), *args, **kwargs)

    def guard_services(self) -> None:
        """Guard the services that rclpy creates by itself, lifecycle and type description; they outlive the end."""
        for service in self.services:
            service.callback = self._ending(service.callback, f"a request to {service.srv_name}", outlives=True)

    def _ending(self, callback: Callable[..., Any], what: str = "", outlives: bool = False) -> Callable[..., Any]:
        """Return a callback that ends the node by an FjrError; what: refuses, under this name, what raises another.

        outlives: call it after the end, too.
        """

        @wraps(callback)
        def call(*arguments: Any) -> Any:
            if outlives or self.ended is None:
                try:
                    return callback(*arguments)
                except FjrError as error:
                    self.end(error)
                except Exception as error:
                    if not what:
                        raise
                    self.unexpected = error
                    sentence = f"{what} was refused: {type(error).__name__}: {error}"[:LONGEST]
                    self.get_logger().error(sentence, throttle_duration_sec=1.0)
                    fill_refusal(*arguments, sentence=sentence)
            return arguments[-1] if arguments else None

        return call


def fill_refusal(request: Any, response: Any = None, *, sentence: str) -> None:
    """Fill the response of a service: not successful, with the reason; an entry for each parameter without result."""
    for field, value in (("success", False), ("message", sentence)):
        if hasattr(response, field):
            setattr(response, field, value)
    refused = SetParametersResult(successful=False, reason=sentence)
    if isinstance(response, SetParametersAtomically.Response):
        response.result = refused
    elif isinstance(response, SetParameters.Response):
        response.results += [refused] * (len(request.parameters) - len(response.results))


def run(make_node: Callable[[], EndingNode], args: list[str] | None = None) -> int:
    """Run a node until a signal ends it; return the exit code.

    Exit code 0: ended by a signal. 1: could not start, or ended by an FjrError; one sentence on standard error gives
    the reason. A started node always gets node.stop(); an unexpected exception then propagates to the caller.
    Exceptions of tasks of the events executor cannot be caught: rclpy 7.1.6 crashes, so a task must not raise.
    """
    stopped: list[int] = []
    on_signals(lambda received, _: stopped.append(received))
    node = None
    try:
        participant.initialise(args)
        index_modules()
        EndingNode.process_arguments = sys.argv if args is None else args
        EndingNode.in_process = True
        node = make_node()
        host = node.host = NodeProcess(node)
    except (FjrError, *_ROS_ERRORS) as error:
        why = "" if isinstance(error, FjrError) else "ROS 2 refused the arguments or the parameter file: "
        print(f"cannot start: {why}{' '.join(str(error).split())}", file=sys.stderr, flush=True)
        _end(node)
        return 1
    finally:
        EndingNode.process_arguments = ()
        participant.hand_over()
        resume_garbage_collection()
    try:
        host.spin(stopped)
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

    def __init__(self, node: EndingNode) -> None:
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


def _end(node: EndingNode | None) -> None:
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
