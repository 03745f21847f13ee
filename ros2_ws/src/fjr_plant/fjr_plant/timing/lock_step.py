# SPDX-License-Identifier: Apache-2.0
"""Lock-step: the plant owns the time and advances one sample for each command that answers its state."""

from __future__ import annotations

import time
from collections import deque

from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import JointState

from fjr_core import FjrError
from fjr_msgs_py import names
from fjr_msgs_py.messages.cdr.readers import SerialisedEfforts
from fjr_msgs_py.messages.joint_states import MessageError

from ..state_publisher import Sample
from .clock_owner import ClockOwner
from .time_base import NodeParts, TimeBase, seconds

START = 1_000_000_000  # ns; stamp of the first state, the same in every run
RESEND_PERIOD = 0.1  # s; a state without a command is sent again
MOST_SILENT = 1000  # samples without a state to send before the node processes other events


class LockStepError(FjrError):
    """Controller that stopped sending commands."""


class LockStep(TimeBase):
    """Time base that sends a state and /clock and waits for /joint_commands with its stamp and all efforts.

    A state without a command is sent again unchanged and never skipped. After the first command since a start or a
    reset, LockStepError is raised if no command comes for lockstep_timeout; before, the robot waits. If a channel loses
    or delays a state, the sample passes with the held effort, in every run alike, and /clock shows its time. Raises
    ClockError if another process publishes on /clock (ClockOwner).
    """

    def __init__(self, parts: NodeParts) -> None:
        super().__init__(parts)
        node = parts.node
        self.offset = START
        self._timeout = float(parts.values["lockstep_timeout"])
        self._arrived: deque[Sample] = deque()
        self._awaited: int | None = None  # stamp of the sent state that has no command yet
        self._newest = 0  # stamp of the newest state that was sent
        self._other: int | None = None  # stamp of the last command for another state
        self._heard = False
        self._clock = ClockOwner(node, parts.health)
        self._topic = node.resolve_topic_name(names.JOINT_COMMANDS)
        self._reader = SerialisedEfforts(parts.reader)
        node.create_subscription(JointState, names.JOINT_COMMANDS, self._on_command, names.LATEST, raw=True)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(RESEND_PERIOD / 2, self._watch, clock=steady)
        self._restart()

    def _on_command(self, message: bytes) -> None:
        try:
            stamp, effort = self._reader.read(message)
        except MessageError as error:
            self._health.refuse("command", error)
            return
        if stamp != self._awaited or not self.running:
            self._health.count["answers to other states"] += 1
            self._other = stamp
            return
        if not self._heard:
            self._clock.refuse_others()
        self._take(effort)
        self._awaited, self._heard = None, True
        self._log_once("moving: the first answer has arrived")
        self._continue()
        self._health.count["commands received"] += 1

    def _continue(self) -> None:
        """Send states that have arrived; if there are none, let samples pass until one arrives."""
        sent = self._send_arrived()
        for _ in range(MOST_SILENT):
            if sent or not self.running:
                return
            self._integrate(self._transport.times.next())
            self._measure()
            sent = self._send_arrived()
            if not sent:
                self._show_time()
            self._health.at(self.stamp)
            self._count_sample()

    def _measure(self) -> None:
        """Take a sample and collect the samples that have arrived."""
        channel = self._transport.states
        if channel is None or not self._heard:  # without errors until the first command
            self._arrived.append(self._sample())
        else:
            channel.push(self._robot.time, self._sample())
            self._arrived.extend(channel.due(self._robot.time))

    def _send_arrived(self) -> bool:
        """Send the first arrived state that can still receive a command; return False if there is none."""
        while self._arrived:
            sample = self._arrived.popleft()
            self._awaited = sample[0]
            self._parts.states.send(sample)
            self._show_time()
            self._sent_at = self._first_sent_at = time.monotonic()
            self._health.count["states published"] += 1
            if sample[0] >= self._newest:
                self._newest = sample[0]
                return True
        self._awaited = None  # overtaken by a newer state: no command will come
        return False

    def _send_again(self) -> None:
        self._parts.states.send_again()
        self._show_time()
        self._sent_at = time.monotonic()
        self._health.count["states sent again"] += 1

    def _show_time(self) -> None:
        """Publish /clock, after the state of that time, so that subscribers receive the state first."""
        self._clock.show(self.stamp)

    def _watch(self) -> None:
        """Check for a missing command and for another owner of the time; raises FjrError."""
        self._clock.look(established=self._heard)
        if not self.running:
            return
        if self._awaited is None:
            self._continue()
            return
        now = time.monotonic()
        if self._heard and 0.0 < self._timeout < now - self._first_sent_at:
            raise LockStepError(self._silence(self._awaited))
        if now - self._sent_at >= RESEND_PERIOD:
            self._send_again()

    def _silence(self, awaited: int) -> str:
        heard = "none has arrived" if self._other is None else f"the last other one has {seconds(self._other)} s"
        return (
            f"the state of {seconds(awaited)} s was not answered for {self._timeout:g} s (lockstep_timeout); expected "
            f"a message on {self._topic} with that stamp and an effort for every joint, {heard}"
        )

    def _restart(self) -> None:
        self._arrived.clear()
        self._heard = False
        self._awaited = self._other = None
        self._newest = 0
        self._sent_at = self._first_sent_at = time.monotonic()
        self._measure()
        if self.running:
            self._send_arrived()

    def _resume(self) -> None:
        self._first_sent_at = time.monotonic()
        if self._awaited is None:
            self._continue()
        else:
            self._send_again()

    def catch_up(self) -> None:
        """Do nothing: the robot is already at the time of its last command."""
