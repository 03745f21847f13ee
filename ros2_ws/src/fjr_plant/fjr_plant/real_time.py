# SPDX-License-Identifier: Apache-2.0
"""Real time: the robot's time follows a clock, the steady one or with use_sim_time the /clock of somebody else."""

from __future__ import annotations

import time

from rclpy.clock import Clock, ClockType
from std_msgs.msg import Float64MultiArray

from fjr_msgs_py import names
from fjr_msgs_py.messages import MessageError

from .alarm import Alarm
from .pace import Pace, Rig
from .states import Sample

LONGEST_BACKLOG = 200_000_000  # ns that are integrated at once when late


class RealTime(Pace):
    """Obeys /effort_controller/commands at once, and publishes a state at every tick of the clock.

    A state is stamped with its exact time: the start stamp plus the time integrated. The robot's time stands
    still until the first command has come (wait_for_command), while paused, and while the clock stands still or
    is 0. A clock that jumps forward, or that the robot cannot follow, costs what is more than LONGEST_BACKLOG.
    After one that jumps back the stamps go on from the clock's new time, the motion from where it is.
    """

    def __init__(self, rig: Rig) -> None:
        super().__init__(rig)
        node = rig.node
        self._simulated = bool(node.get_parameter("use_sim_time").value)
        self._ros_clock = node.get_clock()
        clock = self._ros_clock if self._simulated else Clock(clock_type=ClockType.STEADY_TIME)
        self._late = Alarm(node, clock, self._on_late)
        self._arrival = Alarm(node, clock, self._on_arrival)
        self.origin: int | None = None  # the clock at the robot's time 0; None while the first command is waited for
        self._started = False
        self._latest = 0  # ns of the clock
        self._read_clock()
        node.create_subscription(Float64MultiArray, names.EFFORT_COMMANDS, self._on_command, names.LATEST)
        node.create_timer(self._period * 1e-9, self._on_tick, clock=clock)

    def catch_up(self) -> None:
        """Integrate to the clock's time, without effort once the last command is too old."""
        now = self._read_clock()
        if self.origin is None or self.paused or not self._started:
            return
        elapsed = now - self.origin
        if elapsed - self._robot.time > LONGEST_BACKLOG:  # slower than the clock: the rest is lost, not piled up
            self.origin += elapsed - self._robot.time - LONGEST_BACKLOG
            elapsed = self._robot.time + LONGEST_BACKLOG
            self._health.warn("time lost", "too far behind the clock: part of it is skipped, stamps stay exact")
        self._integrate(elapsed)

    # The clock.

    def _read_clock(self) -> int:
        """The clock's time [ns]; 0 until there is one, and standing still while it is 0 later on."""
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
        self._zero = int(self._ros_clock.now().nanoseconds)  # the stamp to begin with
        self._latest = now
        self._restart()

    def _jump_back(self, now: int) -> None:
        self._zero = now
        self.offset = now - self._robot.time
        self._restart_ticks(now)
        if self.origin is not None:
            self.origin = self.offset
        self._health.warn("clock jumps back", "the clock jumped back: stamps go on from its new time")

    def _restart_ticks(self, now: int) -> None:
        self._first_tick, self._ticks = now, 0

    # Rest.

    def _restart(self) -> None:
        if not self._started:
            return
        self.offset = self._zero
        self._answered = True
        now = self._read_clock()
        self._restart_ticks(now)
        self.origin = None if self._rig.values["wait_for_command"] else now

    def _resume(self) -> None:
        now = self._read_clock()
        self._restart_ticks(now)
        if self.origin is not None:
            self.origin = now - self._robot.time
            self._on_arrival()

    def _refusal(self) -> str:
        return super()._refusal() or ("" if self._started else "no time has come on /clock yet; expected one first")

    def _begin_advance(self) -> None:
        """All samples at once: nobody is asked in between, the effort that is held acts."""
        while self._left:
            self._integrate(self._robot.time + self._period)
            self._publish_sample()
            self._count_sample()

    # Commands in, states out.

    def _on_command(self, message: Float64MultiArray) -> None:
        try:
            effort = self._rig.reader.read_array(message)
        except MessageError as error:
            self._health.refuse("command", error)
            return
        self._health.count["commands received"] += 1
        if self.paused or not self._started:
            return
        self._answered = True
        if self.origin is None:
            self.origin = self._read_clock() - self._robot.time
        else:
            self.catch_up()
        self._take(effort)

    def _on_tick(self) -> None:
        now = self._read_clock()
        if self.paused or not self._started:
            return
        due = round((now - self._first_tick) / self._period)
        self._health.count["ticks skipped"] += max(0, due - self._ticks - 1)
        self._ticks = max(due, self._ticks)
        late = self._transport.lateness()
        if late:
            self._late.set(late)
        else:
            self._on_late()

    def _on_late(self) -> None:
        if not self.paused:
            self.catch_up()
            self._publish_sample()

    def _publish_sample(self) -> None:
        channel = self._transport.states
        if channel is None or self.origin is None:  # a robot at rest waits until it is heard
            self._send(self._sample())
        else:
            channel.push(self._robot.time, self._sample())
            self._send_arrived(self._robot.time)

    def _send_arrived(self, elapsed: int) -> None:
        """Send what has arrived after `elapsed` [ns] of the robot's time, and be back for the next."""
        channel = self._transport.states
        if channel is not None:
            for sample in channel.due(elapsed):
                self._send(sample)
            if channel.next_due is not None:
                self._arrival.set(channel.next_due - elapsed)

    def _on_arrival(self) -> None:
        if self.origin is not None and not self.paused:
            self._send_arrived(self._read_clock() - self.origin)

    def _send(self, sample: Sample) -> None:
        if not self._answered:
            self._health.count["states unanswered"] += 1
        self._answered = self.origin is None
        self._health.count["states published"] += 1
        self._rig.states.send(sample)
        self._health.at(sample[0])
