# SPDX-License-Identifier: Apache-2.0
"""Fault injection into the running nodes: each act waits for full motion and returns begin and end of the fault."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any

from sensor_msgs.msg import JointState

from faults.peers import EVENTS, Tamper
from faults.rig import SECOND, Rig

Act = Callable[[Rig], tuple[int, int]]
"""Inject a fault; return the true stamps [ns] of its begin and end."""


def nothing(rig: Rig) -> tuple[int, int]:
    begin = rig.until_full_motion()
    return begin, begin


def tampered(seconds: float, how: Callable[[], Tamper]) -> Act:
    """Modify the states in the relay for `seconds`."""

    def act(rig: Rig) -> tuple[int, int]:
        begin = rig.full_motion
        return begin, rig.tamper(begin, seconds, how())

    return act


def clock_jumped(seconds: float, jump: int) -> Act:
    """Shift the stamps by whole seconds for a while; the reference restarts when they jump back."""

    def act(rig: Rig) -> tuple[int, int]:
        begin, zero = rig.full_motion, rig.anchors[-1].zero
        rig.anchor(zero - jump * SECOND, begin)
        end = rig.tamper(begin, seconds, jumped(jump))
        begun = rig.first_stamp_from(end)
        rig.anchor(begun, begun)
        return begin, end

    return act


def controller_killed(rig: Rig) -> tuple[int, int]:
    """Kill and restart the controller; the fault ends with the first command of the new one."""
    begin = rig.until_full_motion()
    rig.kill("controller")
    rig.start("controller")
    return begin, rig.anchor_in_reference(rig.started["controller"])


def plant_killed(rig: Rig) -> tuple[int, int]:
    """Kill and restart the plant; the fault ends with the first state of the new one, stamped by its own start time."""
    begin = rig.until_full_motion()
    rig.kill("plant")
    rig.start("plant")
    return begin, rig.first_stamp_from(rig.started["plant"])


def plant_set(seconds: float, **imperfections: Any) -> Act:
    """Set imperfections of the running plant for a while, then reset them."""
    values = {f"imperfections.{name}": value for name, value in imperfections.items()}

    def act(rig: Rig) -> tuple[int, int]:
        begin = rig.until_full_motion()
        assert rig.remote.set("fjr_plant", values) == ""
        rig.until_stamp(begin + round(seconds * SECOND))
        assert rig.remote.set("fjr_plant", dict.fromkeys(values, 0.0)) == ""
        return begin, rig.robot_time

    return act


NONSENSE = {
    "gains.K_ld": [-1.0],
    "gains.Pi_l": [math.nan],
    "gains.Lambda_m": [15.0, 15.0],
    "gains.K_md": "a lot",
    "limits.effort": [-5.0],
    "reference.frequency": [math.inf],
    "recovery.join_time": -1.0,
    "on_stop": "pray",
    "joints": ["another"],
    "no.such.parameter": 1.0,
}


def nonsense(rig: Rig) -> tuple[int, int]:
    """Set invalid parameters; each is refused with a reason and the old value remains."""
    begin = rig.until_full_motion()
    for name, value in NONSENSE.items():
        known = rig.remote.get("fjr_controller", name)
        assert rig.remote.set("fjr_controller", {name: value}), f"{name} = {value} was accepted"
        assert rig.remote.get("fjr_controller", name) == known
    return begin, rig.now


def second_controller(rig: Rig) -> tuple[int, int]:
    """Start a second controller, which is refused and ends."""
    begin = rig.until_full_motion()
    code, said = rig.ended(rig.start("controller", "-r", "__node:=second", key="second"))
    assert code == 1, said
    assert "Traceback" not in said
    ends = [line for line in said.splitlines() if line.startswith(("ended: ", "cannot start: "))]
    assert ["expected nobody else to command the robot" in line for line in ends] == [True], said
    return begin, rig.now


def intruder(seconds: float) -> Act:
    """Send zero efforts from another node for a while, until the controller has reported it."""

    def act(rig: Rig) -> tuple[int, int]:
        begin = rig.until_full_motion()
        rig.remote.intrude(2e-3, len(rig.setting.reference.amplitude))
        rig.until_stamp(begin + round(seconds * SECOND))
        rig.until(lambda: reported(rig), "the controller's report of another node")
        rig.remote.retreat()
        return begin, rig.now

    def reported(rig: Rig) -> bool:
        return any("other controllers" in event.name for event in rig.watcher.messages(EVENTS))

    return act


# Modifications of states in the relay; each function returns a new one, which may remember messages.


def dropped() -> Tamper:
    return lambda message: ()


def twice() -> Tamper:
    return lambda message: (message, message)


def not_a_number() -> Tamper:
    """Make a position and a velocity alternately NaN and infinite."""

    def tamper(message: JointState) -> Iterable[JointState]:
        bad = math.nan if message.header.stamp.nanosec // 1_000_000 % 2 else math.inf
        message.position[0] = bad
        message.velocity[-1] = -bad
        yield message

    return tamper


def renamed() -> Tamper:
    def tamper(message: JointState) -> Iterable[JointState]:
        message.name = [f"{name}_of_another_arm" for name in message.name]
        yield message

    return tamper


def frozen() -> Tamper:
    """Repeat the first message."""
    first: list[JointState] = []

    def tamper(message: JointState) -> Iterable[JointState]:
        first.append(message)
        del first[1:]
        yield first[0]

    return tamper


def aged(samples: int) -> Tamper:
    """Send a message that is `samples` older before each message."""
    past: deque[JointState] = deque(maxlen=samples + 1)

    def tamper(message: JointState) -> Iterable[JointState]:
        past.append(message)
        yield past[0]
        yield message

    return tamper


def jumped(seconds: int) -> Tamper:
    """Shift the stamps by whole seconds."""

    def tamper(message: JointState) -> Iterable[JointState]:
        message.header.stamp.sec += seconds
        yield message

    return tamper
