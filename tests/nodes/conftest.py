# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import pytest

from nodes.harness import Peer, Ros

BOTH_HOSTS = (
    "test_certificate",
    "test_conflicting_publishers",
    "test_controller_node",
    "test_follow_action",
    "test_lifecycle",
    "test_limits_over_ros",
    "test_other_laws",
    "test_robust_action",
    "test_stamps_of_states",
    "test_trajectories",
)
"""Files whose tests run with the command loop in rclpy and with the native one."""


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run the tests of BOTH_HOSTS twice."""
    if metafunc.definition.path.stem in BOTH_HOSTS and "ros" in metafunc.fixturenames:
        metafunc.parametrize("host", ["events", "native"], indirect=True)


@pytest.fixture(autouse=True)
def host(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Set the host of the control step for the controllers of a test."""
    kind = str(getattr(request, "param", "events"))
    monkeypatch.setattr(Ros, "host", kind)
    return kind


@pytest.fixture
def peer(ros: Ros) -> Peer:
    return Peer(ros)
