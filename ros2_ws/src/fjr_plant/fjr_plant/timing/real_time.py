# SPDX-License-Identifier: Apache-2.0
"""Real time: robot time follows the steady clock or, with use_sim_time, an external /clock."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from std_msgs.msg import Float64MultiArray

from fjr_msgs_py import names
from fjr_msgs_py.messages.joint_states import MessageError

from ..state_publisher import Sample
from .time_base import NodeParts, TimeBase

LONGEST_BACKLOG = 200_000_000  # ns; longest time integrated at once
LARGEST_LAG = 1_000_000_000  # ns; largest lag of the stamps behind the clock due to lost time


class OneShotTimer:
    """Timer that calls back once after it was last set."""

    def __init__(self, node: Node, clock: Clock, callback: Callable[[], None]) -> None:
        self._callback = callback
        self._timer = node.create_timer(1.0, self._fire, clock=clock)
        self._timer.cancel()

    def set(self, wait: int) -> None:
        """Fire after `wait` [ns]."""
        self._timer.timer_period_ns = max(wait, 1)
        self._timer.reset()

    def _fire(self) -> None:
        self._timer.cancel()
        self._callback()


class RealTime(TimeBase):
    """Time base that applies /effort_controller/commands at once and publishes a state at every tick of the clock.

    A stamp is the node time at which robot time started or resumed, plus the time integrated since. While waiting for
    the first command (wait_for_command), a state is stamped with the node time, and integration starts from the last
    such state. Stamps never decrease. Robot time stands still while waiting, while paused, and while the clock stands
    still or is 0. After a reset or a pause no state is published for restart_silence, so that a controller recovers
    instead of receiving a jump. If the clock jumps forward or is too fast, a backlog of more than LONGEST_BACKLOG is
    skipped and the stamps lag behind by that time, at most LARGEST_LAG. If /clock jumps back, stamps continue from its
    new time and the motion continues unchanged.
    """

    def __init__(self, parts: NodeParts) -> None:
        super().__init__(parts)
        node = parts.node
        self._simulated = bool(node.get_parameter("use_sim_time").value)
        self._ros_clock = node.get_clock()
        clock = self._ros_clock if self._simulated else Clock(clock_type=ClockType.STEADY_TIME)
        self._late_timer = OneShotTimer(node, clock, self._on_late)
        self._arrival_timer = OneShotTimer(node, clock, self._on_arrival)
        self.origin: int | None = None  # clock time of robot time 0; None while that stands still
        self._started = self._waiting = False
        self._silence = round(parts.values["restart_silence"] * 1e9)  # ns
        self._latest = self._quiet_until = self._lag = 0  # ns of the clock
        self._newest = 0  # ns, the largest stamp so far
        self._read_clock()
        node.create_subscription(Float64MultiArray, names.EFFORT_COMMANDS, self._on_command, names.LATEST)
        node.create_timer(self._period * 1e-9, self._on_tick, clock=clock)

    def catch_up(self) -> None:
        """Integrate up to the present clock time, with zero effort after the command timeout."""
        now = self._read_clock()
        if self.origin is None or self.paused or not self._started:
            return
        elapsed = now - self.origin
        if elapsed - self._robot.time > LONGEST_BACKLOG:  # too slow for the clock: skip the rest
            lost = elapsed - self._robot.time - LONGEST_BACKLOG
            self.origin += lost
            self._lag += lost
            elapsed -= lost
            self._health.warn("time lost", "too far behind the clock: the backlog is skipped and stamps lag by it")
        self._integrate(elapsed)
        if self._lag > LARGEST_LAG:
            self._stamp_from_now()

    # The clock.

    def _read_clock(self) -> int:
        """Return the clock time [ns]; 0 before the first one, constant while the clock is 0 later."""
        now = int(self._ros_clock.now().nanoseconds) if self._simulated else time.monotonic_ns()
        if now > 0:
            if not self._started:
                self._start(now)
            elif now < self._latest:
                self._jump_back(now)
            self._latest = now
        return self._latest

    def _start(self, now: int) -> None:
        self._started = True
        self._latest = now
        self._restart()

    def _jump_back(self, now: int) -> None:
        if self._quiet_until:
            self._quiet_until = max(self._quiet_until + now - self._latest, 1)
        self.offset, self._newest, self._lag = now - self._robot.time, 0, 0
        self._restart_ticks(now)
        if self.origin is not None:
            self.origin = self.offset
        self._health.warn("clock jumps back", "the clock jumped back: stamps continue from its new time")

    def _restart_ticks(self, now: int) -> None:
        self._first_tick, self._ticks = now, 0

    def _stamp_from_now(self) -> None:
        """Restart the stamps from the node clock; they never decrease."""
        now = int(self._ros_clock.now().nanoseconds)
        self.offset, self._lag = max(now, self._newest) - self._robot.time, 0

    # Start, pause and resume.

    def _restart(self) -> None:
        if self._started:
            self._answered = True
            self._waiting = bool(self._parts.values["wait_for_command"])
            self._stamp_from_now()
            self._resume()

    def _resume(self) -> None:
        """Resume states and robot time, after the silence if states were published before."""
        now = self._read_clock()
        self.origin = None
        self._quiet_until = now + self._silence if self._newest and self._silence else 0
        if not self.paused and not self._quiet_until:
            self._start_motion(now)

    def _start_motion(self, now: int) -> None:
        """Restart the stamps, and robot time unless it waits for a command."""
        self._quiet_until = 0
        self._restart_ticks(now)
        self._stamp_from_now()
        if not self._waiting:
            self.origin = now - self._robot.time
            self._on_arrival()

    def _is_active(self, now: int) -> bool:
        """Return whether states are published and commands applied; ends an elapsed silence."""
        if self.paused or not self._started or now < self._quiet_until:
            return False
        if self._quiet_until:
            self._start_motion(now)
        return True

    def _refusal(self) -> str:
        return super()._refusal() or (
            "" if self._started else "no time has been received on /clock; expected one first"
        )

    def _begin_advance(self) -> None:
        """Advance all samples at once under the held effort."""
        while self._left:
            self._integrate(self._robot.time + self._period)
            self._publish_sample()
            self._count_sample()

    # Commands in, states out.

    def _on_command(self, message: Float64MultiArray) -> None:
        try:
            effort = self._parts.reader.read_array(message)
        except MessageError as error:
            self._health.refuse("command", error)
            return
        self._health.count["commands received"] += 1
        now = self._read_clock()
        if not self._is_active(now):
            return
        self._answered = True
        if self._waiting:  # the last published state is that of the present robot time
            self._waiting, self.origin = False, now - self._robot.time
            self._take(effort)  # acts from the first instant of motion, before the log costs time
            self._log_once("moving: the first command has arrived")
            return
        self.catch_up()
        self._take(effort)

    def _on_tick(self) -> None:
        now = self._read_clock()
        if not self._is_active(now):
            return
        due = round((now - self._first_tick) / self._period)
        self._health.count["ticks skipped"] += max(0, due - self._ticks - 1)
        self._ticks = max(due, self._ticks)
        late = self._transport.lateness()
        if late:
            self._late_timer.set(late)
        else:
            self._on_late()

    def _on_late(self) -> None:
        if self._is_active(self._latest):
            self.catch_up()
            self._publish_sample()

    def _publish_sample(self) -> None:
        if self.origin is None and not self.paused:
            self._stamp_from_now()
        channel, sample = self._transport.states, self._sample()
        self._newest = max(sample[0], self._newest)
        if channel is None or self._waiting:  # without errors until the first command
            self._send(sample)
        else:
            channel.push(self._robot.time, sample)
            self._send_arrived(self._robot.time)

    def _send_arrived(self, elapsed: int) -> None:
        """Send the states that have arrived by `elapsed` [ns] of robot time and set the timer for the next."""
        channel = self._transport.states
        if channel is not None:
            for sample in channel.due(elapsed):
                self._send(sample)
            if channel.next_due is not None:
                self._arrival_timer.set(channel.next_due - elapsed)

    def _on_arrival(self) -> None:
        if self.origin is not None and not self.paused:
            self._send_arrived(self._read_clock() - self.origin)

    def _send(self, sample: Sample) -> None:
        if not self._answered:
            self._health.count["states unanswered"] += 1
        self._answered = self._waiting
        self._health.count["states published"] += 1
        self._parts.states.send(sample)
        self._health.at(sample[0])
