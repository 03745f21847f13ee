# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import pytest

from nodes.harness import Peer, Ros

BOTH_HOSTS = ("test_controller_node", "test_lock_step")
"""Files whose tests run with the loops of the nodes in rclpy and with the native ones."""
NATIVE = (
    "test_advance",
    "test_certificate",
    "test_clock_owner",
    "test_conflicting_publishers",
    "test_follow_action",
    "test_lifecycle",
    "test_limits_over_ros",
    "test_other_laws",
    "test_plant_imperfections",
    "test_plant_node",
    "test_stamps_of_states",
    "test_trajectories",
)
"""Files whose tests run with the native loops; in all others a test chooses, rclpy by default."""


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run the tests of BOTH_HOSTS twice."""
    file = metafunc.definition.path.stem
    if file in (*BOTH_HOSTS, *NATIVE) and "ros" in metafunc.fixturenames:
        metafunc.parametrize("host", ["events", "native"] if file in BOTH_HOSTS else ["native"], indirect=True)


@pytest.fixture(autouse=True)
def host(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Set the host of the nodes of a test."""
    kind = str(getattr(request, "param", "events"))
    monkeypatch.setattr(Ros, "host", kind)
    return kind


@pytest.fixture
def peer(ros: Ros) -> Peer:
    return Peer(ros)
