# SPDX-License-Identifier: Apache-2.0
"""What is done to the running pair: each act waits for full motion, disturbs, and says when the fault was."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from faults import tampering
from faults.relay import Tamper
from faults.rig import SECOND, Rig
from faults.watcher import EVENTS

Act = Callable[[Rig], tuple[int, int]]
"""Disturbs; the true stamps [ns] at which the fault began and ended."""


def nothing(rig: Rig) -> tuple[int, int]:
    begin = rig.until_full_motion()
    return begin, begin


def tampered(seconds: float, how: Callable[[], Tamper]) -> Act:
    """The relay tampers with the states for so long."""

    def act(rig: Rig) -> tuple[int, int]:
        begin = rig.full_motion
        return begin, rig.tamper(begin, seconds, how())

    return act


def silence(seconds: float) -> Act:
    return tampered(seconds, lambda: tampering.dropped)


def not_a_number(seconds: float) -> Act:
    return tampered(seconds, lambda: tampering.not_a_number)


def renamed(seconds: float) -> Act:
    return tampered(seconds, lambda: tampering.renamed)


def twice(seconds: float) -> Act:
    return tampered(seconds, lambda: tampering.twice)


def frozen(seconds: float) -> Act:
    return tampered(seconds, tampering.frozen)


def aged(seconds: float, samples: int) -> Act:
    return tampered(seconds, lambda: tampering.aged(samples))


def clock_jumped(seconds: float, jump: int) -> Act:
    """The stamps jump by whole seconds, and after a while back: then the reference begins again."""

    def act(rig: Rig) -> tuple[int, int]:
        begin, zero = rig.full_motion, rig.anchors[-1].zero
        rig.anchor(zero - jump * SECOND, begin)
        end = rig.tamper(begin, seconds, tampering.jumped(jump))
        begun = rig.first_stamp_from(end)
        rig.anchor(begun, begun)
        return begin, end

    return act


def controller_killed(rig: Rig) -> tuple[int, int]:
    """The fault ends with the first answer of a new one."""
    begin = rig.until_full_motion()
    rig.kill("controller")
    restarted = time.time_ns()
    rig.start("controller")
    return begin, rig.anchor_in_reference(restarted)


def plant_killed(rig: Rig) -> tuple[int, int]:
    """The fault ends with the first state of a new one, whose stamps begin with the time of its start."""
    begin = rig.until_full_motion()
    rig.kill("plant")
    restarted = time.time_ns()
    rig.start("plant")
    return begin, rig.first_stamp_from(restarted)


def plant_set(seconds: float, **imperfections: Any) -> Act:
    """Non-idealities of the plant, set while it runs, and after a while set back."""
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
    """Each is refused with a reason, and the old value stays."""
    begin = rig.until_full_motion()
    for name, value in NONSENSE.items():
        known = rig.remote.get("fjr_controller", name)
        assert rig.remote.set("fjr_controller", {name: value}), f"{name} = {value} was taken"
        assert rig.remote.get("fjr_controller", name) == known
    return begin, rig.now


def second_controller(rig: Rig) -> tuple[int, int]:
    """A second controller starts, is refused and ends."""
    begin = rig.until_full_motion()
    code, said = rig.ended(rig.start("controller", "-r", "__node:=second", key="second"))
    assert code == 1, said
    assert "Traceback" not in said
    ends = [line for line in said.splitlines() if line.startswith(("ended: ", "cannot start: "))]
    assert ["expected nobody else to command the robot" in line for line in ends] == [True], said
    return begin, rig.now


def intruder(seconds: float) -> Act:
    """Another node sends zero efforts on the controller's topic for a while, and until the controller has seen it."""

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
