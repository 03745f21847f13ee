# SPDX-License-Identifier: Apache-2.0
"""Lease a separate ROS domain for each test process until it ends."""

from __future__ import annotations

import atexit
import faulthandler
import fcntl
import gc
import os
import shutil
import socket
import tempfile
from collections.abc import Generator, Iterator
from functools import cache
from pathlib import Path
from typing import Any, TextIO

import pytest
from hypothesis import settings

from longest_first import LONGEST_FIRST

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

CORE = Path(__file__).parent / "core"
TURN = Path(tempfile.gettempdir(), f"fjr-real-time-{os.getuid()}.lock")
QUEUE = TURN.with_suffix(".queue")
LONGEST_WAIT = 3600.0  # s for a turn
_turn: list[TextIO] = []  # the lock of this process, kept from one real_time test to the next


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Sort the files that take long as listed; within a file the order stays."""
    tests = Path(__file__).parent
    place = {tests / name: number for number, name in enumerate(LONGEST_FIRST)}
    items.sort(key=lambda item: place.get(item.path, len(place)))


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Collect the tests without garbage collection: what is imported is no garbage."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> Generator[None, object, object]:
    """Run tests with the marker real_time alone among all test processes.

    With real-time scheduling their nodes would starve other processes and wait for locks of Fast DDS that those hold.
    Tests of fjr_core start no node and run meanwhile, if the system lets the nodes take precedence. Waiting for the
    lock does not count for the timeout of a test. A process keeps its turn while its next test has the marker too, so
    that the other processes wait only once.
    """
    if item.path.is_relative_to(CORE) and _nodes_take_precedence():
        return (yield)
    alone = _needs_the_clock(item)
    turn = _turn.pop() if _turn else _next_turn(alone)
    try:
        return (yield)
    finally:
        if alone and nextitem is not None and _needs_the_clock(nextitem):
            _turn.append(turn)
        else:
            turn.close()


@cache
def _nodes_take_precedence() -> bool:
    """Return whether the nodes may have real-time priority here."""
    from fjr_msgs_py.node.scheduling import prioritised  # loads NumPy, which the process that distributes tests spares

    with prioritised(1):
        return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO


def _needs_the_clock(item: pytest.Item) -> bool:
    return item.get_closest_marker("real_time") is not None


def _next_turn(alone: bool) -> TextIO:
    """Wait for a turn, alone or with others, in the order of asking: who waits to be alone is not passed by others."""
    turn = TURN.open("w")
    faulthandler.dump_traceback_later(LONGEST_WAIT, exit=True)
    with QUEUE.open("w") as queue:
        fcntl.flock(queue, fcntl.LOCK_EX)
        fcntl.flock(turn, fcntl.LOCK_EX if alone else fcntl.LOCK_SH)
    faulthandler.cancel_dump_traceback_later()
    return turn


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
