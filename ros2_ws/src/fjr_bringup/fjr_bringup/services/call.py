# SPDX-License-Identifier: Apache-2.0
"""`fjr call`: call any service of an installed type."""

from __future__ import annotations

from typing import Any

from fjr_bringup.services.client import ServiceError, service_client
from fjr_core.config import ros_yaml
from fjr_monitor.recording.topics import absolute
from fjr_msgs_py.messages.plain import fill, plain


def call(service: str, text: str, timeout: float) -> dict[str, Any]:
    """Call a service with the fields of its request as YAML; return the fields of the response.

    text: a mapping, or the value of the only field of the request. Raise ParameterError for a text that does not fit
    the request, ServiceError if the service does not respond or its response has `success: false`.
    """
    service, values = absolute(service, "service", "/fjr_controller/hold"), ros_yaml.parse(text) if text else {}
    with service_client(timeout) as services:
        client = services.find(service)
        request = client.srv_type.Request(check_fields=True)
        fields = list(request.get_fields_and_field_types())
        if len(fields) == 1 and not isinstance(values, dict):
            values = {fields[0]: values}
        fill(request, values)
        response: dict[str, Any] = plain(services.call(client, request))
    if response.get("success") is False:
        raise ServiceError(f"{service} refused: {response.get('message') or 'no reason given'}")
    return response
