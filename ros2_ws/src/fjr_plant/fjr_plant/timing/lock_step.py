# SPDX-License-Identifier: Apache-2.0
"""Lock-step: the plant owns the time, and one sample passes for each answer to the state that was sent."""

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
from .time_base import Pace, Rig, seconds

START = 1_000_000_000  # ns; stamp of the first state, the same in every run
RESEND_PERIOD = 0.1  # s; a state without an answer is sent again
MOST_SILENT = 1000  # samples without a state to send before the node looks for other work


class LockStepError(FjrError):
    """A controller that has answered and answers no more."""


class LockStep(Pace):
    """Sends a state and /clock, and waits for the /joint_commands with its stamp and an effort for each joint.

    What is not answered is sent again, with the very same numbers, and never skipped. From the first answer
    on (after a start or a reset) LockStepError ends a silence of lockstep_timeout; until then the robot waits.
    What an imperfect channel loses or still holds at a sample's time has nobody to wait for: the sample passes
    with the effort that is held, the same in every run, and /clock shows its time. There is one owner of /clock
    (ClockOwner): where another process publishes on it, ClockError.
    """

    def __init__(self, rig: Rig) -> None:
        super().__init__(rig)
        node = rig.node
        self.offset = START
        self._timeout = float(rig.values["lockstep_timeout"])
        self._arrived: deque[Sample] = deque()
        self._awaited: int | None = None  # stamp of the state that was sent and is not answered
        self._newest = 0  # stamp of the newest state that was sent
        self._other: int | None = None  # stamp of the last answer to another one
        self._heard = False
        self._clock = ClockOwner(node, rig.health)
        self._topic = node.resolve_topic_name(names.JOINT_COMMANDS)
        self._reader = SerialisedEfforts(rig.reader)
        node.create_subscription(JointState, names.JOINT_COMMANDS, self._on_answer, names.LATEST, raw=True)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(RESEND_PERIOD / 2, self._watch, clock=steady)
        self._restart()

    def _on_answer(self, message: bytes) -> None:
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
        self._say_once("moving: the first answer has come")
        self._go_on()
        self._health.count["commands received"] += 1

    def _go_on(self) -> None:
        """Send what has arrived; where nothing has, let samples pass until something does."""
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
        """Take a sample, and what of it and of earlier ones has arrived."""
        channel = self._transport.states
        if channel is None or not self._heard:  # a robot at rest waits until it is heard
            self._arrived.append(self._sample())
        else:
            channel.push(self._robot.time, self._sample())
            self._arrived.extend(channel.due(self._robot.time))

    def _send_arrived(self) -> bool:
        """Send the first state that has arrived and can still be answered; False where there is none."""
        while self._arrived:
            sample = self._arrived.popleft()
            self._awaited = sample[0]
            self._rig.states.send(sample)
            self._show_time()
            self._sent_at = self._first_sent_at = time.monotonic()
            self._health.count["states published"] += 1
            if sample[0] >= self._newest:
                self._newest = sample[0]
                return True
        self._awaited = None  # overtaken on the way: nobody answers an older state
        return False

    def _send_again(self) -> None:
        self._rig.states.send_again()
        self._show_time()
        self._sent_at = time.monotonic()
        self._health.count["states sent again"] += 1

    def _show_time(self) -> None:
        """Publish /clock; after the state of that time, so that its readers have the state first."""
        self._clock.show(self.stamp)

    def _watch(self) -> None:
        """Look for an answer that is missing and for another owner of the time; raises FjrError."""
        self._clock.look(established=self._heard)
        if not self.running:
            return
        if self._awaited is None:
            self._go_on()
            return
        now = time.monotonic()
        if self._heard and 0.0 < self._timeout < now - self._first_sent_at:
            raise LockStepError(self._silence(self._awaited))
        if now - self._sent_at >= RESEND_PERIOD:
            self._send_again()

    def _silence(self, awaited: int) -> str:
        heard = "none has come" if self._other is None else f"the last other one there had {seconds(self._other)} s"
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
            self._go_on()
        else:
            self._send_again()

    def _begin_advance(self) -> None:
        self._resume()

    def catch_up(self) -> None:
        """The robot is where its last answer has brought it."""
