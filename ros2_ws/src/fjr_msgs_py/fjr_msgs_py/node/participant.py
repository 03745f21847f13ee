# SPDX-License-Identifier: Apache-2.0
"""Join the DDS domain before a node loads, so that other participants are discovered meanwhile, and leave it.

The participant belongs to a context: it is created with the first node and destroyed with the last. A hidden node,
which has no topics, stands in until the real one is built. Further contexts have participants of their own.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from threading import Event, Thread
from typing import TYPE_CHECKING, Any

import rclpy
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.signals import SignalHandlerOptions

from fjr_core.errors import FjrError

from .loading import ensure_log_folder, environment_fault, on_signals
from .scheduling import ahead_of_new_threads, step_back

if TYPE_CHECKING:
    from rclpy.node import Node

SOON, LATER = 0.2, 0.4
"""Time [s] in which a participant discovers the publishers of the others: if it hears their first answer, if not.

While more programs are busy than there are cores, the others answer later.
"""

CROWD = 10.0  # busy programs per core; more delay a start no further
CALLBACK_LIMIT = 10  # s; a discovery callback takes microseconds

_PARTICIPANT_OF = "_ZN16rmw_fastrtps_cpp22get_domain_participantEP10rmw_node_s"
_SET_LISTENER = (
    "_ZN8eprosima7fastdds3dds17DomainParticipant12set_listenerEPNS1_25DomainParticipantListenerE"
    "NSt6chrono8durationIlSt5ratioILl1ELl1EEEE"
)
"""rmw_fastrtps_cpp::get_domain_participant(node); DomainParticipant::set_listener(listener, std::chrono::seconds)."""
_LIBRARY, _SETTINGS = "libfastrtps.so.2.14", "_ZN8eprosima8fastrtps9xmlparser17XMLProfileManager16library_settingsEv"
"""XMLProfileManager::library_settings(): a pointer to the table of its class, then the delivery within a process."""

_initialised = False
_hidden: Any = None
_discovered_at: float | None = None


def join() -> None:
    """Initialise rclpy with the command line of the process, and join; signals leave and exit from then on.

    Fast DDS announces a participant before it listens, and another one on this machine answers at once: the answer is
    lost unless the thread that receives it waits meanwhile. Without it the other one is discovered at its next periodic
    announcement.
    An error is not reported here: the caller of `initialise`, or the first node, meets it again.
    """
    global _initialised, _hidden, _discovered_at
    if environment_fault():
        return
    with suppress(rclpy_implementation.RCLError):
        initialise(None)
        _initialised = True
        context = rclpy.get_default_context().handle
        with context, ahead_of_new_threads() as ahead:
            _hidden = rclpy_implementation.Node(f"_starting_{os.getpid()}", "/", context, None, False, False)
        _discovered_at = time.monotonic() + _crowd() * (SOON if ahead else LATER)
        on_signals(_exit)


def initialise(args: list[str] | None) -> None:
    """Initialise rclpy for the process, unless `join` has done so; args: command line, None: sys.argv.

    Raises FjrError for an invalid ROS_DOMAIN_ID.
    """
    if not _initialised:
        if fault := environment_fault():
            raise FjrError(fault)
        ensure_log_folder()
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)


def discovered_at() -> float:
    """Return the time [s, steady clock] from which on the publishers of others are known; without `join`, LATER."""
    return time.monotonic() + _crowd() * LATER if _discovered_at is None else _discovered_at


def _crowd() -> float:
    """Return the busy programs per core of the last minute, from 1 to CROWD."""
    return min(max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1)), CROWD)


def hand_over() -> None:
    """Destroy the hidden node; the participant remains if another node has been created."""
    global _hidden
    if _hidden is not None:
        _hidden.destroy_when_not_in_use()
        _hidden = None


@contextmanager
def own_node(name: str, arguments: list[str] | None = None, domain: int | None = None) -> Iterator[Node]:
    """Create a node in a context of its own, without signal handlers.

    arguments: as after --ros-args. domain: ROS domain; None: that of the environment.
    """
    context = rclpy.Context()
    ros = ["--ros-args", *arguments] if arguments else []  # None: sys.argv, where a:=b of --set is a remap rule
    rclpy.init(args=ros, context=context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = rclpy.create_node(name, context=context, enable_rosout=False, start_parameter_services=False)
        exchange_as_processes_do()
        try:
            yield node
        finally:
            leave(node)
    finally:
        context.try_shutdown()


class SeparateSubscription:
    """A subscription on a thread and in a participant of its own; both yield to loops.

    Fast DDS receives all messages of a participant on one thread per transport. This thread allocates a message, and
    waits while another thread copies it: 20 MB keep the states of the same participant waiting twice for 8 ms.
    """

    def __init__(self, node: Node, kind: type, topic: str, on_message: Callable[[bytes], object]) -> None:
        """on_message: called with each serialised message on the thread that spins `node`."""
        self._node, self._on_message, self._created = node, on_message, Event()
        self._thread = Thread(target=self._receive, args=(kind, node.resolve_topic_name(topic)), daemon=True)
        self._thread.start()
        self._created.wait()

    def close(self) -> None:
        """End the thread and leave the domain."""
        self._executor.context.try_shutdown()
        self._thread.join()

    def _receive(self, kind: type, topic: str) -> None:
        """Create the participant, whose threads inherit the scheduling of this one, and spin until `close`."""
        from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor  # loaded on use

        step_back(0)  # its threads also take locks for which loops wait
        name, space = f"_{self._node.get_name()}_inbox", self._node.get_namespace()
        with own_node(name, ["-r", f"__ns:={space}"], self._node.context.get_domain_id()) as inbox:
            self._subscription = inbox.create_subscription(kind, topic, self._forward, 10, raw=True)
            self._executor = SingleThreadedExecutor(context=inbox.context)
            self._executor.add_node(inbox)
            self._created.set()
            with suppress(ExternalShutdownException):
                self._executor.spin()
            self._executor.shutdown()

    def _forward(self, data: bytes) -> None:
        if self._node.executor is not None:
            self._node.executor.create_task(self._on_message, data)


def exchange_as_processes_do() -> None:
    """Let later participants of this process exchange messages as those of two processes do, whatever the DDS profile.

    Call it after the first participant was created, before another one is. With the delivery within a process Fast DDS
    2.14 runs callbacks of each in the other's thread, under the locks of both, and they may wait for each other forever
    (https://github.com/eProsima/Fast-DDS/issues/6193).
    """
    import ctypes  # loaded on use: a node starts sooner

    try:
        settings = ctypes.CDLL(_LIBRARY, os.RTLD_NOLOAD)[_SETTINGS]
    except (OSError, AttributeError):  # another middleware or another version of it
        return
    settings.restype = ctypes.c_void_p
    ctypes.c_int.from_address(settings() + ctypes.sizeof(ctypes.c_void_p)).value = 0  # INTRAPROCESS_OFF


def leave(node: Node) -> None:
    """Destroy the last node of a context, and with it the participant."""
    stop_discovery(node.handle)
    node.destroy_node()


def stop_discovery(handle: Any = None) -> None:
    """Let no discovery callback of a participant run from now on; its view of the graph stays as it is.

    handle: of any node of the participant; None: of the hidden node, if there is one.
    Fast DDS 2.14 waits for these callbacks when it destroys a participant. In the wheels this wait never ends: its
    limit, the largest time of the steady clock, overflows in the system clock, and pthread_cond_timedwait refuses such
    a time at once, without releasing the mutex with which the callback ends. A wait with a finite limit is sound. After
    it no callback is left to wait for.
    """
    handle = handle or _hidden
    if handle is None:
        return
    import ctypes  # loaded on use: a node starts sooner

    try:
        rcl, rmw = (ctypes.CDLL(f"lib{name}.so", os.RTLD_NOLOAD) for name in ("rcl", "rmw_fastrtps_cpp"))
        rmw_node, participant_of, set_listener = rcl.rcl_node_get_rmw_handle, rmw[_PARTICIPANT_OF], rmw[_SET_LISTENER]
    except (OSError, AttributeError):  # another middleware or another version of it
        return
    rmw_node.restype = participant_of.restype = ctypes.c_void_p
    with suppress(rclpy_implementation.InvalidHandle), handle:  # invalid: the node is destroyed
        node = rmw_node(ctypes.c_void_p(handle.pointer))
        participant = participant_of(ctypes.c_void_p(node)) if node else None
        if participant:
            set_listener(ctypes.c_void_p(participant), None, ctypes.c_long(CALLBACK_LIMIT))


def _exit(*_: object) -> None:
    """Leave the domain and end the process, which has nothing else to shut down while it loads."""
    stop_discovery()
    hand_over()
    rclpy.try_shutdown()
    os._exit(0)
