# SPDX-License-Identifier: Apache-2.0
"""Lock-step: the plant owns the time, one sample for each command that answers its state. See lock_step.c."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.node import Node
from rosgraph_msgs.msg import Clock as ClockMessage
from sensor_msgs.msg import JointState

from fjr_core import FjrError
from fjr_msgs_py import names
from fjr_msgs_py.messages.joint_states import CLOCK_LAYOUT, SECOND, deserialised, nanoseconds, picked
from fjr_msgs_py.native.loop import NO_TIME, NativeMessage, NativeReader
from fjr_msgs_py.node.conflicting_publishers import ConflictingPublishers
from fjr_msgs_py.node.parameters import ParameterNode
from fjr_msgs_py.node.reports import Health

from .channel import Transport
from .simulated_robot import SimulatedRobot
from .time_base import TimeBase, seconds

OTHERS = "other clocks"
LOOK_PERIOD = 0.5  # s between checks of the graph
SETTLING = 5.0  # s in which earlier publishers are discovered


class ClockError(FjrError):
    """Another process publishes the time."""


class ClockOwner(ConflictingPublishers):
    """Publisher of the time, unless another process publishes it.

    The topic is checked when the node starts, before the first command is accepted, and twice per second. An owner
    without a command so far that receives another time raises ClockError; it listens at every check while another
    publisher exists, because a busy one may be late. An owner with commands does so only while it is younger than
    SETTLING, and only if the other time is ahead of its own; later it continues and reports the other one.
    """

    def __init__(self, node: Node, health: Health, shown: Callable[[], int]) -> None:
        """shown: returns the time that was published last [ns]."""
        super().__init__(node, {names.CLOCK: ClockMessage}, names.HISTORY)
        self._health, self._shown = health, shown
        self._settled = time.monotonic() + SETTLING
        self.refuse_others()

    def refuse_others(self, ahead_of: int = 0) -> None:
        """Raise ClockError if another process publishes a time of at least `ahead_of` [ns] now."""
        self.appeared()
        heard = self.heard() if self.others else None
        if heard and nanoseconds(heard[1].clock) >= ahead_of:
            raise ClockError(self._sentence("publishes"))

    def look(self, established: bool) -> None:
        """Check for other publishers; raises ClockError unless established."""
        if not established or time.monotonic() <= self._settled:
            self.refuse_others(ahead_of=self._shown() + 1 if established else 0)
        elif self.appeared():
            self._health.note("error", OTHERS, self._sentence("has begun to publish"))

    def _sentence(self, acts: str) -> str:
        topic, space = self._node.resolve_topic_name(names.CLOCK), self._node.get_namespace().rstrip("/")
        return (
            f"{self.named(topic)} {acts} on {topic}; expected one owner of the time: start this plant and its "
            f"controller with -r {names.CLOCK}:={space or '/NAMESPACE'}/clock"
        )


START = SECOND  # stamp of the first state, the same in every run
_EFFORT = 4  # FJR_EFFORT


class LockStepError(FjrError):
    """Controller that stopped sending commands."""


class LockStep(TimeBase):
    """Time base that sends a state and /clock and waits for /joint_commands with its stamp and all efforts.

    After the first command since a start or a reset, LockStepError ends the node if no command comes for
    lockstep_timeout; before, the robot waits. Raises ClockError if another process publishes on /clock (ClockOwner).
    """

    functions, kind, topic, first = "lock_step", JointState, names.JOINT_COMMANDS, "answer"

    def __init__(self, node: ParameterNode, robot: SimulatedRobot, transport: Transport, health: Health) -> None:
        super().__init__(node, robot, transport, health)
        plant = self.plant
        plant.offset = START
        plant.timeout = round(node.values["lockstep_timeout"] * 1e9)
        self._clock = ClockOwner(node, health, lambda: int(plant.shown))
        self._publishers += self._clock.publishers
        self._events.on[self._lib.FJR_FIRST_ANSWER] = lambda _: self._clock.refuse_others()
        self._clock_message = NativeMessage(self._program, CLOCK_LAYOUT)
        self._answer = NativeReader(self._program, node.values["joints"], _EFFORT)
        plant.clock, plant.answer = self._clock_message.pointer, self._answer.pointer
        self._serve()
        node.create_timer(LOOK_PERIOD, self._look, clock=names.STEADY)
        self._call("restart")
        self.host.start()

    def close(self) -> None:
        """Stop serving commands and watching /clock."""
        super().close()
        self._clock.trust()

    def _look(self) -> None:
        """Check for another owner of the time, between two messages, as it listens on /clock; raises ClockError."""
        self.host.run(lambda: self._clock.look(established=bool(self.plant.heard)))

    def _read(self, data: bytes) -> None:
        picked(deserialised(data, JointState), "effort", self._node.values["joints"])

    def _error_of(self, fault: int, reason: str) -> FjrError:
        if fault != self._lib.FJR_UNANSWERED:
            return super()._error_of(fault, reason)
        plant, topic = self.plant, self._node.resolve_topic_name(self.topic)
        other = f"the last other one has {seconds(plant.other)} s" if plant.other < NO_TIME else "none has arrived"
        return LockStepError(
            f"the state of {seconds(plant.awaited)} s was not answered for {plant.timeout * 1e-9:g} s "
            f"(lockstep_timeout); expected a message on {topic} with that stamp and an effort for every joint, {other}"
        )
