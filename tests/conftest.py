# SPDX-License-Identifier: Apache-2.0
"""Lease a separate ROS domain for each test process until it ends."""

from __future__ import annotations

import atexit
import fcntl
import gc
import os
import shutil
import socket
import tempfile
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy loads: more threads only add delay for small matrices

LEASE_PORTS = range(47001, 47100)  # one TCP port on 127.0.0.1 per domain id 1..99; the kernel frees it on any death


def _lease_domain() -> tuple[int, socket.socket]:
    for port in LEASE_PORTS:
        lease = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            lease.bind(("127.0.0.1", port))
        except OSError:
            lease.close()
            continue
        return port - LEASE_PORTS.start + 1, lease
    raise RuntimeError("all ROS domain ids 1..99 are leased by other test processes")


DOMAIN, _lease = _lease_domain()
atexit.register(_lease.close)
os.environ["ROS_DOMAIN_ID"] = str(DOMAIN)
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_LOG_DIR"] = tempfile.mkdtemp(prefix="fjr-test-log-")
atexit.register(shutil.rmtree, os.environ["ROS_LOG_DIR"], ignore_errors=True)
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"

settings.register_profile("any machine", settings(), deadline=None)  # no deadline: other processes may use the cores
settings.load_profile("any machine")

TURN = Path(tempfile.gettempdir(), f"fjr-real-time-{os.getuid()}.lock")


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Run tests with the marker real_time alone among all test processes.

    With real-time scheduling their nodes would starve other processes and wait for locks of Fast DDS that those hold.
    Waiting for the lock does not count for the timeout of a test.
    """
    with TURN.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX if item.get_closest_marker("real_time") else fcntl.LOCK_SH)
        return (yield)


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> None:
    """Exempt the objects of a finished module from garbage collection, which would stop a peer for seconds."""
    if nextitem is None or nextitem.path != item.path:
        gc.collect()
        gc.freeze()


@pytest.fixture
def ros() -> Iterator[Any]:
    """Provide a ROS context, an executor and the nodes of one test."""
    from nodes.harness import Ros  # rclpy reads the environment set above

    made = Ros()
    yield made
    made.close()
