# SPDX-License-Identifier: Apache-2.0
"""How a simulated robot's time goes on: what real time and lock-step share."""

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
from .deferred_service import Answer


@dataclass(frozen=True)
class Rig:
    """A node and what it drives."""

    node: Node
    values: dict[str, Any]
    robot: SimulatedRobot
    transport: Transport
    states: StatePublisher
    reader: EffortReader
    health: Health


class Pace(ABC):
    """Run, rest or advance the robot's time by a number of samples; a sample is stamped `offset` + robot's time.

    An effort acts until the next one, but no longer than command_timeout of the robot's time: then there is none.
    """

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._robot, self._transport, self._health = rig.robot, rig.transport, rig.health
        self._period = rig.transport.period  # ns
        self.paused = bool(rig.values["start_paused"])
        self.offset = 0  # ns, the stamp of the robot's time 0
        self._command_timeout = round(rig.values["command_timeout"] * 1e9)  # ns
        self._last_command = 0  # robot's time, ns
        self._samples = self._left = 0
        self._answer: Answer | None = None

    @property
    def stamp(self) -> int:
        """The stamp [ns] of the robot's time."""
        return self.offset + self._robot.time

    @property
    def running(self) -> bool:
        """Whether the robot's time goes on, if only for some samples."""
        return not self.paused or self._left > 0

    def reset(self) -> None:
        """Back to the initial state, with nothing on its way."""
        self._end_advance(False, "reset")
        self._robot.reset()
        self._last_command = 0
        self._transport.reset()
        self._restart()

    def pause(self, wanted: bool) -> None:
        """Stop the robot's time, or let it go on."""
        self._end_advance(False, "paused" if wanted else "let go")
        if wanted and not self.paused:
            self.catch_up()
        if wanted != self.paused:
            self.paused = wanted
            if not wanted:
                self._resume()

    def advance(self, samples: int, answer: Answer) -> None:
        """Move a paused robot by so many samples; the answer is given when that is done, or refused."""
        refusal = self._refusal()
        if refusal:
            answer.give(False, refusal)
            return
        self._samples = self._left = samples
        self._answer = answer
        self._begin_advance()

    def end(self) -> None:
        """Tell whoever waits for the end of an advance that there is none."""
        self._end_advance(False, "ended")

    @abstractmethod
    def catch_up(self) -> None:
        """Bring the robot to the present, before something about it changes."""

    def _refusal(self) -> str:
        if not self.paused:
            return "the robot's time runs; expected a paused robot: call ~/pause with true first"
        return f"already advancing: {self._left} of {self._samples} samples are left" if self._left else ""

    def _say_once(self, sentence: str) -> None:
        if self._health.is_new(sentence):
            self._rig.node.get_logger().info(sentence)

    def _count_sample(self) -> None:
        """One sample is done, of those to advance by."""
        if self._left:
            self._left -= 1
            if not self._left:
                self._end_advance(True, "")

    def _end_advance(self, success: bool, why: str) -> None:
        """Answer whoever waits for the end of an advance."""
        answer, self._answer = self._answer, None
        if answer is None:
            return
        done, self._left = self._samples - self._left, 0
        now = f"the time is {seconds(self.stamp)} s"
        if success:
            answer.give(True, f"advanced by {done} samples: {now}")
        else:
            answer.give(False, f"{why} after {done} of {self._samples} samples: {now}")

    def _sample(self) -> Sample:
        return self.stamp, *self._robot.measure()

    def _take(self, effort: Array) -> None:
        """A command has come: it acts at once, or when the channel lets it."""
        commands = self._transport.commands
        if commands is None:
            self._apply(effort)
        else:
            commands.push(self._robot.time, effort)

    def _integrate(self, time: int) -> None:
        """Advance the robot to `time` [ns], each command on its way taking effect at its instant."""
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
        """Let an effort act from the robot's time on."""
        self._robot.u = effort
        self._last_command = self._robot.time

    @abstractmethod
    def _restart(self) -> None:
        """Begin afresh with the robot at its initial state."""

    @abstractmethod
    def _resume(self) -> None:
        """Go on after a rest."""

    @abstractmethod
    def _begin_advance(self) -> None:
        """Start with the samples to advance by."""


def seconds(stamp: int) -> str:
    """A stamp [ns] in seconds, with all its digits."""
    sec, nanosec = divmod(stamp, 1_000_000_000)
    return f"{sec}.{nanosec:09d}"
