# SPDX-License-Identifier: Apache-2.0
"""The v-dPBC tracking controller as a managed ROS 2 node: one effort u(x, x, t) for every JointState."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable
from typing import Any

from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn

from fjr_core import FjrError
from fjr_core.config.controller import controller_parameters
from fjr_core.config.nodes import CONTROLLER
from fjr_core.config.process import process_parameters, process_settings
from fjr_core.runtime.events import Event
from fjr_msgs_py import names
from fjr_msgs_py.node import loading, participant, process
from fjr_msgs_py.node.parameters import ManagedParameterNode
from fjr_msgs_py.node.reports import EventWriter

from .command_loop import CONFLICTS, CommandConflictError
from .components import Control

SUCCESS, FAILURE, ERROR = (getattr(TransitionCallbackReturn, name) for name in ("SUCCESS", "FAILURE", "ERROR"))


class ControllerNode(ManagedParameterNode):
    """Publish efforts on /effort_controller/commands and, with stamp and names, on /joint_commands.

    unconfigured: all parameters may change. inactive: the law is built; nothing is computed or sent. active: there is
    one command per state, trajectories and services are accepted, gains and limits may change between two states. At
    the end of the active state the stop effort (`on_stop`) is sent. With `autostart` the constructor configures and
    activates the node, and raises an error of either.
    """

    trouble: Exception | None = None
    """Error of the last transition, None if it succeeded."""

    def __init__(self, since: float = 0.0, **node_kwargs: Any) -> None:
        """Create the node; since [s, steady clock]: states that arrive earlier are not answered."""
        self._since = since
        self._control: Control | None = None
        self._starting = False  # in the constructor: errors are raised instead of logged
        super().__init__(CONTROLLER, controller_parameters, **node_kwargs)

    def may_wait(self) -> bool:
        """Return True if invalid parameters may be corrected while the node runs: without autostart."""
        return self._given.get("autostart", True) is False

    def is_open(self) -> bool:
        """Return True if every parameter may change."""
        return self.state == "unconfigured"

    @property
    def state(self) -> str:
        """Return the label of the lifecycle state."""
        return str(self._state_machine.current_state[1])

    def build(self) -> None:
        """Configure and activate with autostart; raise the error of a transition that fails."""
        self._events = EventWriter(self)
        if self.fault is not None:
            self.values = {parameter.name: parameter.default for parameter in process_parameters()}
            self.get_logger().error(f"waiting for valid parameters: {self.fault}")
        elif self.values["autostart"]:
            self._starting = True
            for trigger in (self.trigger_configure, self.trigger_activate):
                if trigger() != SUCCESS and self.trouble is not None:
                    raise self.trouble
            self._starting = False

    def changed(self, values: dict[str, Any], names: set[str]) -> None:
        """Apply gains, limits and the built-in reference together; on a FjrError change nothing."""
        if self._control is not None:
            self._control.change(values, names)

    def end(self, error: FjrError) -> None:
        """Deactivate, which sends the stop effort, and end the node."""
        if self.state == "active":
            self.trigger_deactivate()
        super().end(error)

    def stop(self) -> None:
        """Shut down: send the stop effort and the counters."""
        if self.state in ("unconfigured", "inactive", "active"):
            self.trigger_shutdown()

    def destroy_node(self) -> None:
        """Destroy the controller first: rclpy's Node knows neither its action server nor its native loop."""
        if self._control is not None:
            self._control.destroy()
        self._control = None
        super().destroy_node()

    def on_configure(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Check all parameters and build the law."""
        return self._attempt("configured", self._configure)

    def on_activate(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Start tracking at the next state."""
        return self._attempt("activated", self._activate)

    def on_deactivate(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Send the stop effort."""
        return self._attempt("deactivated", self._deactivate)

    def on_cleanup(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Destroy what was configured."""
        return self._attempt("cleaned up", self._clean_up)

    def on_shutdown(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Send the stop effort and the counters."""
        return self._attempt("shut down", self._deactivate)

    def on_error(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Send the stop effort if a command was sent before, destroy what was configured, and become unconfigured."""
        return self._attempt("cleaned up after an error", self._clean_up)

    def _attempt(self, done: str, act: Callable[[], str]) -> TransitionCallbackReturn:
        """Run `act` as a transition; log its sentence and publish it on ~/events.

        Return FAILURE for an FjrError, with its sentence in the log, and ERROR for any other, with a traceback.
        """
        self.trouble = None
        try:
            sentence = f"{done}: {act()}"
        except FjrError as error:
            self.trouble = error
            self._events.publish("error", "transition failed", str(error))
            if not self._starting:
                self.get_logger().error(str(error))
            return FAILURE
        except Exception as error:
            self.trouble = error
            self._events.publish("error", "transition failed", repr(error))
            self.get_logger().error("".join(traceback.format_exception(error)))
            return ERROR
        self.get_logger().info(sentence)
        self._events.publish("info", done, sentence)
        return SUCCESS

    def _configure(self) -> str:
        if not self._starting:
            self.recheck()
        process_settings(self.values)
        self._control = Control(self, self.values, self._events, self._on_conflict)
        self.built()
        return f"law {self.values['law.type']} for {', '.join(self.values['joints'])}"

    def _activate(self) -> str:
        assert self._control is not None
        self._control.start(self._since)
        return f"waiting for states on {self.resolve_topic_name(names.JOINT_STATES)} in ROS domain {loading.domain()}"

    def _deactivate(self) -> str:
        if self._control is not None:
            self._control.stop()
        return "no further efforts are sent"

    def _clean_up(self) -> str:
        if self._control is not None:
            self._control.close()
            self._control = None
        return "all parameters may change"

    def _on_conflict(self, error: CommandConflictError) -> None:
        """Deactivate because another process commands the robot; end the node with autostart."""
        assert self._control is not None
        self._control.reports.event(Event("error", CONFLICTS, str(error)))
        self.trigger_deactivate()
        self.trouble = error
        if self.values["autostart"]:
            self.end(error)


def main(args: list[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM; return the exit code."""
    return process.run(lambda: ControllerNode(participant.discovered_at()), args)


if __name__ == "__main__":
    sys.exit(main())
