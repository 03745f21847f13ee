# SPDX-License-Identifier: Apache-2.0
"""The command loop of an active controller: a JointState in, an effort out."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode
from sensor_msgs.msg import JointState

from fjr_core.numerics.checks import Array
from fjr_core.runtime.control_step import NEVER
from fjr_msgs_py import names
from fjr_msgs_py.messages.cdr.readers import SerialisedStates
from fjr_msgs_py.messages.joint_states import EffortWriter, JointSample, JointStateWriter, MessageError, StateReader
from fjr_msgs_py.node import process

from ..tracking.events import State
from ..tracking.tracker import Command, Tracker
from .certificate_diagnosis import CertificateDiagnosis
from .certificate_publisher import CertificatePublisher
from .command_conflict import CommandConflictError, CommandTopics
from .diagnostics import ANSWERED, RECEIVED, Reports

SILENCE_CHECKS = 10  # per state_timeout
PAUSED = 10_000_000  # ns; a silence check that comes later follows a pause of this process
WAITING = 0.005  # s; a state that waits for a newer one comes again after this time

Listener = Callable[[JointSample, Command, int, int], None]
"""Callback with a sample, its command, and the times of arrival and of sending [ns, steady clock]."""


class CommandLoop:
    """Publish a command on both command topics for each state from `start` to `stop`; otherwise nothing.

    A conflicting publisher (see CommandTopics) that is found at the first state triggers `on_conflict`.
    """

    def __init__(
        self,
        node: LifecycleNode,
        joints: tuple[str, ...],
        tracker: Tracker,
        reader: StateReader,
        reports: Reports,
        on_conflict: Callable[[CommandConflictError], None],
        auxiliary_period: float,
    ) -> None:
        """Subscribe to the states; create the publishers of reference and tracking error.

        auxiliary_period [s]: time between two messages of these; 0: one per sample.
        """
        self._node, self._tracker, self._reports = node, tracker, reports
        self._reader = SerialisedStates(reader)
        self._on_conflict, self._step = on_conflict, tracker.step
        grid = (round(auxiliary_period * 1e9), 0)
        self._auxiliary, self._due = self._step.ffi.new("struct fjr_auxiliary_rate*", grid), True
        self._n = len(joints)
        self._simulated = bool(node.get_parameter("use_sim_time").value)
        self._effort, self._command = EffortWriter(joints), JointStateWriter(joints)
        self._reference, self._error = JointStateWriter(joints), JointStateWriter(joints)
        qos = names.sample_qos(node)
        self._references = node.create_publisher(JointState, names.REFERENCE, qos)
        self._errors = node.create_publisher(JointState, names.TRACKING_ERROR, qos)
        self._states = node.create_subscription(JointState, names.JOINT_STATES, self._on_state, names.LATEST, raw=True)
        self._listeners: list[tuple[Listener, Callable[[], bool]]] = []
        self.active = False

    def add_listener(self, listener: Listener, wants: Callable[[], bool] = lambda: True) -> None:
        """Call `listener` for each sample after its command was sent, while `wants()`."""
        self._listeners.append((listener, wants))

    def certify(self, diagnosis: CertificateDiagnosis) -> CertificatePublisher:
        """Evaluate and publish the certificate of each sample."""
        publisher = CertificatePublisher(self._node, diagnosis, lambda: self._due)
        self.add_listener(publisher.on_command)
        return publisher

    def start(self, state_timeout: float, since: int = 0) -> None:
        """Publish commands from the next state on that arrives at `since` [ns, steady clock] or later.

        An earlier one is ignored: a conflicting publisher may not be discovered yet.
        Raise CommandConflictError if another process publishes on a command topic.
        """
        self._topics = CommandTopics(self._node, self._reports)
        self._efforts, self._commands = self._topics.publishers
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        own_time = self._node.get_clock() if self._simulated else steady
        self._timer = self._node.create_timer(state_timeout / SILENCE_CHECKS, self._on_silence, clock=own_time)
        self._waiting = self._node.create_timer(WAITING, self._on_no_newer, clock=steady)
        self._waiting.cancel()
        self._last_stamp: int | None = None
        self._due_at = time.monotonic_ns() + round(state_timeout / SILENCE_CHECKS * 1e9)
        self._since, self._alone = since, False
        self._state = State.WAITING
        self.active = True

    def stop(self) -> None:
        """Publish the stop effort if a command was sent before, and end the command loop."""
        if not self.active:
            return
        self.active = False
        for timer in (self._timer, self._waiting):
            self._node.destroy_timer(timer)
        if self._last_stamp is not None:
            self._send(self._last_stamp, self._tracker.stop_effort())
        self._reports.publish_events()
        process.flush(self._efforts, self._commands)
        self._topics.close()

    def close(self) -> None:
        """Destroy all subscriptions and publishers."""
        self.stop()
        self._node.destroy_subscription(self._states)
        for publisher in (self._references, self._errors):
            self._node.destroy_publisher(publisher)

    def abandon(self) -> None:
        """Destroy the subscriptions that the node does not know, before the node is destroyed."""
        if self.active:
            self._topics.end_search()

    def _on_state(self, message: bytes) -> None:
        arrival = time.monotonic_ns()
        if not self.active or arrival < self._since:
            return
        try:
            self._process(message, arrival)
        except Exception:
            self.stop()  # after any error: the robot must not keep the last effort
            raise

    def _process(self, message: bytes, arrival: int) -> None:
        self._reports.count[RECEIVED] += 1
        try:
            sample = self._reader.read(message)
        except MessageError as error:
            self._reports.refuse("state", error)
            return
        if not (self._alone or self._is_alone()):
            return
        if self._simulated:  # the command must not depend on the order of clock and state
            self._check_silence(sample.stamp)
        self._answer(sample, arrival)
        self._reports.at(sample.stamp)

    def _answer(self, sample: JointSample, arrival: int) -> None:
        """Publish the command for a sample; one that waits for a newer one comes again."""
        command = self._tracker.command(sample, arrival)
        if command is not None:
            self._publish(sample, command, arrival)
        elif self._step.lib.fjr_waits_until(self._step.controller) != NEVER:
            self._waits = sample
            self._waiting.reset()
        if self._tracker.events:
            self._reports.publish_events()

    def _on_no_newer(self) -> None:
        """Answer a state for which no newer one has come."""
        self._waiting.cancel()
        if self._step.lib.fjr_waits_until(self._step.controller) != NEVER:
            self._answer(self._waits, time.monotonic_ns())

    def _publish(self, sample: JointSample, command: Command, arrival: int) -> None:
        self._send(sample.stamp, command.u)
        sent = time.monotonic_ns()
        self._last_stamp = sample.stamp
        self._reports.count[ANSWERED] += 1
        self._due = bool(self._step.lib.fjr_is_due(self._auxiliary, sample.stamp))
        if self._due:
            self._publish_auxiliary(sample, command)
        if command.state is not self._state:
            self._state = command.state
            if command.state is State.TRACKING:
                self._reports.announce("tracking", "tracking: the effort is the law's own")
        self._tracker.check_wiring()
        for listener, wants in self._listeners:
            if wants():
                listener(sample, command, arrival, sent)

    def _publish_auxiliary(self, sample: JointSample, command: Command) -> None:
        q_ld, dq_ld = command.jets[0], command.jets[1]
        self._references.publish(self._reference.fill(sample.stamp, q_ld, dq_ld))
        q_tilde_l, dq_tilde_l = sample.q_l - q_ld, command.velocity[: self._n] - dq_ld
        self._errors.publish(self._error.fill(sample.stamp, q_tilde_l, dq_tilde_l))

    def _send(self, stamp: int, u: Array) -> None:
        if self._simulated:  # lock-step waits for this message
            self._commands.publish(self._command.fill(stamp, effort=u))
        self._efforts.publish(self._effort.fill(u))
        if not self._simulated:
            self._commands.publish(self._command.fill(stamp, effort=u))

    def _on_silence(self) -> None:
        now = time.monotonic_ns()
        late, self._due_at = now - self._due_at, now + self._timer.timer_period_ns
        if self._simulated:
            self._check_silence(self._node.get_clock().now().nanoseconds)
        elif late <= PAUSED:  # else states may wait: this process was paused
            self._check_silence(now)
        self._reports.publish_events()

    def _check_silence(self, now: int) -> None:
        """Send the stop effort once per silence; now [ns]: by the stamps in simulated time, else steady."""
        u = self._tracker.silence(now)
        if u is not None and self._last_stamp is not None:
            self._send(self._last_stamp, u)

    def _is_alone(self) -> bool:
        """Search for conflicting publishers before the first command; return False if the state is too old now."""
        self._alone = True
        try:
            found = self._topics.check_alone()
            self._topics.end_search()
            return found
        except CommandConflictError as error:
            self._on_conflict(error)
            return False
