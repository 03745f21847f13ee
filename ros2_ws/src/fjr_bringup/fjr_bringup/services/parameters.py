# SPDX-License-Identifier: Apache-2.0
"""`fjr set`: set a parameter of a running node."""

from __future__ import annotations

from typing import Any

from rcl_interfaces.srv import DescribeParameters, SetParameters

from fjr_bringup.services.client import ServiceError, service_client
from fjr_monitor.recording.topics import absolute
from fjr_msgs_py.messages.parameters import parameter_message, parameter_value


def set_parameter(node: str, parameter: str, text: str, timeout: float) -> Any:
    """Set a parameter to a value given as YAML, of the type that the node declares; return the value as sent.

    Raise ParameterError if the text is not of that type, ServiceError with the node's reason if it refuses.
    """
    node = absolute(node, "node", "/fjr_controller")
    with service_client(timeout) as services:
        setter, describer = services.find(f"{node}/set_parameters"), services.find(f"{node}/describe_parameters")
        found = services.ask(describer, DescribeParameters.Request(names=[parameter])).descriptors
        if not found:
            raise ServiceError(f"{node} has no parameter {parameter}")
        message = parameter_message(parameter, found[0].type, text)
        result = services.call(setter, SetParameters.Request(parameters=[message])).results[0]
    if not result.successful:
        raise ServiceError(f"{node} refused {parameter}: {result.reason or 'no reason given'}")
    return parameter_value(message)
