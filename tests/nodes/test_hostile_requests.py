# SPDX-License-Identifier: Apache-2.0
"""No request and no message from outside ends a node or raises through its executor; the controller tracks on."""

from __future__ import annotations

from typing import Any

import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rosgraph_msgs.msg import Clock
from type_description_interfaces.srv import GetTypeDescription

from nodes.harness import Ros, stamped
from nodes.managed import Manager

NAMES = ([], [""], ["not.there"], ["gains.K_ld", "not.there"], ["a\0b"], ["x" * 10_000], ["not.there"] * 1000)
VALUES = (
    ParameterValue(type=99),
    ParameterValue(type=0),
    ParameterValue(type=1, bool_value=True),
    ParameterValue(type=3, double_value=float("nan")),
    ParameterValue(type=4, string_value="x" * 10_000),
    ParameterValue(type=8, double_array_value=[1.0] * 10_000),
    ParameterValue(type=8),
)
SET = (
    "gains.K_ld",
    "imperfections.effort_delay",
    "use_sim_time",
    "start_type_description_service",
    "joints",
    "",
    "a\0b",
)


pytestmark = pytest.mark.usefixtures("either_executor")
each_node = pytest.mark.parametrize(
    ("name", "either_executor"), [("fjr_controller", "events"), ("fjr_plant", "single")], indirect=["either_executor"]
)


@pytest.fixture
def tracking(ros: Ros, manager: Manager) -> Any:
    """Give a controller that answers states."""
    return manager.started()


def test_a_transition_that_is_not_possible_now_is_refused(ros: Ros, manager: Manager, tracking: Any, capfd) -> None:
    for number, label in ((1, ""), (3, ""), (99, ""), (0, ""), (255, ""), (3, "activate"), (4, "no_such_transition")):
        asked = Transition(id=number, label=label)
        answer = manager.call(ChangeState, "fjr_controller/change_state", transition=asked)
        assert not answer.success
        what = repr(label) if label else number
        said = capfd.readouterr().err
        assert said.count("transition is") == 1
        assert f"transition is {what} in the state active; expected one of deactivate, shutdown" in said
    assert tracking.state == "active"
    manager.ask(stamped(0.001))
    assert manager.change("deactivate"), "what is possible still works"


@each_node
def test_malformed_requests_for_parameters_are_answered(ros: Ros, manager: Manager, name: str) -> None:
    node = ros.controller() if name == "fjr_controller" else ros.plant()
    before = {key: node.get_parameter(key).value for key in node.get_parameters_by_prefix("")}
    for names in NAMES:
        for kind, service, field in (
            (GetParameters, "get_parameters", "values"),
            (DescribeParameters, "describe_parameters", "descriptors"),
            (GetParameterTypes, "get_parameter_types", "types"),
        ):
            found = getattr(manager.call(kind, f"{name}/{service}", names=names), field)
            assert len(found) == len(names)
    for prefixes, depth in (([], 2**64 - 1), ([""], 1), (["x" * 10_000], 0)):
        manager.call(ListParameters, f"{name}/list_parameters", prefixes=prefixes, depth=depth)
    for key in SET:
        for value in VALUES:
            many = [Parameter(name=key, value=value)] * 2
            results = manager.call(SetParameters, f"{name}/set_parameters", parameters=many).results
            assert len(results) == 2
            together = manager.call(
                SetParametersAtomically, f"{name}/set_parameters_atomically", parameters=many
            ).result
            for result in (*results, together):
                assert result.successful != bool(result.reason), "a refusal says why"
    assert manager.call(SetParameters, f"{name}/set_parameters").results == []
    for kind in ("", "nonsense", "sensor_msgs/msg/JointState"):
        fields = {"type_name": kind, "type_hash": "RIHS01_" + "0" * 64}
        assert not manager.call(GetTypeDescription, f"{name}/get_type_description", **fields).successful
    assert {key: node.get_parameter(key).value for key in node.get_parameters_by_prefix("")} == before


def test_an_unknown_type_refuses_its_parameter_and_those_after_it(ros: Ros, manager: Manager, tracking: Any) -> None:
    name = "limits.tracking_error"
    good, bad = ParameterValue(type=8, double_array_value=[30.0]), ParameterValue(type=99)
    asked = [Parameter(name=name, value=value) for value in (good, bad, good)]
    results = manager.call(SetParameters, "fjr_controller/set_parameters", parameters=asked).results
    assert [result.successful for result in results] == [True, False, False]
    assert "99 is not a valid Parameter.Type" in results[1].reason
    assert tracking.get_parameter(name).value.tolist() == [30.0]
    manager.ask(stamped(0.001))


@each_node
def test_a_clock_before_1970_is_refused(ros: Ros, manager: Manager, name: str) -> None:
    publisher, message = manager.create_publisher(Clock, "/clock", 10), Clock()
    node = ros.controller(use_sim_time=True) if name == "fjr_controller" else ros.plant(use_sim_time=True)
    message.clock.sec = -5
    publisher.publish(message)
    ros.until(lambda: node.unexpected, "the refusal")
    assert "must not be negative" in str(node.unexpected)
    message.clock.sec = 7
    publisher.publish(message)
    ros.until(lambda: node.get_clock().now().nanoseconds == 7 * 10**9, "the time")
