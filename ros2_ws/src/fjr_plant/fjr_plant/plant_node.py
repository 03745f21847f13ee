# SPDX-License-Identifier: Apache-2.0
"""The simulated robot as a ROS 2 node: holds the last effort, integrates, publishes what it measures."""

from __future__ import annotations

import sys
import time
from typing import Any

import numpy as np
from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool, Trigger

from fjr_core import Plant, config
from fjr_msgs_py import names, process
from fjr_msgs_py.health import Health
from fjr_msgs_py.messages import EffortReader, JointStateWriter, MessageError
from fjr_msgs_py.node_parameters import ParameterNode

from .simulated_robot import SimulatedRobot

LOCKSTEP_START = 1_000_000_000  # ns; stamp of the first state in lock-step, the same in every run
LONGEST_BACKLOG = 200_000_000  # ns that are integrated at once when late
RESEND_PERIOD = 0.1  # s; a lock-step state without an answer is sent again


class PlantNode(ParameterNode):
    """Publishes /joint_states; obeys /effort_controller/commands, or /joint_commands in lock-step.

    A state is stamped with its exact time: the start stamp plus the time integrated. The robot's time
    stands still until the first command has come (wait_for_command) and while paused.
    """

    def __init__(self, **node_kwargs: Any) -> None:
        super().__init__(names.PLANT, config.plant_parameters, **node_kwargs)

    def build(self) -> None:
        """Make the robot from the parameters and start to publish."""
        robot = config.robot(self.values)
        inner_step = round(1e9 / self.values["publish_rate"] / self.values["inner_steps"])
        self._period = inner_step * self.values["inner_steps"]  # ns
        x0 = config.initial_state(self.values, robot)
        plant = Plant(robot, self.values["integrator"], compile=self.values["compile"])
        self._robot = SimulatedRobot(plant, x0, inner_step)
        self._robot.warm_up()
        self._timeout = round(self.values["command_timeout"] * 1e9)  # ns
        self._paused = self.values["start_paused"]
        self._health = Health(self, ("states published", "commands received", "ticks skipped", "states unanswered"))
        self._writer = JointStateWriter(names.state_names(self.values["joints"]))
        self._reader = EffortReader(self.values["joints"])
        self._states = self.create_publisher(JointState, names.JOINT_STATES, names.LATEST)
        self.create_service(Trigger, names.RESET, self._on_reset)
        self.create_service(SetBool, names.PAUSE, self._on_pause)
        self._rest()
        (self._start_lockstep if self.values["lockstep"] else self._start_realtime)()

    def stop(self) -> None:
        """Report the last counters."""
        self._health.publish()

    def _rest(self) -> None:
        """Back to the initial state, standing still until the next command where one is waited for."""
        self._robot.reset()
        self._last_command = 0  # robot's time, ns
        self._answered = True
        now = time.monotonic_ns()
        self._paused_at = now
        self._restart_ticks(now)
        self._origin: int | None = None if self.values["wait_for_command"] else now

    def _restart_ticks(self, now: int) -> None:
        self._first_tick, self._ticks = now, 0

    def _publish(self) -> None:
        if not self._answered:
            self._health.count["states unanswered"] += 1
        self._answered = self._origin is None
        self._health.count["states published"] += 1
        self._states.publish(self._writer.fill(self._start_stamp + self._robot.time, *self._robot.measure()))

    # Real time: the robot's time follows the steady clock from the first command on.

    def _start_realtime(self) -> None:
        self._start_stamp = self.get_clock().now().nanoseconds
        self.create_subscription(Float64MultiArray, names.EFFORT_COMMANDS, self._on_command, names.LATEST)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(self._period * 1e-9, self._on_tick, clock=steady)

    def _on_command(self, message: Float64MultiArray) -> None:
        try:
            effort = self._reader.read_array(message)
        except MessageError as error:
            self._health.refuse("command", error)
            return
        self._health.count["commands received"] += 1
        if self._paused:
            return
        self._answered = True
        if self._origin is None:
            self._origin = time.monotonic_ns()
        self._advance()
        self._robot.u = effort
        self._last_command = self._robot.time

    def _on_tick(self) -> None:
        now = time.monotonic_ns()
        if self._paused:
            return
        due = round((now - self._first_tick) / self._period)
        self._health.count["ticks skipped"] += max(0, due - self._ticks - 1)
        self._ticks = max(due, self._ticks)
        self._advance()
        self._publish()

    def _advance(self) -> None:
        """Integrate to the measured time, without effort once the last command is too old."""
        if self._origin is None:
            return
        now = time.monotonic_ns() - self._origin
        if now - self._robot.time > LONGEST_BACKLOG:  # slower than real time: the rest is lost, not piled up
            lost = now - self._robot.time - LONGEST_BACKLOG
            self._origin += lost
            now -= lost
            self._health.warn("time lost", "too far behind real time: part of it is skipped, stamps stay exact")
        expiry = self._last_command + self._timeout
        if now > expiry and self._robot.u.any():
            self._robot.advance_to(expiry)
            self._robot.u = np.zeros_like(self._robot.u)
            self._health.warn("command timeouts", "no command for longer than command_timeout: effort set to zero")
        self._robot.advance_to(now)

    # Lock-step: one sample per stamped answer to the state that was sent.

    def _start_lockstep(self) -> None:
        self._start_stamp = LOCKSTEP_START
        self._last_sent = 0.0
        self.create_subscription(JointState, names.JOINT_COMMANDS, self._on_answer, names.LATEST)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(RESEND_PERIOD, self._on_resend, clock=steady)
        self._on_resend()

    def _on_answer(self, message: JointState) -> None:
        try:
            stamp, effort = self._reader.read_named(message)
        except MessageError as error:
            self._health.refuse("command", error)
            return
        if self._paused or stamp != self._start_stamp + self._robot.time:
            return  # an answer to a state that was sent again, or to an earlier run
        self._health.count["commands received"] += 1
        self._answered = True
        self._robot.u = effort
        self._robot.advance_to(self._robot.time + self._period)
        self._send()

    def _on_resend(self) -> None:
        if not self._paused and time.monotonic() - self._last_sent >= RESEND_PERIOD:
            self._answered = True
            self._send()

    def _send(self) -> None:
        self._last_sent = time.monotonic()
        self._publish()

    # Services.

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._rest()
        if self.values["lockstep"] and not self._paused:
            self._send()
        response.success = True
        response.message = "the robot is back at its initial state"
        return response

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if request.data != self._paused:
            (self._pause if request.data else self._resume)()
        response.success = True
        response.message = "paused" if self._paused else "running"
        return response

    def _pause(self) -> None:
        if not self.values["lockstep"]:
            self._advance()
        self._paused = True
        self._paused_at = time.monotonic_ns()

    def _resume(self) -> None:
        self._paused = False
        now = time.monotonic_ns()
        self._restart_ticks(now)
        if self._origin is not None:
            self._origin += now - self._paused_at
        if self.values["lockstep"]:
            self._send()


def main(args: list[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM; return the exit code."""
    return process.run(PlantNode, args)


if __name__ == "__main__":
    sys.exit(main())
