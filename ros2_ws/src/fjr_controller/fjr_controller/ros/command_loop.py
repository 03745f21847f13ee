# SPDX-License-Identifier: Apache-2.0
"""The way from a JointState to an effort, while the controller is active."""

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
from fjr_msgs_py.node.conflicting_publishers import Rivals

from ..tracking.events import Event, State
from ..tracking.tracker import Command, Tracker
from .diagnostics import ANSWERED, RECEIVED, Reports

TOPICS = {names.EFFORT_COMMANDS: Float64MultiArray, names.JOINT_COMMANDS: JointState}
RIVALS = "other controllers"
ALONE = "expected nobody else to command the robot"
LOOK_PERIOD = 0.5  # s
SILENCE_CHECKS = 10  # in each state_timeout


Listener = Callable[[JointSample, Command, int, int], None]
"""Takes a sample, its command, and when the one arrived and the other was sent [ns, steady clock]."""


class RivalError(FjrError):
    """Somebody else commands the robot."""


class Answering:
    """Answers states on both command topics from `start` to `stop`; otherwise it computes and sends nothing.

    Other processes on either topic are looked for at the start, at the first state and twice a second. One that
    sends before the first answer is met by `refused`; one that comes later is reported.
    """

    def __init__(
        self,
        node: LifecycleNode,
        joints: tuple[str, ...],
        tracker: Tracker,
        reader: StateReader,
        reports: Reports,
        refused: Callable[[RivalError], None],
    ) -> None:
        self._node, self._tracker, self._reports = node, tracker, reports
        self._reader = SerialisedStates(reader)
        self._refused = refused
        self._n = len(joints)
        self._by_stamps = bool(node.get_parameter("use_sim_time").value)
        self._effort, self._command = EffortWriter(joints), JointStateWriter(joints)
        self._reference, self._error = JointStateWriter(joints), JointStateWriter(joints)
        self._references = node.create_publisher(JointState, names.REFERENCE, names.LATEST)
        self._errors = node.create_publisher(JointState, names.TRACKING_ERROR, names.LATEST)
        self._states = node.create_subscription(JointState, names.JOINT_STATES, self._on_state, names.LATEST, raw=True)
        self._listeners: list[Listener] = []
        self.active = False

    def tell(self, listener: Listener) -> None:
        """Call `listener` with each sample and its command, after they were sent."""
        self._listeners.append(listener)

    def start(self, state_timeout: float) -> None:
        """Answer from the next state on; raises RivalError where another process commands the robot."""
        self._rivals = Rivals(self._node, TOPICS, names.LATEST)
        try:
            self._refuse_rivals()
        except RivalError:
            self._rivals.close()
            raise
        self._efforts, self._commands = self._rivals.publishers
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        own_time = self._node.get_clock() if self._by_stamps else steady
        period = state_timeout / SILENCE_CHECKS
        self._timers = [
            self._node.create_timer(period, self._on_silence, clock=own_time),
            self._node.create_timer(LOOK_PERIOD, self._look_for_rivals, clock=steady),
        ]
        self._last_stamp: int | None = None
        self._alone = False
        self._state = State.WAITING
        self.active = True

    def stop(self) -> None:
        """Send a last command, if any was sent, and answer no more."""
        if not self.active:
            return
        self.active = False
        for timer in self._timers:
            self._node.destroy_timer(timer)
        if self._last_stamp is not None:
            self._send(self._last_stamp, self._tracker.stop_effort())
        self._reports.empty()
        process.flush(self._efforts, self._commands)
        self._rivals.close()

    def close(self) -> None:
        """Give back everything."""
        self.stop()
        self._node.destroy_subscription(self._states)
        for publisher in (self._references, self._errors):
            self._node.destroy_publisher(publisher)

    def _on_state(self, message: bytes) -> None:
        if not self.active:
            return
        try:
            self._take(message, time.monotonic_ns())
        except Exception:
            self.stop()  # whatever it was: the robot is not left with the last effort
            raise

    def _take(self, message: bytes, arrival: int) -> None:
        self._reports.count[RECEIVED] += 1
        try:
            sample = self._reader.read(message)
        except MessageError as error:
            self._reports.refuse("state", error)
            return
        if not (self._alone or self._is_alone()):
            return
        if self._by_stamps:  # the same answer whether the clock shows a silence before or after the state ends it
            self._watch_silence(sample.stamp)
        command = self._tracker.command(sample, arrival)
        if command is not None:
            self._answer(sample, command, arrival)
        if self._tracker.events:
            self._reports.empty()
        self._reports.at(sample.stamp)

    def _answer(self, sample: JointSample, command: Command, arrival: int) -> None:
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
                self._reports.reached("tracking", "tracking: the effort is the law's own")
        for listener in self._listeners:
            listener(sample, command, arrival, sent)

    def _send(self, stamp: int, u: Array) -> None:
        if self._by_stamps:  # lock-step waits for this one
            self._commands.publish(self._command.fill(stamp, effort=u))
        self._efforts.publish(self._effort.fill(u))
        if not self._by_stamps:
            self._commands.publish(self._command.fill(stamp, effort=u))

    def _on_silence(self) -> None:
        now = self._node.get_clock().now().nanoseconds if self._by_stamps else time.monotonic_ns()
        self._watch_silence(now)
        self._reports.empty()

    def _watch_silence(self, now: int) -> None:
        """Send the stop effort once in a silence; now [ns]: of the stamps where time is simulated, else steady."""
        u = self._tracker.silence(now)
        if u is not None and self._last_stamp is not None:
            self._send(self._last_stamp, u)

    def _is_alone(self) -> bool:
        """Look for rivals before the first answer; false where that took so long that the state is old."""
        self._alone = True
        try:
            listened = self._refuse_rivals()
        except RivalError as error:
            self._refused(error)
            return False
        self._rivals.trust()
        return not listened

    def _refuse_rivals(self) -> bool:
        """Whether others were listened to and silent (a killed node is not forgotten at once); else RivalError."""
        appeared = self._rivals.appeared()
        topic = self._rivals.heard() if appeared else ""
        if topic:
            raise RivalError(f"{self._rivals.named(topic)} publishes on {topic}; {ALONE}")
        return bool(appeared)

    def _look_for_rivals(self) -> None:
        topics = self._rivals.appeared() if self._alone else ()
        if topics:
            named = self._rivals.named(*topics)
            sentence = f"{named} has begun to publish on {' and '.join(topics)}; {ALONE}"
            self._reports.event(Event("error", RIVALS, sentence, {"nodes": named}))
