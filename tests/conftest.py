# SPDX-License-Identifier: Apache-2.0
"""Isolate each test process, order the tests, and give those that need the clock their turn."""

from __future__ import annotations

import faulthandler
import fcntl
import gc
import os
import tempfile
from collections.abc import Generator, Iterator
from functools import cache
from pathlib import Path
from typing import Any, TextIO

import pytest
from _pytest.faulthandler import fault_handler_stderr_fd_key
from hypothesis import settings

from isolation import end_soon, ends_in_time, isolate
from longest_first import LONGEST_FIRST, unit

isolate()  # before NumPy and rclpy load

settings.register_profile("new draws", deadline=None)  # make test-all; no deadline: other processes may use the cores
settings.register_profile("same draws", deadline=None, derandomize=True)
settings.load_profile("same draws")

WITHOUT_NODES = [
    Path(__file__).parent / name for name in ("core", "design", "monitor", "identification", "physics", "proofs")
]
TURN = Path(tempfile.gettempdir(), f"fjr-real-time-{os.getuid()}.lock")
QUEUE = TURN.with_suffix(".queue")
LONGEST_WAIT = 3600.0  # s for a turn
_turn: list[TextIO] = []  # the lock of this process, kept from one real_time test to the next


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Sort the files that take long as listed, then the others; within a file the order stays.

    Of the others, those whose nodes wait for each other are spread evenly among those that only compute.
    """
    tests = Path(__file__).parent
    place: dict[Path, float] = {tests / name: number for number, name in enumerate(LONGEST_FIRST)}
    others = [path for path in dict.fromkeys(item.path for item in items) if path not in place]
    for with_nodes in (True, False):
        files = [path for path in others if _starts_nodes(path) == with_nodes]
        place |= {path: len(LONGEST_FIRST) + number / len(files) for number, path in enumerate(files)}
    items.sort(key=lambda item: place[item.path])


def _starts_nodes(path: Path) -> bool:
    return not any(map(path.is_relative_to, WITHOUT_NODES))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Give a worker one file after the other, or one long test (longest_first.unit)."""
    from xdist.scheduler import LoadFileScheduling  # only where tests are distributed

    made = LoadFileScheduling(config, log)
    made._split_scope = unit
    return made


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
    Tests in the folders WITHOUT_NODES start no node and run meanwhile, if the system lets the nodes take precedence.
    Waiting for the lock does not count for the timeout of a test. A process keeps its turn while its next test has the
    marker too, so that the other processes wait only once.
    """
    if not _starts_nodes(item.path) and _nodes_take_precedence():
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


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> Generator[None, object, object]:
    """Exempt the objects of a finished module from garbage collection, which would stop a peer for seconds."""
    with ends_in_time(_standard_error(item.config)):
        try:
            return (yield)
        finally:
            if nextitem is None or nextitem.path != item.path:
                gc.collect()
                gc.freeze()


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    """Limit the time in which the process ends; a worker waits for the others, and xdist ends it after 10 s."""
    if not hasattr(session.config, "workerinput"):
        end_soon(_standard_error(session.config))


def _standard_error(config: pytest.Config) -> int:
    """Return the descriptor of standard error that tests do not capture."""
    return config.stash.get(fault_handler_stderr_fd_key, 2)


@pytest.fixture
def ros() -> Iterator[Any]:
    """Provide a ROS context, an executor and the nodes of one test."""
    from nodes.harness import Ros  # rclpy reads the environment set above

    with Ros() as made:
        yield made
