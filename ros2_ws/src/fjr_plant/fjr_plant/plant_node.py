# SPDX-License-Identifier: Apache-2.0
"""Simulated robot as a ROS 2 node: hold the last effort, integrate, publish the measurements."""

from __future__ import annotations

import sys
import time
from typing import Any

from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from fjr_core import FjrError
from fjr_core.config.nodes import PLANT
from fjr_core.config.plant import NONE, OBSTACLE_PRESENT, OBSTACLE_TYPE, initial_state, plant_parameters
from fjr_core.config.plant import plant as build_plant
from fjr_core.config.robot import description, robot_name
from fjr_core.config.robot import robot as build_robot
from fjr_msgs_py import names
from fjr_msgs_py.messages.joint_states import MessageError, read_torques
from fjr_msgs_py.node import loading, participant, process
from fjr_msgs_py.node.conflicting_publishers import Namesake, publisher_elsewhere
from fjr_msgs_py.node.parameters import ParameterNode
from fjr_msgs_py.node.reports import Health, publish_description, refusal

from .host import EXPECTED
from .simulated_robot import errors_of, simulated
from .time_base import DeferredTrigger, RealTime, TimeBase

TORQUES = "external torques received"
SETTLING = 2.0  # s in which another robot may be discovered late, on busy cores
LOOK_PERIOD = 0.25  # s


class PlantConflictError(FjrError):
    """Another process publishes states of the joints."""


class PlantNode(ParameterNode):
    """Plant node: publishes /joint_states and applies /effort_controller/commands.

    In lock-step it applies /joint_commands and publishes /clock. Robot time stands still until the first command
    (wait_for_command) and while paused. Services: ~/reset, ~/pause, ~/advance by advance_samples while paused. Torques
    on ~/external_torque act on the named links until the next message or a reset.
    """

    _time_base: TimeBase

    def __init__(self, since: float = 0.0, **node_kwargs: Any) -> None:
        """Create the node; since [s, steady clock]: when the publishers of other processes are known."""
        self._since = since
        super().__init__(PLANT, plant_parameters, **node_kwargs)

    def build(self) -> None:
        """Build the robot from the parameters and start publishing.

        Raise PlantConflictError if another process publishes states of one of the joints.
        """
        self._model = build_robot(self.values)
        time.sleep(max(0.0, self._since - time.monotonic()))
        self._refuse_another()
        self._health = Health(self, (*EXPECTED, TORQUES), robot_name(self.values))
        plant = build_plant(self.values, self._model)
        x0 = initial_state(self.values, self._model)
        self._robot, self._transport = simulated(self.values, plant, x0)
        self._robot.warm_up()
        if self.values["publish_description"]:
            publish_description(self, description(self.values))
        parts = self, self._robot, self._transport, self._health
        if self.values["lockstep"]:
            from .lock_step import LockStep

            self._time_base = LockStep(*parts)
        else:
            self._time_base = RealTime(*parts)
        self.create_subscription(JointState, names.EXTERNAL_TORQUE, self._on_torque, names.LATEST)
        self.create_service(Trigger, names.RESET, self._on_reset)
        self.create_service(SetBool, names.PAUSE, self._on_pause)
        self.get_logger().info(self._configured())
        self._advance = DeferredTrigger(
            self, names.ADVANCE, lambda reply: self._time_base.advance(self.values["advance_samples"], reply)
        )
        self._settled, self._namesake = time.monotonic() + SETTLING, Namesake(self, names.JOINT_STATES, JointState)
        self._looking = self.create_timer(LOOK_PERIOD, self._look, clock=names.STEADY)

    def stop(self) -> None:
        """Publish the final counters."""
        self._health.at(self._time_base.plant.shown)
        self._health.publish()

    def end(self, error: FjrError) -> None:
        """Reply to waiting clients, and end the node."""
        self._time_base.end_advance(False, "ended")
        super().end(error)

    def destroy_node(self) -> None:
        """Stop serving commands and destroy the node."""
        if hasattr(self, "_time_base"):
            self._time_base.close()
        super().destroy_node()

    def changed(self, values: dict[str, Any], names: set[str]) -> None:
        """Apply new imperfections, and put or take away the obstacle, from now on; an FjrError refuses them."""
        if OBSTACLE_PRESENT in names and values[OBSTACLE_TYPE] != NONE:
            self._time_base.change(lambda: self._robot.obstruct(values[OBSTACLE_PRESENT]))
        if any(name.startswith("imperfections.") for name in names):
            motion, sensors, messages = errors_of(values, self._model)

            def change() -> None:
                self._robot.change(motion, sensors)
                self._transport.change(*messages)

            self._time_base.change(change)

    def _refuse_another(self) -> None:
        """Raise PlantConflictError if another process publishes states of a joint, before this one does."""
        topic, joints = self.resolve_topic_name(names.JOINT_STATES), set(self.values["joints"])
        if other := publisher_elsewhere(self, topic, JointState, lambda state: set(state.name) & joints):
            raise self._conflict(other)

    def _look(self) -> None:
        """Raise PlantConflictError for a plant of the same name that is discovered late; an older one goes on."""
        if self._namesake.heard():
            raise self._conflict(self.get_fully_qualified_name())
        if not self._namesake.listed() and time.monotonic() > self._settled:
            self._namesake.close()
            self._looking.cancel()

    def _conflict(self, other: str) -> PlantConflictError:
        return PlantConflictError(
            f"states of {', '.join(self.values['joints'])} are published on "
            f"{self.resolve_topic_name(names.JOINT_STATES)} by {other}; expected one robot: stop it, set "
            "another ROS_DOMAIN_ID, or start this one with -r __ns:=/NAME"
        )

    def _configured(self) -> str:
        values = self.values
        topic = self.resolve_topic_name(names.JOINT_COMMANDS if values["lockstep"] else names.EFFORT_COMMANDS)
        awaited = f" waiting for commands on {topic} in ROS domain {loading.domain()}"
        waits = " paused" if values["start_paused"] else awaited
        time = "in lock-step" if values["lockstep"] else "with the clock"
        return f"configured: {', '.join(values['joints'])} at {values['publish_rate']:g} Hz {time};{waits}"

    def _on_torque(self, message: JointState) -> None:
        try:
            torque = read_torques(message, self.values["joints"])
        except MessageError as error:
            self._health.note("warn", *refusal("external torque", error))
            return
        self._health.count[TORQUES] += 1
        self._time_base.change(lambda: setattr(self._robot, "external", torque))

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._time_base.reset()
        response.success = True
        response.message = "the robot is back at its initial state"
        return response

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._time_base.pause(request.data)
        response.success = True
        response.message = "paused" if self._time_base.paused else "running"
        return response


def main(args: list[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM; return the exit code."""
    return process.run(lambda: PlantNode(participant.discovered_at()), args)


if __name__ == "__main__":
    sys.exit(main())
