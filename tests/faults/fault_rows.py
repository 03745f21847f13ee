# SPDX-License-Identifier: Apache-2.0
"""The rows of the fault table: how each fault is injected into the running nodes, the behaviour of the arm, the bounds.

Each act waits for full motion and returns begin and end of the fault.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from sensor_msgs.msg import JointState

from faults.peers import EVENTS, Tamper
from faults.rig import DIRECT, RELAYED, SECOND, STEPPED, Rig, Setting

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


def repeated(values_only: bool) -> Tamper:
    """Repeat the first message, or its values under new stamps."""
    first: list[JointState] = []

    def tamper(message: JointState) -> Iterable[JointState]:
        first.append(message)
        del first[1:]
        message.position, message.velocity = first[0].position, first[0].velocity
        yield message if values_only else first[0]

    return tamper


def frozen() -> Tamper:
    return repeated(values_only=False)


def stuck() -> Tamper:
    return repeated(values_only=True)


def turned() -> Tamper:
    """Shift the first position by a turn."""

    def tamper(message: JointState) -> Iterable[JointState]:
        message.position[0] += 2 * math.pi
        yield message

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


# The rows.


STATE_TIMEOUT, JOIN_TIME = 0.1, 0.5  # s
SAFE = {"state_timeout": STATE_TIMEOUT, "start.join_time": JOIN_TIME, "recovery.join_time": JOIN_TIME}

JOINT = Setting(
    "paper_k31",
    controller={**SAFE, "reference.frequency": [3.0], "limits.effort": [5.0], "limits.acceleration": [200.0]},
    limit=(5.0,),
    full_motion=math.pi / 3,  # sin(3 t) passes zero with 3 rad/s, alternately up and down
    again=math.pi / 3,
)
ARM = Setting(
    "arm7",
    plant={"command_timeout": 0.5},
    controller={**SAFE, "recovery.join_time": 1.0, "limits.from_robot": True, "on_stop": "gravity_hold"},
    limit=(176.0, 176.0, 110.0, 110.0, 110.0, 40.0, 40.0),  # of arm7.urdf
    full_motion=1.5,  # all joints pass their offset with 0.94 rad/s
    again=2.0,  # a period: gravity bends the arm to one side
)


@dataclass(frozen=True)
class Row:
    """A fault, the behaviour of the arm under it, and bounds on the measured values.

    peak: largest |q_tilde_l| [rad] from the start of the fault. recovery: time [s] from its end to recovery; None: the
    controller stays stopped. counted: counters that the controller must have incremented. mode: how the two nodes run.
    another: the fault of another row at another size or on another arm, which `make test` leaves to `make test-all`.
    """

    name: str
    arm: str
    act: Act
    peak: float
    recovery: float | None = 5.0
    counted: tuple[str, ...] = ()
    mode: str = RELAYED
    setting: Setting = JOINT
    another: bool = False


def lossy(share: float) -> Act:
    return plant_set(2.0, state_loss=share, command_loss=share)


def late(seconds: float) -> Act:
    return plant_set(2.0, state_delay=seconds)


def tracking(name: str, act: Act, peak: float, **more: Any) -> Row:
    """Return a row in lock-step in which the arm tracks throughout."""
    return Row(name, "tracks", act, peak, recovery=0.0, mode=STEPPED, **more)


FALLS = "swings down without effort; a 0.5 s transition leads back to the reference"
LATER = ("silences", "recoveries")
ROWS = [
    Row("no fault", "tracks", nothing, 0.1),
    Row("kill -9 of the controller, then restart", FALLS, controller_killed, 2.5, mode=DIRECT),
    Row(
        "kill -9 of the plant, then restart",
        "restarts in its initial state; a transition leads to the reference",
        plant_killed,
        2.5,
        counted=LATER,
        mode=DIRECT,
    ),
    Row("no states for 200 ms", FALLS, tampered(0.2, dropped), 1.0, counted=LATER),
    Row("no states for 2 s", FALLS, tampered(2.0, dropped), 2.0, counted=LATER, another=True),
    tracking("1 % of states and of commands lost, 2 s", lossy(0.01), 1e-3, another=True),
    tracking("10 % of states and of commands lost, 2 s", lossy(0.1), 1e-3),
    *(tracking(f"states {ms} ms late, 2 s", late(ms * 1e-3), 1e-3, another=True) for ms in (1, 3, 5)),
    Row(
        "states 8 ms late, 2 s (margin: 5.45 ms)",
        "oscillates about the reference between the effort limits",
        late(0.008),
        0.8,
        1.0,
        counted=("efforts saturated",),
        mode=STEPPED,
    ),
    Row(
        "NaN and infinity in every state, 200 ms",
        FALLS,
        tampered(0.2, not_a_number),
        1.0,
        counted=("state refused: not finite", *LATER),
    ),
    Row(
        "joint names of another arm, 200 ms",
        FALLS,
        tampered(0.2, renamed),
        1.0,
        counted=("state refused: missing joints", *LATER),
    ),
    Row("every state sent twice, 1 s", "tracks", tampered(1.0, twice), 0.1, counted=("states repeated",)),
    Row(
        "one state repeated, 200 ms",
        "holds the effort of that state for 0.1 s, then has none; a transition leads back to the reference",
        tampered(0.2, frozen),
        1.0,
        counted=("states repeated", "silences", "recoveries"),
    ),
    Row(
        "values of one state repeated under new stamps, 200 ms",
        FALLS,
        tampered(0.2, stuck),
        1.0,
        counted=("states frozen", "recoveries"),
    ),
    Row(
        "each state preceded by one 50 ms older, 1 s",
        "tracks",
        tampered(1.0, lambda: aged(50)),
        0.1,
        counted=("states older than the last",),
    ),
    Row(
        "stamps jump 10 s forward, then back after 0.5 s",
        "recovers to the reference at the new time; after the jump back the reference restarts",
        clock_jumped(0.5, 10),
        2.5,
        counted=("forward jumps", "recoveries", "reference restarts"),
    ),
    Row(
        "a second controller is started",
        "tracks; the second controller refuses to start and exits",
        second_controller,
        0.1,
        mode=DIRECT,
    ),
    Row(
        "another node sends zero efforts, 1 s",
        "tracks less accurately; the controller reports the other node",
        intruder(1.0),
        1.0,
        counted=("other controllers",),
        mode=DIRECT,
    ),
    Row(
        "parameters set to invalid values",
        "tracks; each value is refused, the old one stays",
        nonsense,
        0.1,
        mode=DIRECT,
    ),
    Row(
        "arm7: no states for 200 ms",
        "holds its weight; a 1 s transition leads back to the reference",
        tampered(0.2, dropped),
        1.0,
        counted=LATER,
        setting=ARM,
        another=True,
    ),
    Row(
        "arm7: no states for 2 s",
        "falls (it has no brakes); outside its range the controller stops and holds the weight",
        plant_set(2.0, state_loss=1.0),
        10.0,
        None,
        counted=("silences", "stops"),
        mode=STEPPED,
        setting=ARM,
    ),
    Row(
        "arm7: kill -9 of the plant, then restart",
        "a transition leads to the reference",
        plant_killed,
        1.5,
        counted=("silences",),
        mode=DIRECT,
        setting=ARM,
        another=True,
    ),
    tracking("arm7: 10 % of states and of commands lost, 2 s", lossy(0.1), 2e-3, setting=ARM, another=True),
    tracking("arm7: states 1 ms late, 2 s", late(0.001), 2e-3, setting=ARM, another=True),
]
