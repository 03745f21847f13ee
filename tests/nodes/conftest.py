# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import pytest
from rclpy.executors import SingleThreadedExecutor

from nodes.harness import Peer, Ros
from nodes.managed import Manager

RCLPY = ("test_parameters", "test_wiring")
"""Files whose tests run in rclpy: they call its callbacks, run Python code, or start many robots without a compiler."""


@pytest.fixture(autouse=True)
def host(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Set the host of the nodes of a test: native ones by default; that both are equal, tests/hosts shows."""
    monkeypatch.setattr(Ros, "host", "events" if request.path.stem in RCLPY else "native")


@pytest.fixture(params=["events", "single"])
def either_executor(ros: Ros, request: pytest.FixtureRequest) -> None:
    """Serve requests with each of rclpy's executors; `usefixtures` puts this before the first node."""
    if request.param == "single":
        ros.executor.shutdown()
        ros.executor = SingleThreadedExecutor(context=ros.context)


@pytest.fixture
def peer(ros: Ros) -> Peer:
    return Peer(ros)


@pytest.fixture
def manager(ros: Ros) -> Manager:
    return Manager(ros)
