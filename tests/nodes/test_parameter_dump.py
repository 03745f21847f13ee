# SPDX-License-Identifier: Apache-2.0
"""Parameters as `ros2 param dump`, `load` and `describe` handle them, by the services of both nodes in every state."""

from __future__ import annotations

from typing import Any

import pytest
from rcl_interfaces.msg import Parameter, ParameterDescriptor
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.parameter import Parameter as RosParameter

from fjr_core.config.controller import controller_parameters
from fjr_core.config.nodes import all_parameters
from fjr_core.config.plant import plant_parameters
from nodes.harness import Peer, Ros
from nodes.managed import Manager
from nodes.plants import call

STATES: dict[str, tuple[str, ...]] = {
    "unconfigured": (),
    "inactive": ("configure",),
    "active": ("configure", "activate"),
}


def dump(ros: Ros, peer: Peer, node: str) -> list[Parameter]:
    names = call(ros, peer, ListParameters, f"{node}/list_parameters").result.names
    values = call(ros, peer, GetParameters, f"{node}/get_parameters", names=names).values
    return [Parameter(name=name, value=value) for name, value in zip(names, values, strict=True)]


def load(ros: Ros, peer: Peer, node: str, parameters: list[Parameter]) -> list[str]:
    """Set parameters as `ros2 param load` does; return the reasons of refusals."""
    results = call(ros, peer, SetParameters, f"{node}/set_parameters", parameters=parameters).results
    return [result.reason for result in results if not result.successful]


def other(name: str, value: Any) -> list[Parameter]:
    return [RosParameter(name, value=value).to_parameter_msg()]


@pytest.mark.parametrize("lockstep", [True, False])
def test_a_plant_loads_its_own_dump(ros: Ros, peer: Peer, lockstep: bool) -> None:
    ros.plant(lockstep=lockstep)
    parameters = dump(ros, peer, "fjr_plant")
    assert len(parameters) > 40
    assert load(ros, peer, "fjr_plant", parameters) == []
    assert dump(ros, peer, "fjr_plant") == parameters
    (refused,) = load(ros, peer, "fjr_plant", other("publish_rate", 500.0))
    assert refused


@pytest.mark.parametrize("state", STATES)
def test_controller_loads_its_own_dump_without_any_change(ros: Ros, state: str) -> None:
    manager = Manager(ros)
    ros.controller(autostart=False)
    for transition in STATES[state]:
        assert manager.change(transition)
    parameters = dump(ros, manager, "fjr_controller")
    assert len(parameters) > 80
    assert load(ros, manager, "fjr_controller", parameters) == []
    assert dump(ros, manager, "fjr_controller") == parameters
    ros.settle()
    assert not {"gains changed", "settings changed"} & set(manager.kinds())
    refused = load(ros, manager, "fjr_controller", other("state_timeout", 1.5))
    assert bool(refused) == (state != "unconfigured")


@pytest.mark.parametrize("node", ["fjr_plant", "fjr_controller"])
def test_parameter_descriptions_state_when_a_value_can_change(ros: Ros, peer: Peer, node: str) -> None:
    managed = node == "fjr_controller"
    (ros.controller if managed else ros.plant)()
    own = controller_parameters if managed else plant_parameters
    table = {parameter.name: parameter for parameter in all_parameters(own, {})}
    answer = call(ros, peer, DescribeParameters, f"{node}/describe_parameters", names=list(table))
    for descriptor in answer.descriptors:
        described: ParameterDescriptor = descriptor
        dynamic = table[described.name].dynamic
        assert described.read_only == (not dynamic and not managed)
        says = {
            (True, True): "may change while the node is active",
            (True, False): "may change only while the node is unconfigured",
            (False, True): "may change while the node runs",
            (False, False): "fixed while the node runs",
        }[managed, dynamic]
        assert described.additional_constraints.endswith(says), described.name
