# SPDX-License-Identifier: Apache-2.0
"""Every test process has a ROS domain of its own, leased for as long as the process lives."""

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

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy loads: more threads only wait on small matrices

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

settings.register_profile("any machine", settings(), deadline=None)  # no example is too slow: others may use the cores
settings.load_profile("any machine")

TURN = Path(tempfile.gettempdir(), f"fjr-real-time-{os.getuid()}.lock")


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Tests whose nodes must keep up with the clock have the machine for themselves, among all test processes.

    Where real-time scheduling is allowed their nodes leave little to others, and wait for locks of Fast DDS that others
    hold. Waiting for the turn is not part of a test's timeout.
    """
    with TURN.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX if item.get_closest_marker("real_time") else fcntl.LOCK_SH)
        return (yield)


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> None:
    """Leave what a finished module has built out of later garbage collections, which else stop a peer for seconds."""
    if nextitem is None or nextitem.path != item.path:
        gc.collect()
        gc.freeze()


@pytest.fixture
def ros() -> Iterator[Any]:
    """A ROS context, an executor and the nodes of one test."""
    from nodes.harness import Ros  # rclpy reads the environment set above

    made = Ros()
    yield made
    made.close()
