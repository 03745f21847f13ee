# SPDX-License-Identifier: Apache-2.0
"""`fjr lifecycle`: read or change the state of a managed node."""

from __future__ import annotations

from dataclasses import dataclass

from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions, GetState

from fjr_bringup.services.client import ServiceClient, ServiceError, service_client
from fjr_monitor.recording.topics import absolute


@dataclass(frozen=True)
class Lifecycle:
    """The state of a managed node and the transitions that it offers, id by name."""

    node: str
    state: str
    transitions: dict[str, int]


def lifecycle(node: str, transition: str | None, timeout: float) -> Lifecycle:
    """Return the state of a node, after a transition if one is named; raise ServiceError if the transition fails."""
    node = absolute(node, "node", "/fjr_controller")
    with service_client(timeout) as services:
        found = _read(services, node)
        if transition is None:
            return found
        if transition not in found.transitions:
            offered = ", ".join(found.transitions) or "none"
            raise ServiceError(f"{node} is {found.state} and has no transition '{transition}'; expected {offered}")
        changer, request = services.find(f"{node}/change_state"), ChangeState.Request()
        request.transition.id = found.transitions[transition]
        succeeded = services.call(changer, request).success
        found = _read(services, node)
    if not succeeded:
        raise ServiceError(f"{node} did not {transition}: it is {found.state}; its log and diagnostics give the reason")
    return found


def _read(services: ServiceClient, node: str) -> Lifecycle:
    state = services.ask(services.find(f"{node}/get_state"), GetState.Request()).current_state.label
    getter = services.find(f"{node}/get_available_transitions")
    offered = services.ask(getter, GetAvailableTransitions.Request()).available_transitions
    return Lifecycle(node, state, {each.transition.label: each.transition.id for each in offered})
