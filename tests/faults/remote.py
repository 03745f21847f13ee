# SPDX-License-Identifier: Apache-2.0
"""Act on running nodes like a user: set parameters, advance the plant, publish conflicting efforts."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.task import Future
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from faults.watcher import EFFORTS
from fjr_msgs_py.names import LATEST, PLANT
from nodes.harness import Listener, Ros


class Remote:
    """A node in addition to the watched pair."""

    def __init__(self) -> None:
        self._ros = Ros()
        self._node = Listener(self._ros, only=())
        self.requests: list[tuple[str, int, Mapping[str, Any]]] = []  # node, time [ns], parameters

    def set(self, node: str, values: Mapping[str, Any]) -> str:
        """Set parameters of a node together; return the reason of a refusal, or ""."""
        self.requests.append((node, time.time_ns(), values))
        parameters = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        service = f"{node}/set_parameters_atomically"
        result = self._node.call(SetParametersAtomically, service, parameters=parameters).result
        return "" if result.successful else str(result.reason)

    def get(self, node: str, name: str) -> Any:
        """Return a parameter of a node."""
        (value,) = self._node.call(GetParameters, f"{node}/get_parameters", names=[name]).values
        return parameter_value_to_python(value)

    def advance(self, samples: int) -> Future:
        """Advance a paused plant by a number of samples; the response arrives when they are done."""
        assert self.set(PLANT, {"advance_samples": samples}) == ""
        return self._node.request(Trigger, f"{PLANT}/advance")

    def intrude(self, period: float, joints: int) -> None:
        """Start to publish zero efforts every `period` seconds while `work` is called."""
        publisher = self._node.create_publisher(Float64MultiArray, EFFORTS, LATEST)
        zero = Float64MultiArray(data=[0.0] * joints)
        self._intruder = (self._node.create_timer(period, lambda: publisher.publish(zero)), publisher)

    def retreat(self) -> None:
        """Stop publishing efforts."""
        timer, publisher = self._intruder
        self._node.destroy_timer(timer)
        self._node.destroy_publisher(publisher)

    def work(self) -> None:
        """Process pending events."""
        self._ros.executor.spin_once(timeout_sec=0.0)

    def close(self) -> None:
        self._ros.close()
