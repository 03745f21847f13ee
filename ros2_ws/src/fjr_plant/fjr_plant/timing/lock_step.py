# SPDX-License-Identifier: Apache-2.0
"""Lock-step: the plant owns the time, one sample for each command that answers its state. See lock_step.c."""

from __future__ import annotations

from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import JointState

from fjr_core import FjrError
from fjr_msgs_py import names
from fjr_msgs_py.messages.clock import CLOCK_LAYOUT
from fjr_msgs_py.messages.joint_states import deserialised
from fjr_msgs_py.native.entities import NativeMessage, NativeReader

from ..native.program import NO_TIME
from .clock_owner import ClockOwner
from .node_parts import NodeParts
from .stamps import seconds, steady
from .time_base import WATCH_PERIOD, TimeBase

START = 1_000_000_000  # ns; stamp of the first state, the same in every run
_EFFORT = 4  # FJR_EFFORT


class LockStepError(FjrError):
    """Controller that stopped sending commands."""


class LockStep(TimeBase):
    """Time base that sends a state and /clock and waits for /joint_commands with its stamp and all efforts.

    After the first command since a start or a reset, LockStepError ends the node if no command comes for
    lockstep_timeout; before, the robot waits. Raises ClockError if another process publishes on /clock (ClockOwner).
    """

    lock_step = True
    moving = "moving: the first answer has arrived"

    def __init__(self, parts: NodeParts) -> None:
        super().__init__(parts)
        node, plant, lib = parts.node, self.plant, self._lib
        plant.offset = START
        plant.timeout = round(parts.values["lockstep_timeout"] * 1e9)
        self._clock = ClockOwner(node, parts.health, lambda: int(plant.shown))
        self._publishers.append(self._clock.publisher)
        self._clock_message = NativeMessage(self._program, CLOCK_LAYOUT, ())
        self._answer = NativeReader(self._program, parts.values["joints"], _EFFORT)
        plant.clock, plant.answer = self._clock_message.pointer, self._answer.pointer
        self._topic = node.resolve_topic_name(names.JOINT_COMMANDS)
        self._serve(JointState, names.JOINT_COMMANDS, lib.fjr_lock_step_command, lib.fjr_lock_step_tick)
        node.create_timer(WATCH_PERIOD, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._check(self._restart())
        self.host.start()

    def close(self) -> None:
        """Stop serving commands and watching /clock."""
        super().close()
        self._clock.close()

    def _look(self) -> None:
        """Check for another owner of the time, between two messages, as it listens on /clock; raises ClockError."""
        self.host.run(lambda: self._clock.look(established=bool(self.plant.heard)))

    def _restart(self) -> int:
        return int(self._lib.fjr_lock_step_restart(self.plant, steady()))

    def _resume(self) -> int:
        return int(self._lib.fjr_lock_step_resume(self.plant, steady()))

    _begin_advance = _resume

    def _on_first_answer(self) -> None:
        self._clock.refuse_others()

    def _read(self, data: bytes) -> None:
        self._parts.reader.read_named(deserialised(data, JointState))

    def _error_of(self, fault: int, reason: str) -> FjrError:
        if fault == self._lib.FJR_UNANSWERED:
            return LockStepError(self._silence())
        return super()._error_of(fault, reason)

    def _silence(self) -> str:
        plant = self.plant
        other = f"the last other one has {seconds(plant.other)} s" if plant.other < NO_TIME else "none has arrived"
        return (
            f"the state of {seconds(plant.awaited)} s was not answered for {plant.timeout * 1e-9:g} s "
            f"(lockstep_timeout); expected a message on {self._topic} with that stamp and an effort for every joint, "
            f"{other}"
        )
