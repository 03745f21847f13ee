# SPDX-License-Identifier: Apache-2.0
"""Counters of a node in the log and on /diagnostics."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node

from fjr_msgs_py.node.participant import leave
from fjr_msgs_py.node.reports import Health


@pytest.fixture
def health() -> Iterator[Health]:
    context = Context()
    rclpy.init(context=context)
    node = Node("healthy", context=context)
    yield Health(node, ("messages",))
    leave(node)
    context.try_shutdown()


@pytest.mark.parametrize(("level", "word"), [("warn", "[WARN]"), ("error", "[ERROR]")])
def test_an_event_is_logged_once_at_its_level(health: Health, capfd: pytest.CaptureFixture[str], level, word) -> None:
    for _ in range(3):
        getattr(health, level)("falls", "it fell")
    (line,) = [line for line in capfd.readouterr().err.splitlines() if "it fell" in line]
    assert line.startswith(word)
    assert health.count["falls"] == 3
