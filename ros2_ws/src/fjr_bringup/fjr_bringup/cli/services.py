# SPDX-License-Identifier: Apache-2.0
"""`fjr call`, `fjr set` and `fjr lifecycle`: the services of running nodes."""

from __future__ import annotations

import shlex

import yaml

from fjr_bringup.services.call import call
from fjr_bringup.services.lifecycle import lifecycle
from fjr_bringup.services.parameters import set_parameter
from fjr_msgs_py.console.output import Result
from fjr_msgs_py.console.ros2 import discover_quickly, refuse_over_ros2


def call_service(service: str, request: str, timeout: float, force: bool) -> Result:
    """Call a service with the fields of its request as YAML; return its response."""
    command = shlex.join(["ros2", "service", "call", service, "TYPE", *filter(None, [request])])
    refuse_over_ros2(command, "with any type", force)
    discover_quickly()
    response = call(service, request, timeout)
    return Result(yaml.safe_dump(response, sort_keys=False).rstrip(), response)


def set_value(node: str, parameter: str, value: str, timeout: float, force: bool) -> Result:
    """Set a parameter of a running node."""
    command = f"ros2 param set {node} {parameter} {shlex.quote(value)}"
    refuse_over_ros2(command, "with get, list, describe and dump", force)
    discover_quickly()
    found = set_parameter(node, parameter, value, timeout)
    return Result(f"{node} {parameter}: {found}", {"node": node, "parameter": parameter, "value": found})


def change_state(node: str, transition: str | None, timeout: float, force: bool) -> Result:
    """Read the state of a managed node, or change it."""
    verb = f"set {node} {transition}" if transition else f"get {node}"
    refuse_over_ros2(f"ros2 lifecycle {verb}", "with list and nodes", force)
    discover_quickly()
    found = lifecycle(node, transition, timeout)
    text = f"{found.node} is {found.state}; transitions: {', '.join(found.transitions) or 'none'}"
    return Result(text, {"node": found.node, "state": found.state, "transitions": list(found.transitions)})
