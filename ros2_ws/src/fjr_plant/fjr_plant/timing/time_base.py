# SPDX-License-Identifier: Apache-2.0
"""Common time base of real time and lock-step: run, pause and advance the robot time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
from rclpy.node import Node

from fjr_core.numerics.checks import Array
from fjr_msgs_py.messages.joint_states import EffortReader
from fjr_msgs_py.node.diagnostics import Health

from ..channel import Transport
from ..simulated_robot import SimulatedRobot
from ..state_publisher import Sample, StatePublisher
from .deferred_service import DeferredReply


@dataclass(frozen=True)
class NodeParts:
    """Components of the plant node."""

    node: Node
    values: dict[str, Any]
    robot: SimulatedRobot
    transport: Transport
    states: StatePublisher
    reader: EffortReader
    health: Health


class TimeBase(ABC):
    """Time base that runs, pauses or advances the robot; a sample has the stamp `offset` + robot time.

    An effort acts until the next one, at most for command_timeout of robot time; then the effort is zero.
    """

    def __init__(self, parts: NodeParts) -> None:
        self._parts = parts
        self._robot, self._transport, self._health = parts.robot, parts.transport, parts.health
        self._period = parts.transport.period  # ns
        self.paused = bool(parts.values["start_paused"])
        self.offset = 0  # ns, stamp of robot time 0
        self._command_timeout = round(parts.values["command_timeout"] * 1e9)  # ns
        self._last_command = 0  # robot time, ns
        self._samples = self._left = 0
        self._reply: DeferredReply | None = None

    @property
    def stamp(self) -> int:
        """Stamp [ns] of the present robot time."""
        return self.offset + self._robot.time

    @property
    def running(self) -> bool:
        """Return whether robot time runs, possibly only for some samples."""
        return not self.paused or self._left > 0

    def reset(self) -> None:
        """Return to the initial state and discard all messages in transit."""
        self._end_advance(False, "reset")
        self._robot.reset()
        self._last_command = 0
        self._transport.reset()
        self._restart()

    def pause(self, wanted: bool) -> None:
        """Pause or resume robot time."""
        self._end_advance(False, "paused" if wanted else "resumed")
        if wanted and not self.paused:
            self.catch_up()
        if wanted != self.paused:
            self.paused = wanted
            if not wanted:
                self._resume()

    def advance(self, samples: int, reply: DeferredReply) -> None:
        """Advance a paused robot by `samples`; reply when that is done or refused."""
        refusal = self._refusal()
        if refusal:
            reply.give(False, refusal)
            return
        self._samples = self._left = samples
        self._reply = reply
        self._begin_advance()

    def end(self) -> None:
        """Reply to a waiting client that the advance has ended early."""
        self._end_advance(False, "ended")

    @abstractmethod
    def catch_up(self) -> None:
        """Integrate up to the present, before a change takes effect."""

    def _refusal(self) -> str:
        if not self.paused:
            return "robot time is running; expected a paused robot: call ~/pause with true first"
        return f"already advancing: {self._left} of {self._samples} samples are left" if self._left else ""

    def _log_once(self, sentence: str) -> None:
        if self._health.is_new(sentence):
            self._parts.node.get_logger().info(sentence)

    def _count_sample(self) -> None:
        """Count one sample of an advance."""
        if self._left:
            self._left -= 1
            if not self._left:
                self._end_advance(True, "")

    def _end_advance(self, success: bool, why: str) -> None:
        """Reply to the client that waits for the end of an advance."""
        reply, self._reply = self._reply, None
        if reply is None:
            return
        done, self._left = self._samples - self._left, 0
        now = f"the time is {seconds(self.stamp)} s"
        if success:
            reply.give(True, f"advanced by {done} samples: {now}")
        else:
            reply.give(False, f"{why} after {done} of {self._samples} samples: {now}")

    def _sample(self) -> Sample:
        return self.stamp, *self._robot.measure()

    def _take(self, effort: Array) -> None:
        """Take a command, which acts at once or after its channel delay."""
        commands = self._transport.commands
        if commands is None:
            self._apply(effort)
        else:
            commands.push(self._robot.time, effort)

    def _integrate(self, time: int) -> None:
        """Advance the robot to `time` [ns]; commands in transit take effect at their instants."""
        commands = self._transport.commands
        while commands is not None and (instant := commands.next_due) is not None and instant <= time:
            self._integrate_held(instant)
            for effort in commands.due(instant):
                self._apply(effort)
        self._integrate_held(time)

    def _integrate_held(self, time: int) -> None:
        """Advance the robot to `time` [ns] without a new command."""
        expiry = self._last_command + self._command_timeout
        if time > expiry and self._robot.u.any():
            self._robot.advance_to(expiry)
            self._robot.u = np.zeros_like(self._robot.u)
            self._health.warn("command timeouts", "no command for longer than command_timeout: effort set to zero")
        self._robot.advance_to(time)

    def _apply(self, effort: Array) -> None:
        """Apply an effort from the present robot time on."""
        self._robot.u = effort
        self._last_command = self._robot.time

    @abstractmethod
    def _restart(self) -> None:
        """Restart with the robot at its initial state."""

    @abstractmethod
    def _resume(self) -> None:
        """Resume after a pause."""

    def _begin_advance(self) -> None:
        """Start an advance."""
        self._resume()


def seconds(stamp: int) -> str:
    """Format a stamp [ns] in seconds with all digits."""
    sec, nanosec = divmod(stamp, 1_000_000_000)
    return f"{sec}.{nanosec:09d}"
