# SPDX-License-Identifier: Apache-2.0
"""The command loop as a native thread: a JointState in, an effort out, without Python. See controller_loop.h."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import nullcontext
from typing import Any

from numpy.typing import NDArray
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode
from sensor_msgs.msg import JointState

from fjr_core import FjrError, Measurement
from fjr_core.config.process import process_settings
from fjr_msgs_py import names
from fjr_msgs_py.messages.joint_states import StateReader
from fjr_msgs_py.native.entities import NativeReader, NativeSubscription, publisher_address
from fjr_msgs_py.native.loop import Loop
from fjr_msgs_py.native.ring import Ring
from fjr_msgs_py.node import process

from ..ros.certificate_diagnosis import CertificateDiagnosis
from ..ros.command_conflict import TOPICS, CommandConflictError, CommandTopics
from ..ros.command_loop import SILENCE_CHECKS, Listener
from ..ros.diagnostics import ANSWERED, RECEIVED, Reports
from ..tracking.events import State
from ..tracking.tracker import Tracker
from .certificate import NativeCertificate
from .messages import CommandMessages
from .owned_step import OwnedStep
from .program import controller_program, step_functions
from .records import changes, command_of, sample_of
from .refusals import Refusals

READING_PERIOD = 0.05  # s
READING_PERIOD_SIMULATED = 0.02  # s; simulated time stands still while the queue is full
RECORDS = 4096  # 4 s at 1 kHz
LOST = "samples not reported"
AT_ONCE = 1024  # records between two callbacks of other parts of the node
CALLBACKS = ("message", "tick", "request", "end")


class LoopError(FjrError):
    """The native command loop has ended by itself."""


class NativeCommandLoop:
    """The native sibling of CommandLoop; listeners and reports get each sample from a queue, a READING_PERIOD later.

    Raises NativeError if the loop cannot be built.
    """

    def __init__(
        self,
        node: LifecycleNode,
        joints: tuple[str, ...],
        tracker: Tracker,
        measurement: Measurement,
        reports: Reports,
        on_conflict: Callable[[CommandConflictError], None],
        auxiliary_period: float,
    ) -> None:
        """Build the loop, subscribe to the states and create the publishers of reference and tracking error.

        auxiliary_period [s]: least time between two messages on the topics for observers; 0: at every sample.
        """
        self._node, self._tracker, self._reports, self._on_conflict = node, tracker, reports, on_conflict
        self._simulated = bool(node.get_parameter("use_sim_time").value)
        step, n = tracker.step, len(joints)
        self._program = program = controller_program(n, len(step.memory))
        ffi = program.ffi
        self._controller = ffi.new("struct fjr_controller*")
        reader = StateReader(joints, measurement)
        fields = 0b001 | (0b100 if measurement.by_torque else 0) | (0 if measurement.observed else 0b010)
        self._reader = NativeReader(program, reader.names, fields)
        self._messages = CommandMessages(program, joints)
        self._refusals, self._ring = Refusals(program, reader, reports), Ring(program, "struct fjr_record", RECORDS)
        qos = names.sample_qos(node)
        self._references = node.create_publisher(JointState, names.REFERENCE, qos)
        self._errors = node.create_publisher(JointState, names.TRACKING_ERROR, qos)
        self._states = NativeSubscription(node, JointState, names.JOINT_STATES, names.LATEST)
        self._topic_names = [ffi.new("char[]", node.resolve_topic_name(topic).encode()) for topic in TOPICS]
        self._struct = ffi.new("struct fjr_controller_loop*", self._fields(auxiliary_period))
        callbacks = (ffi.addressof(program.lib, f"fjr_controller_{name}") for name in CALLBACKS)
        self._host = ffi.new("struct fjr_host*", (self._struct, *callbacks))
        self._loop = Loop(program, self._host, [self._states])
        self._struct.loop = self._loop.pointer
        self._step = OwnedStep(step, program, self._loop, self._controller)
        self._listeners: list[tuple[Listener, Callable[[], bool]]] = []
        self._certificate: NativeCertificate | None = None
        self._lost, self.active = 0, False

    def add_listener(self, listener: Listener, wants: Callable[[], bool] = lambda: True) -> None:
        """Call `listener` for each sample some time after its command was sent, while `wants()`."""
        self._listeners.append((listener, wants))

    def certify(self, diagnosis: CertificateDiagnosis) -> NativeCertificate:
        """Evaluate and publish the certificate of each sample from the next start on."""
        found = NativeCertificate(self._node, self._program, diagnosis)
        self._certificate, self._struct.certificate = found, found.pointer
        self._struct.certificates = publisher_address(self._program, found.publisher)
        self._struct.certified = found.message.pointer
        found.request = lambda gains, beta: self._recertify(gains, beta)
        return found

    def start(self, state_timeout: float, since: int = 0) -> None:
        """Publish commands from the next state on that arrives at `since` [ns, steady clock] or later.

        An earlier one is ignored: a conflicting publisher may not be discovered yet.
        Raise CommandConflictError if another process publishes on a command topic.
        """
        self._topics = CommandTopics(self._node, self._reports)
        struct = self._struct
        struct.efforts, struct.commands = (publisher_address(self._program, each) for each in self._topics.publishers)
        known, silent = self._topics.known
        self._known = self._program.ffi.from_buffer(known)
        struct.known, struct.silent = self._known, silent
        struct.alone, struct.sends, struct.since = self._program.lib.FJR_UNASKED, 0, since
        struct.silence_period = round(state_timeout / SILENCE_CHECKS * 1e9)
        struct.silence_check = time.monotonic_ns() + struct.silence_period
        self._state = State.WAITING
        self._step.lend()
        self._tracker.refresh, self._tracker.between_samples = self._step.read, self._step.between_samples
        publishers = [*self._topics.publishers, self._references, self._errors]
        if self._certificate is not None:
            publishers.append(self._certificate.publisher)
            self._certificate.restart()
        self._loop.use(publishers)
        self._loop.start(process_settings(self._node.values).priority)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        period = READING_PERIOD_SIMULATED if self._simulated else READING_PERIOD
        self._timers = [self._node.create_timer(period, self._read, clock=steady)]
        if self._simulated:
            clock = self._node.get_clock()
            self._timers.append(self._node.create_timer(state_timeout / SILENCE_CHECKS, self._on_silence, clock=clock))
        self.active = True

    def stop(self) -> None:
        """Publish the stop effort if a command was sent before, and end the command loop."""
        if not self.active:
            return
        self.active = False
        for timer in self._timers:
            self._node.destroy_timer(timer)
        self._loop.stop()
        self._step.send_stop()
        self._step.take_back()
        self._tracker.refresh, self._tracker.between_samples = None, nullcontext
        self._report()
        process.flush(*self._topics.publishers)
        self._topics.close()

    def close(self) -> None:
        """Destroy all subscriptions and publishers."""
        self.stop()
        self._loop.close()
        self._states.close()
        for publisher in (self._references, self._errors):
            self._node.destroy_publisher(publisher)

    def abandon(self) -> None:
        """End the thread, and destroy the subscriptions that the node does not know, before the node is destroyed."""
        self._loop.stop()
        self._states.close()
        if self.active:
            self._topics.end_search()

    def _fields(self, auxiliary_period: float) -> dict[str, Any]:
        """Return the fields of struct fjr_controller_loop that do not change."""
        step = self._tracker.step
        shared = {"model": step.model, "controller": self._controller, "copy": step.controller}
        return {
            "step": step_functions(self._program, step.library),
            **self._program.cast("struct fjr_controller_loop", shared),
            "reader": self._reader.pointer,
            "records": self._ring.pointer,
            "refusals": self._refusals.pointer,
            "references": publisher_address(self._program, self._references),
            "errors": publisher_address(self._program, self._errors),
            "node": self._program.ffi.cast("void*", self._node.handle.pointer),
            "topic": self._topic_names,
            "simulated": self._simulated,
            "auxiliary": (round(auxiliary_period * 1e9), 0),
            **self._messages.pointers,
        }

    def _recertify(self, gains: Any, beta: Any) -> None:
        """Let the thread use other gains for the certificate; records with those before are read first."""
        if self.active:
            self._step.read()
            self._report()
        self._step.request("FJR_RECERTIFY", gains, beta)

    def _on_silence(self) -> None:
        self._step.check_silence(self._node.get_clock().now().nanoseconds)

    def _read(self) -> None:
        """Read the queue; end the node if the loop has ended by itself."""
        runs = self._loop.runs  # before its last records are read
        self._step.read()
        self._report()
        if not runs and self.active:
            raise LoopError(f"the native command loop failed: {self._loop.reason}; the stop effort was sent")
        if self.active:
            self._resolve_doubt()

    def _resolve_doubt(self) -> None:
        """Listen to publishers that the thread found before the first command: deactivate, or let it answer."""
        lib, struct = self._program.lib, self._struct
        try:
            if struct.alone == lib.FJR_NOT_ALONE:
                self._topics.check_alone()
                struct.alone = lib.FJR_ALONE
            if struct.alone == lib.FJR_ALONE:
                self._topics.end_search()
        except CommandConflictError as error:
            self._on_conflict(error)

    def _report(self) -> None:
        """Report refused messages, records, events and counters; all records once the thread has ended."""
        self._refusals.report()
        while len(records := self._ring.take(AT_ONCE)):
            self._on_records(records)
            if self._loop.runs:  # other callbacks of the node come first; in simulated time the thread waits
                break
        if self._ring.lost > self._lost:
            self._lost = self._ring.lost
            self._reports.warn(LOST, "samples were not reported: the process of the node has too little time")
            self._reports.count[LOST] = self._lost
        self._reports.count[RECEIVED] = self._struct.received
        self._reports.count[ANSWERED] = self._struct.answered
        self._tracker.read_events()
        if self._tracker.events:
            self._reports.publish_events()

    def _on_records(self, records: NDArray[Any]) -> None:
        """Process records; a report by their stamps covers all up to its own and none after it."""
        start = 0
        for k, stamp in enumerate(records["sample"]["stamp"].tolist() if self._simulated else (), start=1):
            if self._reports.due(stamp) or k == len(records):
                self._process(records[start:k])
                self._reports.at(stamp)
                start = k
        self._process(records[start:])

    def _process(self, records: NDArray[Any]) -> None:
        if not len(records):
            return
        if self._certificate is not None:
            self._certificate.on_records(records)
        listeners = [listener for listener, wants in self._listeners if wants()]
        for record in records if listeners else ():
            sample, command = sample_of(record), command_of(record)
            for listener in listeners:
                listener(sample, command, int(record["arrival"]), int(record["sent"]))
        for state in changes(records["command"]["state"], self._state):
            self._state = state
            if state is State.TRACKING:
                self._reports.announce("tracking", "tracking: the effort is the law's own")
