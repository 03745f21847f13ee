# SPDX-License-Identifier: Apache-2.0
"""`fjr call`, `fjr set` and `fjr lifecycle`: the services of running nodes, in place of the command `ros2`."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import Any

import yaml
from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions, GetState
from rcl_interfaces.srv import DescribeParameters, SetParameters
from rclpy.parameter import parameter_value_to_python

from fjr_bringup.clients import ClientError, ServiceClient
from fjr_core.config import ros_yaml
from fjr_monitor.recording.topics import absolute
from fjr_msgs_py.console.output import Result
from fjr_msgs_py.console.ros2 import discover_quickly, refuse_over_ros2
from fjr_msgs_py.messages.plain import fill, parameter_message, plain
from fjr_msgs_py.node.participant import own_node


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
