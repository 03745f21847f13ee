# SPDX-License-Identifier: Apache-2.0
"""/clock has one owner: a second publisher is refused before the first command and reported if it appears later."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from rosgraph_msgs.msg import Clock

from fjr_msgs_py.node.conflicting_publishers import ConflictingPublishers
from fjr_plant import lock_step as clock_owner
from fjr_plant.lock_step import ClockError
from fjr_plant.plant_node import PlantNode
from nodes.harness import Peer, Ros, Stranger
from nodes.plants import CommandLoop

SENTENCE = "node /other publishes on /clock; expected one owner of the time: .* -r /clock:=/NAMESPACE/clock"


@contextmanager
def other_clock(ros: Ros, peer: Peer, seconds: int = 0) -> Iterator[None]:
    """Publish the time `seconds` like another process; yield once the publisher is discovered."""
    message = Clock()
    message.clock.sec = seconds
    other = Stranger("/clock", message)
    try:
        with other.talking():
            ros.until(
                lambda: "other" in (i.node_name for i in peer.get_publishers_info_by_topic("/clock")), "the clock"
            )
            yield
    finally:
        other.close()


def test_plant_refuses_to_start_with_another_clock(ros: Ros, peer: Peer) -> None:
    with other_clock(ros, peer):
        with pytest.raises(ClockError, match=SENTENCE):
            ros.plant(lockstep=True)
        arguments = ["--ros-args", "-r", "/clock:=/left/clock", "-p", "compile:=false", "-p", "lockstep:=true"]
        ros.start(PlantNode, arguments)
    assert peer.count_publishers("/left/clock") == 1


def test_plant_ends_if_another_clock_appears_with_the_first_command(ros: Ros, peer: Peer, monkeypatch) -> None:
    monkeypatch.setattr(clock_owner, "LOOK_PERIOD", 1000.0)
    node = peer.plant(lockstep=True)
    with other_clock(ros, peer):
        CommandLoop(peer).listen()
        ros.until(lambda: node.ended, "the end")
    assert isinstance(node.ended, ClockError)
    assert node._time_base._robot.time == 0, "nothing must have moved"


def test_an_owner_reports_a_clock_that_appears_later(ros: Ros, peer: Peer, monkeypatch) -> None:
    monkeypatch.setattr(clock_owner, "SETTLING", -1.0)
    monkeypatch.setattr(clock_owner, "LOOK_PERIOD", 0.01)
    node = peer.plant(lockstep=True)
    CommandLoop(peer).listen()
    ros.until(lambda: node._time_base._robot.time > 0, "motion")
    with other_clock(ros, peer):
        ros.until(lambda: node._health.count["other clocks"] == 1, "the report")
    node.stop()
    ros.until(lambda: peer.count("other clocks", "fjr_plant") == 1, "the diagnostics")
    assert node.ended is None


@pytest.mark.parametrize(("seconds", "ends"), [(0, False), (1000, True)], ids=["behind", "ahead"])
def test_new_owner_with_commands_ends_only_if_the_other_time_is_ahead(
    ros: Ros, peer: Peer, monkeypatch: pytest.MonkeyPatch, seconds: int, ends: bool
) -> None:
    monkeypatch.setattr(clock_owner, "SETTLING", 1e6)
    monkeypatch.setattr(clock_owner, "LOOK_PERIOD", 0.01)
    node = peer.plant(lockstep=True)
    CommandLoop(peer).listen()
    ros.until(lambda: node._time_base._robot.time > 0, "motion")
    heard, read = ConflictingPublishers.heard, []

    def noted(self: ConflictingPublishers) -> tuple[str, Any] | None:
        read.extend(filter(None, [found := heard(self)]))
        return found

    monkeypatch.setattr(ConflictingPublishers, "heard", noted)
    with other_clock(ros, peer, seconds):
        ros.until(lambda: node.ended or len(read) > 1, "the other time")
        assert isinstance(node.ended, ClockError) is ends
