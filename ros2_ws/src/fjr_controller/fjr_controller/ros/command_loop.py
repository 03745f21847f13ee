# SPDX-License-Identifier: Apache-2.0
"""The command loop of an active controller: a JointState in, an effort out."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from fjr_core import FjrError
from fjr_core.numerics.checks import Array
from fjr_msgs_py import names
from fjr_msgs_py.messages.cdr.readers import SerialisedStates
from fjr_msgs_py.messages.joint_states import EffortWriter, JointSample, JointStateWriter, MessageError, StateReader
from fjr_msgs_py.node import process
from fjr_msgs_py.node.conflicting_publishers import ConflictingPublishers

from ..tracking.events import Event, State
from ..tracking.tracker import Command, Tracker
from .diagnostics import ANSWERED, RECEIVED, Reports

TOPICS = {names.EFFORT_COMMANDS: Float64MultiArray, names.JOINT_COMMANDS: JointState}
CONFLICTS = "other controllers"
ALONE = "expected nobody else to command the robot"
LOOK_PERIOD = 0.5  # s
SILENCE_CHECKS = 10  # per state_timeout

Listener = Callable[[JointSample, Command, int, int], None]
"""Callback with a sample, its command, and the times of arrival and of sending [ns, steady clock]."""


class CommandConflictError(FjrError):
    """Another process publishes on a command topic."""


class CommandLoop:
    """Publish a command on both command topics for each state from `start` to `stop`; otherwise nothing.

    Conflicting publishers on either topic are detected at the start, at the first state and every LOOK_PERIOD. One that
    publishes before the first command triggers `on_conflict`; a later one is reported.
    """

    def __init__(
        self,
        node: LifecycleNode,
        joints: tuple[str, ...],
        tracker: Tracker,
        reader: StateReader,
        reports: Reports,
        on_conflict: Callable[[CommandConflictError], None],
    ) -> None:
        """Subscribe to the states; create the publishers of reference and tracking error."""
        self._node, self._tracker, self._reports = node, tracker, reports
        self._reader = SerialisedStates(reader)
        self._on_conflict = on_conflict
        self._n = len(joints)
        self._simulated = bool(node.get_parameter("use_sim_time").value)
        self._effort, self._command = EffortWriter(joints), JointStateWriter(joints)
        self._reference, self._error = JointStateWriter(joints), JointStateWriter(joints)
        self._references = node.create_publisher(JointState, names.REFERENCE, names.LATEST)
        self._errors = node.create_publisher(JointState, names.TRACKING_ERROR, names.LATEST)
        self._states = node.create_subscription(JointState, names.JOINT_STATES, self._on_state, names.LATEST, raw=True)
        self._listeners: list[Listener] = []
        self.active = False

    def add_listener(self, listener: Listener) -> None:
        """Call `listener` for each sample, after its command was sent."""
        self._listeners.append(listener)

    def start(self, state_timeout: float) -> None:
        """Publish commands from the next state on.

        Raise CommandConflictError if another process publishes on a command topic.
        """
        self._conflicts = ConflictingPublishers(self._node, TOPICS, names.LATEST)
        try:
            self._refuse_conflicts()
        except CommandConflictError:
            self._conflicts.close()
            raise
        self._efforts, self._commands = self._conflicts.publishers
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        own_time = self._node.get_clock() if self._simulated else steady
        period = state_timeout / SILENCE_CHECKS
        self._timers = [
            self._node.create_timer(period, self._on_silence, clock=own_time),
            self._node.create_timer(LOOK_PERIOD, self._look_for_conflicts, clock=steady),
        ]
        self._last_stamp: int | None = None
        self._alone = False
        self._state = State.WAITING
        self.active = True

    def stop(self) -> None:
        """Publish the stop effort if a command was sent before, and end the command loop."""
        if not self.active:
            return
        self.active = False
        for timer in self._timers:
            self._node.destroy_timer(timer)
        if self._last_stamp is not None:
            self._send(self._last_stamp, self._tracker.stop_effort())
        self._reports.publish_events()
        process.flush(self._efforts, self._commands)
        self._conflicts.close()

    def close(self) -> None:
        """Destroy all subscriptions and publishers."""
        self.stop()
        self._node.destroy_subscription(self._states)
        for publisher in (self._references, self._errors):
            self._node.destroy_publisher(publisher)

    def _on_state(self, message: bytes) -> None:
        if not self.active:
            return
        try:
            self._process(message, time.monotonic_ns())
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
        command = self._tracker.command(sample, arrival)
        if command is not None:
            self._publish(sample, command, arrival)
        if self._tracker.events:
            self._reports.publish_events()
        self._reports.at(sample.stamp)

    def _publish(self, sample: JointSample, command: Command, arrival: int) -> None:
        self._send(sample.stamp, command.u)
        sent = time.monotonic_ns()
        self._last_stamp = sample.stamp
        self._reports.count[ANSWERED] += 1
        q_ld, dq_ld = command.jets[0], command.jets[1]
        self._references.publish(self._reference.fill(sample.stamp, q_ld, dq_ld))
        q_tilde_l, dq_tilde_l = sample.q_l - q_ld, command.velocity[: self._n] - dq_ld
        self._errors.publish(self._error.fill(sample.stamp, q_tilde_l, dq_tilde_l))
        if command.state is not self._state:
            self._state = command.state
            if command.state is State.TRACKING:
                self._reports.announce("tracking", "tracking: the effort is the law's own")
        for listener in self._listeners:
            listener(sample, command, arrival, sent)

    def _send(self, stamp: int, u: Array) -> None:
        if self._simulated:  # lock-step waits for this message
            self._commands.publish(self._command.fill(stamp, effort=u))
        self._efforts.publish(self._effort.fill(u))
        if not self._simulated:
            self._commands.publish(self._command.fill(stamp, effort=u))

    def _on_silence(self) -> None:
        now = self._node.get_clock().now().nanoseconds if self._simulated else time.monotonic_ns()
        self._check_silence(now)
        self._reports.publish_events()

    def _check_silence(self, now: int) -> None:
        """Send the stop effort once per silence; now [ns]: by the stamps in simulated time, else steady."""
        u = self._tracker.silence(now)
        if u is not None and self._last_stamp is not None:
            self._send(self._last_stamp, u)

    def _is_alone(self) -> bool:
        """Detect conflicting publishers before the first command; return False if the state is too old after that."""
        self._alone = True
        try:
            listened = self._refuse_conflicts()
        except CommandConflictError as error:
            self._on_conflict(error)
            return False
        self._conflicts.trust()
        return not listened

    def _refuse_conflicts(self) -> bool:
        """Return True if other publishers exist but are silent (a killed node).

        Raise CommandConflictError if one publishes.
        """
        appeared = self._conflicts.appeared()
        heard = self._conflicts.heard() if appeared else None
        if heard:
            raise CommandConflictError(f"{self._conflicts.named(heard[0])} publishes on {heard[0]}; {ALONE}")
        return bool(appeared)

    def _look_for_conflicts(self) -> None:
        topics = self._conflicts.appeared() if self._alone else ()
        if topics:
            named = self._conflicts.named(*topics)
            sentence = f"{named} has begun to publish on {' and '.join(topics)}; {ALONE}"
            self._reports.event(Event("error", CONFLICTS, sentence, {"nodes": named}))
