# SPDX-License-Identifier: Apache-2.0
"""Two arms in lock-step in one ROS domain, each with a separate clock."""

from __future__ import annotations

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock

from nodes.harness import Ros
from system.executables import Executable, Start

pytestmark = pytest.mark.system

ARMS = ("left", "right")
SAMPLES = 300


def started(start: Start, node: str, arm: str, *arguments: str) -> Executable:
    timed = "lockstep:=true" if node == "plant" else "use_sim_time:=true"
    return start(node, "--ros-args", "-r", f"__ns:=/{arm}", "-p", timed, *arguments)


class Observer(Node):
    """Record the different times of some clocks [ns] and the names and hardware ids of all reports."""

    def __init__(self, ros: Ros, *topics: str) -> None:
        super().__init__("observer", context=ros.context)
        ros.add(self)
        self.times: dict[str, list[int]] = {topic: [] for topic in topics}
        self.parts: set[tuple[str, str]] = set()
        deep = QoSProfile(depth=5000)
        for topic, times in self.times.items():
            self.create_subscription(Clock, topic, lambda m, times=times: self._on_clock(m, times), deep)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_report, deep)

    def _on_clock(self, message: Clock, times: list[int]) -> None:
        now = nanoseconds(message)
        if [now] != times[-1:]:
            times.append(now)

    def _on_report(self, message: DiagnosticArray) -> None:
        self.parts |= {(status.name, status.hardware_id) for status in message.status}


def nanoseconds(message: Clock) -> int:
    return message.clock.sec * 10**9 + message.clock.nanosec


def test_two_arms_with_separate_clocks_run_in_parallel_and_are_distinguishable(ros: Ros, start: Start) -> None:
    clocks = [f"/{arm}/clock" for arm in ARMS]
    observer = Observer(ros, *clocks)
    for arm, clock in zip(ARMS, clocks, strict=True):
        for node in ("plant", "controller"):
            started(start, node, arm, "-r", f"/clock:={clock}")
    ros.until(lambda: all(len(times) > SAMPLES for times in observer.times.values()), "both clocks")
    for times in observer.times.values():
        assert times == sorted(times)
    assert observer.count_publishers("/clock") == 0
    parts = ("fjr_plant", "fjr_controller", "fjr_controller: certificate")
    expected = {(f"{arm}/{part}", f"{arm}/single_link") for arm in ARMS for part in parts}
    ros.until(lambda: len(observer.parts) >= len(expected), "the reports of both arms")
    assert observer.parts == expected
