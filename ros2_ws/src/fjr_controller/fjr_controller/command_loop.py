# SPDX-License-Identifier: Apache-2.0
"""The command loop of an active controller: a JointState in, an effort out, in the C of native/controller_loop.c.

The command topics have one owner: another process that commands the robot is looked for before and after the start.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from fjr_core import FjrError, Measurement
from fjr_core.config.controller import auxiliary_period, contact_observer
from fjr_core.config.process import NATIVE, process_settings
from fjr_core.model.joints import JointSample
from fjr_core.monitoring.external_torque import TorqueObserverStruct
from fjr_core.runtime.control_step import Command, ControlStep
from fjr_core.runtime.events import STATES, Event, State, joints_of
from fjr_msgs_py import names
from fjr_msgs_py.messages.cdr import float_array, joint_state
from fjr_msgs_py.messages.joint_states import SECOND, StateReader, deserialised
from fjr_msgs_py.native.loop import NativeMessage, NativeReader, Ring
from fjr_msgs_py.native.program import NativeError
from fjr_msgs_py.node import process
from fjr_msgs_py.node.conflicting_publishers import ConflictingPublishers
from fjr_msgs_py.node.reports import Refusals

from .certificate import LiveCertificate
from .host import NativeControllerHost, RclpyControllerHost
from .native import controller_program, step_functions
from .reports import ANSWERED, RECEIVED, Reports

SILENCE_CHECKS = 10  # per state_timeout
READING_PERIOD = 0.05  # s
READING_PERIOD_SIMULATED = 0.02  # s; simulated time stands still while the queue is full
RECORDS = 4096  # 4 s at 1 kHz
LOST, NO_CLOCK = "samples not reported", "no clock"
AT_ONCE = 1024  # records between two callbacks of other parts of the node
TIMELESS = 200  # answered states, after which simulated time must have begun
IN_PYTHON = "the law or the observer is evaluated in Python (compile is false, or a law of one's own)"
TOPICS = {names.EFFORT_COMMANDS: Float64MultiArray, names.JOINT_COMMANDS: JointState}
CONFLICTS = "other controllers"
ALONE = "expected nobody else to command the robot"
LOOK_PERIOD = 0.5  # s

Listener = Callable[[JointSample, Command], None]


class LoopError(FjrError):
    """The command loop has ended by itself."""


class CommandConflictError(FjrError):
    """Another process publishes on a command topic."""


class CommandTopics(ConflictingPublishers):
    """The publishers of both command topics (efforts, commands), and the search for conflicting ones.

    The search takes place at the start, before the first command and every LOOK_PERIOD after it. A conflict before the
    first command is an error; a later one is reported.
    """

    def __init__(self, node: Node, reports: Reports) -> None:
        """Create the publishers; raise CommandConflictError if another process publishes on a command topic."""
        super().__init__(node, TOPICS, names.sample_qos(node))
        self._reports, self._alone = reports, False
        self._timer = node.create_timer(LOOK_PERIOD, self._look, clock=names.STEADY)
        try:
            self.check_alone()
        except CommandConflictError:
            self.close()
            raise

    def check_alone(self) -> None:
        """Raise CommandConflictError if a publisher that has appeared is not silent, as that of a killed node is."""
        heard = self.heard() if self.appeared() else None
        if heard:
            raise CommandConflictError(f"{self.named(heard[0])} publishes on {heard[0]}; {ALONE}")

    def end_search(self) -> None:
        """Destroy the subscriptions of the search, which the node does not know; from now on conflicts are reported."""
        self._alone = True
        self.trust()

    def close(self) -> None:
        """Destroy publishers, subscriptions and timer."""
        self._node.destroy_timer(self._timer)
        super().close()

    def _look(self) -> None:
        topics = self.appeared() if self._alone else ()
        if topics:
            named = self.named(*topics)
            sentence = f"{named} has begun to publish on {' and '.join(topics)}; {ALONE}"
            self._reports.event(Event("error", CONFLICTS, sentence, {"nodes": named}))


class CommandLoop:
    """Publish a command on both command topics for each state from `start` to `stop`; otherwise nothing.

    While it is active, it owns the controller, and that of `step` is a copy. Listeners and reports get each sample
    from a queue, a READING_PERIOD later. A conflicting publisher (see CommandTopics) that is found at the first state
    triggers `on_conflict`. program: the compiled loop.
    """

    def __init__(
        self,
        node: LifecycleNode,
        step: ControlStep,
        measurement: Measurement,
        reports: Reports,
        on_conflict: Callable[[CommandConflictError], None],
    ) -> None:
        """Build the loop, subscribe to the states and create the publishers of all but commands and certificate."""
        self._node, self._reports, self._on_conflict, self._controls = node, reports, on_conflict, step
        self._simulated = bool(node.get_parameter("use_sim_time").value)
        joints = node.values["joints"]
        n, qos = len(joints), names.sample_qos(node)
        self.program = program = controller_program(n, len(step.memory))
        self._controller = program.ffi.new("struct fjr_controller*")
        reader = StateReader(joints, measurement)
        fields = 0b001 | (0b100 if measurement.by_torque else 0) | (0 if measurement.observed else 0b010)
        self._reader = NativeReader(program, reader.names, fields)
        efforts, moving = joint_state(joints, (0, 0, n)), joint_state(joints, (n, n, 0))
        forms = {
            "effort": float_array(",".join(joints), n),
            **dict.fromkeys(("command", "torque"), efforts),
            **dict.fromkeys(("reference", "error"), moving),
            "contact": joint_state(names.contact_names(joints), (0, 0, 2 * n)),
        }
        self._messages = {name: NativeMessage(program, form) for name, form in forms.items()}
        self._observer = TorqueObserverStruct(program.ffi, contact_observer(node.values, step.law.robot))
        self._refusals = Refusals(
            program, "state", lambda data: reader.read(deserialised(data, JointState)), reports.announce
        )
        reports.add_counters(self._refusals.report)
        self._ring = Ring(program, "struct fjr_record", RECORDS)
        shared = {"model": step.model, "controller": self._controller, "copy": step.controller}
        given = {
            **program.cast("struct fjr_controller_loop", shared),
            **{name: message.pointer for name, message in self._messages.items()},
            "step": step_functions(program, step.library),
            "reader": self._reader.pointer,
            "records": self._ring.pointer,
            "refusals": self._refusals.pointer,
            "observer": self._observer.pointer,
            "simulated": self._simulated,
            "auxiliary": (round(auxiliary_period(node.values, self._simulated) * 1e9), 0),
        }
        self._struct = program.ffi.new("struct fjr_controller_loop*", given)
        topics = (names.REFERENCE, names.TRACKING_ERROR, names.EXTERNAL_TORQUE, names.CONTACT_TORQUE)
        self._publishers = self._own = [node.create_publisher(JointState, topic, qos) for topic in topics]
        self._host = self._chosen_host()
        self._listeners: list[tuple[Listener, Callable[[], bool]]] = []
        self._certificate: LiveCertificate | None = None
        self._lost, self.active = 0, False

    def _chosen_host(self) -> NativeControllerHost | RclpyControllerHost:
        """Return the host of the parameter `executor`; log the reason if it is another one than wanted."""
        if self._node.values["executor"] == NATIVE:
            why = self.program.without_thread if self._controls.in_c else IN_PYTHON
            try:
                if not why:
                    return NativeControllerHost(self._node, self.program, self._struct)
            except NativeError as error:
                why = str(error)
            self._node.get_logger().info(f"the command loop runs in rclpy's executor instead of a native thread: {why}")
        return RclpyControllerHost(self._node, self.program, self._struct, self._controls.raise_failure, self._drain)

    @property
    def native(self) -> bool:
        """Whether a native thread answers the states."""
        return isinstance(self._host, NativeControllerHost)

    def add_listener(self, listener: Listener, wants: Callable[[], bool] = lambda: True) -> None:
        """Call `listener` for each sample some time after its command was sent, while `wants()`."""
        self._listeners.append((listener, wants))

    def certify(self, certificate: LiveCertificate) -> None:
        """Evaluate and publish the certificate of each sample from the next start on."""
        self._certificate, certificate.recertify, certificate.touched = certificate, self._recertify, self._touched
        self._struct.certificate, self._struct.certified = certificate.pointer, certificate.message
        self._publishers = [*self._own, certificate.publisher]

    def start(self, state_timeout: float, since: int = 0) -> None:
        """Publish commands from the next state on that arrives at `since` [ns, steady clock] or later.

        An earlier one is ignored: a conflicting publisher may not be discovered yet.
        Raise CommandConflictError if another process publishes on a command topic.
        """
        self._topics = CommandTopics(self._node, self._reports)
        struct, ffi = self._struct, self.program.ffi
        struct.alone, struct.sends, struct.since = self.program.lib.FJR_UNASKED, 0, since
        struct.silence_period = round(state_timeout / SILENCE_CHECKS * 1e9)
        struct.silence_check = time.monotonic_ns() + struct.silence_period
        struct.reason = ffi.NULL
        self._state = State.WAITING
        ffi.memmove(self._controller, self._controls.controller, ffi.sizeof("struct fjr_controller"))
        self._controls.owner = self
        if self._certificate is not None:
            self._certificate.restart()
        self._host.use([*self._topics.publishers, *self._publishers])
        self._host.serve(self._topics, process_settings(self._node.values).priority)
        period = READING_PERIOD_SIMULATED if self._simulated else READING_PERIOD
        self._timers = [self._node.create_timer(period, self._poll, clock=names.STEADY)]
        if self._simulated:
            clock, period = self._node.get_clock(), state_timeout / SILENCE_CHECKS
            self._timers.append(
                self._node.create_timer(
                    period, lambda: self.change("check_silence", time=clock.now().nanoseconds), clock=clock
                )
            )
        self.active = True

    def stop(self) -> None:
        """Publish the stop effort if a command was sent before, and end the command loop."""
        if not self.active:
            return
        self.active = False
        for timer in self._timers:
            self._node.destroy_timer(timer)
        self._host.stop()
        self.change("send_stop")
        self._controls.owner = None
        self._drain()
        process.flush(*self._topics.publishers)
        self._topics.close()

    def close(self) -> None:
        """Destroy all subscriptions and publishers; an active loop sends nothing more."""
        self._host.close()
        if self.active:
            self._topics.close()
        for publisher in self._own:
            self._node.destroy_publisher(publisher)

    # The owner of the controller.

    def change(self, what: str, *pointers: Any, time: int = 0) -> None:
        """Let the host serve the request FJR_DO_WHAT between two samples, such as fjr_WHAT of step.h; wait for it."""
        ffi = self.program.ffi
        first, second, *_ = (*pointers, ffi.NULL, ffi.NULL)
        arguments = ffi.new("struct fjr_arguments*", (first, second, time))
        self._host.request(getattr(self.program.lib, f"FJR_DO_{what.upper()}"), arguments)

    def copy(self) -> None:
        """Bring the controller of the step up to date."""
        self.change("copy")

    @contextmanager
    def between_samples(self) -> Iterator[None]:
        """Let states wait until the end of the block, with the controller of the step up to date."""
        self._host.hold(True)
        try:
            self.copy()
            yield
        finally:
            self._host.hold(False)

    def _recertify(self, gains: Any, beta: Any) -> None:
        """Let the loop use another beta, and other gains unless NULL; records with those before are read first."""
        if self.active and gains:
            self.read()
        self.change("recertify", gains, beta)

    def _touched(self) -> list[str]:
        """Return the joints of a contact in the last second."""
        found = self._controls.controller.contact
        recent = found.acting or 0 <= self._observer.pointer.stamp - found.stamp < SECOND
        return joints_of(found.joints, self._node.values["joints"]) if recent else []

    # What Python reads.

    def read(self) -> None:
        """Report what has come so far, with the samples that were answered."""
        self.copy()
        self._drain()

    def _poll(self) -> None:
        """Read the queue; end the node if the loop has ended by itself."""
        runs = self._host.runs  # before its last records are read
        self.read()
        if not runs and self.active:
            if isinstance(self._host.reason, BaseException):
                raise self._host.reason
            raise LoopError(f"the {self._host.name} failed: {self._host.reason}; the stop effort was sent")
        if self.active:
            self._settle_conflict()

    def _settle_conflict(self) -> None:
        """If another publisher was found before the first command: deactivate; if none is left, let the loop answer."""
        lib, struct = self.program.lib, self._struct
        try:
            if struct.alone == lib.FJR_NOT_ALONE:
                self._topics.check_alone()
                struct.alone = lib.FJR_ALONE
            if struct.alone == lib.FJR_ALONE:
                self._topics.end_search()
        except CommandConflictError as error:
            self._on_conflict(error)

    def _drain(self) -> None:
        """Report refused messages, records, events and counters; all records once the loop has ended."""
        self._refusals.report()
        while len(records := self._ring.take(AT_ONCE)):
            self._process_by_stamp(records)
            if self._host.runs:  # other callbacks of the node come first; in simulated time the loop waits
                break
        if self._ring.lost > self._lost:
            self._lost = self._ring.lost
            self._reports.note("warn", LOST, "samples were not reported: the process of the node has too little time")
            self._reports.count[LOST] = self._lost
        if self._simulated and self._struct.answered > TIMELESS and not self._node.get_clock().now().nanoseconds:
            sentence = "use_sim_time is true, but no time comes on /clock: silences are not noticed"
            self._reports.say("warn", NO_CLOCK, sentence)
        self._reports.count[RECEIVED] = self._struct.received
        self._reports.count[ANSWERED] = self._struct.answered
        self._reports.publish_events()

    def _process_by_stamp(self, records: NDArray[Any]) -> None:
        """Process records in the order of their stamps; a report covers those up to its own time and none after it."""
        start = 0
        for k, stamp in enumerate(records["sample"]["stamp"].tolist() if self._simulated else (), start=1):
            if self._reports.due(stamp) or k == len(records):
                self._process(records[start:k])
                self._reports.at(stamp)
                start = k
        self._process(records[start:])

    def _process(self, records: NDArray[Any]) -> None:
        """Pass records to certificate and listeners; announce that the controller tracks."""
        if not len(records):
            return
        if self._certificate is not None:
            self._certificate.on_records(records)
        listeners = [listener for listener, wants in self._listeners if wants()]
        for record in records if listeners else ():
            sample, command = _sample_of(record), Command.of(record["command"])
            for listener in listeners:
                listener(sample, command)
        states = records["command"]["state"]
        last = np.append(STATES.index(self._state), states[:-1])
        for state in states[states != last].tolist():
            self._state = STATES[state]
            if self._state is State.TRACKING:
                self._reports.announce("info", "tracking", "tracking: the effort is the law's own")


def _sample_of(record: Any) -> JointSample:
    """Return the sample of a struct fjr_record, with the motor position that the law was evaluated at."""
    sample = record["sample"]
    return JointSample(int(sample["stamp"]), sample["link"], record["command"]["position"][len(sample["link"]) :])
