# SPDX-License-Identifier: Apache-2.0
"""Another publisher of commands or of /clock: refused before the first command, reported later."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from builtin_interfaces.msg import Time
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from fjr_controller.command_loop import TOPICS, CommandConflictError
from fjr_msgs_py.names import LATEST
from fjr_msgs_py.node.conflicting_publishers import ConflictingPublishers
from fjr_plant import lock_step as clock_owner
from fjr_plant.lock_step import ClockError
from fjr_plant.plant_node import PlantNode
from nodes.harness import Ros, Stranger, stamped
from nodes.managed import Manager
from nodes.plants import CommandLoop

MESSAGES = {
    "/effort_controller/commands": Float64MultiArray(data=[1.0]),
    "/joint_commands": JointState(name=["joint1"], effort=[1.0]),
}
EFFORTS = "/effort_controller/commands"
CLOCK = "/clock"
MANAGER_AND_CONTROLLER = 2  # subscriptions to a command topic, before the first command


Appear = Callable[..., Stranger]


@pytest.fixture
def appear(ros: Ros, manager: Manager) -> Iterator[Appear]:
    """Create another publisher of a topic and wait until it is discovered and connected with `met` subscriptions."""
    made = []

    def there(topic: str) -> int:
        return sum(info.node_name == "other" for info in manager.get_publishers_info_by_topic(topic))

    def make(topic: str, met: int = 0, time: int = 0) -> Stranger:
        count, message = there(topic), Clock(clock=Time(sec=time)) if topic == CLOCK else MESSAGES[topic]
        made.append(Stranger(topic, message))
        ros.until(lambda: there(topic) == count + 1, "the other publisher")
        ros.until(lambda: made[-1].publisher.get_subscription_count() >= met, "its connection with the controller")
        return made[-1]

    yield make
    for other in made:
        other.close()


def test_a_second_controller_is_refused(ros: Ros, manager: Manager, appear: Appear) -> None:
    other = appear(EFFORTS)
    node = ros.controller(autostart=False)
    assert manager.change("configure")
    with other.talking():
        with pytest.raises(CommandConflictError, match=f"node /other publishes on {EFFORTS}; expected nobody else"):
            ros.controller()
        assert not manager.change("activate")
        assert manager.state() == "inactive"
        assert EFFORTS in str(node.trouble)
    assert manager.change("activate")


@pytest.mark.parametrize("managed", [False, True])
def test_a_conflict_found_with_the_first_state_ends_the_node_or_leaves_a_managed_one_inactive(
    ros: Ros, manager: Manager, appear: Appear, managed: bool
) -> None:
    node = ros.controller(autostart=not managed)
    if managed:
        assert manager.change("configure")
        assert manager.change("activate")
    other = appear(EFFORTS, MANAGER_AND_CONTROLLER)
    with other.talking():
        manager.state_publisher.publish(stamped(0.0))
        ros.until(lambda: node.trouble, "the refusal")
    assert isinstance(node.trouble, CommandConflictError)
    assert node.ended is (None if managed else node.trouble)
    assert manager.state() == "inactive"
    manager.state_publisher.publish(stamped(0.1))
    ros.settle()
    assert not manager.references, "nothing must be sent"
    if managed:
        assert manager.change("activate")
        manager.ask(stamped(0.2))


def test_a_silent_publisher_is_no_conflict_and_one_that_appears_later_is_reported(
    ros: Ros, manager: Manager, appear: Appear
) -> None:
    appear(EFFORTS)
    node = manager.started()
    appear(EFFORTS)
    ros.until(lambda: "other controllers" in manager.kinds(), "the report")
    event = next(event for event in manager.events if event.name == "other controllers")
    assert f"has begun to publish on {EFFORTS}; expected nobody else" in event.message
    manager.reported(node, "other controllers")
    status = manager.diagnostics[-1].status[0]
    assert status.level == status.ERROR


def test_publisher_that_replaces_another_is_detected(ros: Ros, manager: Manager, appear: Appear) -> None:
    conflicts = ConflictingPublishers(manager, TOPICS, LATEST)
    assert conflicts.appeared() == []
    one = appear(EFFORTS)
    assert conflicts.appeared() == [EFFORTS]
    assert conflicts.appeared() == []
    count = manager.count_publishers(EFFORTS)
    one.close()
    ros.until(lambda: manager.count_publishers(EFFORTS) == count - 1, "the end of the first")
    appear(EFFORTS)
    assert manager.count_publishers(EFFORTS) == count
    assert conflicts.appeared() == [EFFORTS]
    assert conflicts.named(EFFORTS) == "node /other"
    conflicts.close()


@pytest.mark.parametrize("topic", MESSAGES)
def test_publisher_created_together_with_ours_is_detected(
    ros: Ros, manager: Manager, appear: Appear, topic: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    create, coming = manager.create_publisher, [topic]

    def create_late(kind: type, name: str, qos: object) -> object:
        if f"/{name}".endswith(coming[0] if coming else "nobody"):
            appear(coming.pop())
        return create(kind, name, qos)

    monkeypatch.setattr(manager, "create_publisher", create_late)
    conflicts = ConflictingPublishers(manager, TOPICS, LATEST)
    assert not coming
    assert conflicts.appeared() == [topic]
    conflicts.close()
    assert manager.count_publishers(topic) == 2, "those of the manager and of the other node"


# /clock has one owner.


SENTENCE = "node /other publishes on /clock; expected one owner of the time: .* -r /clock:=/NAMESPACE/clock"


def test_plant_refuses_to_start_with_another_clock(ros: Ros, manager: Manager, appear: Appear) -> None:
    with appear(CLOCK).talking():
        with pytest.raises(ClockError, match=SENTENCE):
            ros.plant(lockstep=True)
        arguments = ["--ros-args", "-r", "/clock:=/left/clock", "-p", "compile:=false", "-p", "lockstep:=true"]
        ros.start(PlantNode, arguments)
    assert manager.count_publishers("/left/clock") == 1


def test_plant_ends_if_another_clock_appears_with_the_first_command(
    ros: Ros, manager: Manager, appear: Appear, monkeypatch
) -> None:
    monkeypatch.setattr(clock_owner, "LOOK_PERIOD", 1000.0)
    node = manager.plant(lockstep=True)
    with appear(CLOCK).talking():
        CommandLoop(manager).listen()
        ros.until(lambda: node.ended, "the end")
    assert isinstance(node.ended, ClockError)
    assert node._time_base._robot.time == 0, "nothing must have moved"


def owner_in_motion(ros: Ros, manager: Manager, monkeypatch: pytest.MonkeyPatch, settling: float) -> PlantNode:
    """Return a plant that moves in lock-step and looks for other clocks often; settling [s]: for a new owner."""
    monkeypatch.setattr(clock_owner, "SETTLING", settling)
    monkeypatch.setattr(clock_owner, "LOOK_PERIOD", 0.01)
    node = manager.plant(lockstep=True)
    CommandLoop(manager).listen()
    ros.until(lambda: node._time_base._robot.time > 0, "motion")
    return node


def test_an_owner_reports_a_clock_that_appears_later(ros: Ros, manager: Manager, appear: Appear, monkeypatch) -> None:
    node = owner_in_motion(ros, manager, monkeypatch, settling=-1.0)
    with appear(CLOCK).talking():
        ros.until(lambda: node._health.count["other clocks"] == 1, "the report")
    manager.reported(node, "other clocks")
    assert node.ended is None


@pytest.mark.parametrize(("seconds", "ends"), [(0, False), (1000, True)], ids=["behind", "ahead"])
def test_new_owner_with_commands_ends_only_if_the_other_time_is_ahead(
    ros: Ros, manager: Manager, appear: Appear, monkeypatch: pytest.MonkeyPatch, seconds: int, ends: bool
) -> None:
    node = owner_in_motion(ros, manager, monkeypatch, settling=1e6)
    heard, read = ConflictingPublishers.heard, []

    def noted(self: ConflictingPublishers) -> tuple[str, Any] | None:
        found = heard(self)
        if found and found[1].clock.sec == seconds:  # a time of the plant itself may be on its way, too
            read.append(found)
        return found

    monkeypatch.setattr(ConflictingPublishers, "heard", noted)
    with appear(CLOCK, time=seconds).talking():
        ros.until(lambda: node.ended or len(read) > 1, "the other time")
        assert isinstance(node.ended, ClockError) is ends
