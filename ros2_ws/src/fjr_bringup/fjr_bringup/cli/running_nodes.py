# SPDX-License-Identifier: Apache-2.0
"""`fjr call`, `fjr set`, `fjr lifecycle` and `fjr send`: services of running nodes, and a motion for a controller.

The first three stand in for the command `ros2`.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions, GetState
from rcl_interfaces.srv import DescribeParameters, SetParameters
from rclpy.parameter import parameter_value_to_python

from fjr_bringup.clients import ClientError, ServiceClient, TrajectoryClient
from fjr_core.config import ros_yaml
from fjr_core.config.controller import effort_limits
from fjr_core.config.motion_warnings import motion_warnings
from fjr_core.config.reference import motion_of_file
from fjr_core.errors import ParameterError
from fjr_core.motions.spline import SampledMotion, waypoints
from fjr_design.cli.preflight import as_list
from fjr_monitor.recording.topics import absolute
from fjr_msgs_py.console.ending import stoppable
from fjr_msgs_py.console.output import Result, tell
from fjr_msgs_py.console.ros2 import discover_quickly, refuse_over_ros2
from fjr_msgs_py.messages.plain import fill, parameter_message, plain
from fjr_msgs_py.messages.trajectories import trajectory_message
from fjr_msgs_py.node.participant import own_node
from fjr_msgs_py.scenarios import library

EXACT = 1e-6  # rad; largest difference between the smoothed motion and that of the transmitted points


@contextmanager
def _services(command: str, advantage: str, force: bool, timeout: float) -> Iterator[ServiceClient]:
    """Yield a client of services with a node of its own; refuse where the `command` of ros2 is, unless forced."""
    refuse_over_ros2(command, advantage, force)
    discover_quickly()
    with own_node("fjr_client") as node, closing(ServiceClient(node, timeout)) as services:
        yield services


def call_service(service: str, request: str, timeout: float, force: bool) -> Result:
    """Call a service of any installed type; return the fields of its response.

    request: the fields as YAML, or the value of the only field. Raises ParameterError for a text that does not fit
    the request, ClientError if the service does not respond or its response has `success: false`.
    """
    command = shlex.join(["ros2", "service", "call", service, "TYPE", *filter(None, [request])])
    with _services(command, "with any type", force, timeout) as services:
        service = absolute(service, "service", "/fjr_controller/hold")
        given = ros_yaml.parse(request) if request else {}
        client = services.find(service)
        message = client.srv_type.Request(check_fields=True)
        fields = list(message.get_fields_and_field_types())
        fill(message, {fields[0]: given} if len(fields) == 1 and not isinstance(given, dict) else given)
        response: dict[str, Any] = plain(services.call(client, message))
    if response.get("success") is False:
        raise ClientError(f"{service} refused: {response.get('message') or 'no reason given'}")
    return Result(yaml.safe_dump(response, sort_keys=False).rstrip(), response)


def set_value(node: str, parameter: str, value: str, timeout: float, force: bool) -> Result:
    """Set a parameter to a value given as YAML, of the type that the node declares.

    Raises ParameterError if the text is not of that type, ClientError with the node's reason if it refuses.
    """
    command = f"ros2 param set {node} {parameter} {shlex.quote(value)}"
    with _services(command, "with get, list, describe and dump", force, timeout) as services:
        of = absolute(node, "node", "/fjr_controller")
        setter, describer = services.find(f"{of}/set_parameters"), services.find(f"{of}/describe_parameters")
        declared = services.ask(describer, DescribeParameters.Request(names=[parameter])).descriptors
        if not declared:
            raise ClientError(f"{of} has no parameter {parameter}")
        message = parameter_message(parameter, declared[0].type, value)
        result = services.call(setter, SetParameters.Request(parameters=[message])).results[0]
    if not result.successful:
        raise ClientError(f"{of} refused {parameter}: {result.reason or 'no reason given'}")
    sent = parameter_value_to_python(message.value)
    return Result(f"{node} {parameter}: {sent}", {"node": node, "parameter": parameter, "value": sent})


def change_state(node: str, transition: str | None, timeout: float, force: bool) -> Result:
    """Read the state of a managed node, after a transition if one is named; raises ClientError if that fails."""
    verb = f"set {node} {transition}" if transition else f"get {node}"
    with _services(f"ros2 lifecycle {verb}", "with list and nodes", force, timeout) as services:
        node = absolute(node, "node", "/fjr_controller")

        def seen() -> tuple[str, dict[str, int]]:
            """Return the state and the transitions that the node offers, id by name."""
            state = services.ask(services.find(f"{node}/get_state"), GetState.Request()).current_state.label
            getter = services.find(f"{node}/get_available_transitions")
            offered = services.ask(getter, GetAvailableTransitions.Request()).available_transitions
            return state, {each.transition.label: each.transition.id for each in offered}

        state, transitions = seen()
        if transition is not None:
            if transition not in transitions:
                offered = ", ".join(transitions) or "none"
                raise ClientError(f"{node} is {state} and has no transition '{transition}'; expected {offered}")
            changer, request = services.find(f"{node}/change_state"), ChangeState.Request()
            request.transition.id = transitions[transition]
            succeeded = services.call(changer, request).success
            state, transitions = seen()
            if not succeeded:
                raise ClientError(
                    f"{node} did not {transition}: it is {state}; its log and diagnostics give the reason"
                )
    text = f"{node} is {state}; transitions: {', '.join(transitions) or 'none'}"
    return Result(text, {"node": node, "state": state, "transitions": list(transitions)})


def send_motion(
    motion: Path, scenario: str | None, lead: float, tolerance: tuple[float, ...], namespace: str, controller: str
) -> Result:
    """Send the motion; its first sample is reached `lead` [s] after the controller accepts it.

    tolerance [rad, m]: largest distance from the samples, for all joints or for each.
    Print the warnings of docs/references.md if a scenario is given. Raises ParameterError for a file that is not valid,
    ClientError if the controller does not respond or refuses.
    """
    discover_quickly()
    node = absolute(f"{namespace.strip('/')}/{controller}".lstrip("/"))
    with stoppable() as stop, own_node("fjr_send") as own, closing(TrajectoryClient(own, node, stop)) as client:
        smooth = motion_of_file(str(motion), tolerance, client.joints)
        warnings = _warnings(smooth, scenario, client.joints) if scenario else []
        for sentence in warnings:
            tell(sentence)
        times, rows = waypoints(smooth, EXACT)
        client.send(trajectory_message(client.joints, times + lead, *rows))
    described = f"interpolated, {np.size(smooth.times)} samples"
    if smooth.smoothed:
        described = f"smoothed within {np.max(smooth.deviation):.2g} of the samples"
    end, rest = lead + smooth.end, rows[0, -1]
    sent = f"{len(times)} points, first sample after {lead:g} s, at rest after {end:.6g} s at {as_list(rest)}"
    values = {"controller": node, "points": len(times), "lead_s": lead, "rest_s": end, "rest": rest}
    return Result(f"accepted: {described}; {sent} rad (m)", {**values, "warnings": warnings})


def _warnings(motion: SampledMotion, scenario: str, joints: tuple[str, ...]) -> list[str]:
    """Return the warnings of a motion for the robot of a scenario."""
    loaded = library.load(scenario, robot_only=True)
    if loaded.joints != joints:
        raise ParameterError(f"{loaded.name} has the joints {loaded.joints}; expected {joints}, as the controller")
    return motion_warnings(motion, loaded.robot, joints, effort_limits(loaded.controller_values, loaded.robot))
