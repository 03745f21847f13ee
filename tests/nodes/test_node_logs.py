# SPDX-License-Identifier: Apache-2.0
"""Log lines and events of the nodes as they start, track and stop."""

from __future__ import annotations

import pytest

from nodes.harness import Ros, stamped
from nodes.managed import Manager

LIFE = ["configured", "activated", "tracking", "deactivated", "cleaned up"]


def infos(text: str, node: str) -> list[str]:
    return [line.partition(f"[{node}]: ")[2] for line in text.splitlines() if "[INFO]" in line and f"[{node}]" in line]


def test_a_controller_logs_each_transition(ros: Ros, capfd: pytest.CaptureFixture[str]) -> None:
    manager = Manager(ros)
    node = ros.controller(autostart=False)
    ros.until(lambda: node._events._publisher.get_subscription_count(), "a reader of the events")
    for transition in ("configure", "activate"):
        assert manager.change(transition)
    manager.meet_controller()
    for k in range(3):
        manager.ask(stamped(0.001 * k))
    for transition in ("deactivate", "cleanup"):
        assert manager.change(transition)
    ros.until(lambda: len(manager.events) >= len(LIFE), "the events")
    assert manager.kinds() == LIFE
    assert infos(capfd.readouterr().err, "fjr_controller") == [event.message for event in manager.events]
    assert [event.message for event in manager.events] == [
        "configured: law v_dpbc for joint1",
        "activated: waiting for states on /joint_states",
        "tracking: the effort is the law's own",
        "deactivated: no efforts are sent",
        "cleaned up: all parameters may change",
    ]


def test_failed_transition_is_an_event(ros: Ros) -> None:
    manager = Manager(ros)
    node = ros.controller(autostart=False)
    ros.until(lambda: node._events._publisher.get_subscription_count(), "a reader of the events")
    assert manager.set(gains__K_ld=[-1.0])[0]
    assert not manager.change("configure")
    ros.until(lambda: manager.events, "the event")
    assert (manager.events[0].name, manager.events[0].level) == ("transition failed", b"\x02")
    assert "gains.K_ld" in manager.events[0].message


@pytest.mark.parametrize("lockstep", [True, False])
def test_plant_logs_waiting_and_start_of_motion(ros: Ros, lockstep: bool, capfd) -> None:
    manager = Manager(ros)
    node = ros.plant(lockstep=lockstep)
    ros.controller(use_sim_time=lockstep)
    ros.until(lambda: node._robot.time > 0, "motion")
    ros.settle()
    topic, first = ("/joint_commands", "answer") if lockstep else ("/effort_controller/commands", "command")
    time = "in lock-step" if lockstep else "with the clock"
    assert infos(capfd.readouterr().err, "fjr_plant") == [
        f"configured: joint1 at 1000 Hz {time}; waiting for commands on {topic}",
        f"moving: the first {first} has arrived",
    ]
    assert manager.states
