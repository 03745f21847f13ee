# SPDX-License-Identifier: Apache-2.0
"""The rows of the fault table: each fault, the behaviour of the arm and the bounds on the result."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from faults import fault_injection
from faults.fault_injection import Act, tampered
from faults.rig import DIRECT, RELAYED, STEPPED, Setting

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
    return fault_injection.plant_set(2.0, state_loss=share, command_loss=share)


def late(seconds: float) -> Act:
    return fault_injection.plant_set(2.0, state_delay=seconds)


def tracking(name: str, act: Act, peak: float, **more: Any) -> Row:
    """Return a row in lock-step in which the arm tracks throughout."""
    return Row(name, "tracks", act, peak, recovery=0.0, mode=STEPPED, **more)


FALLS = "swings down without effort; a 0.5 s transition leads back to the reference"
LATER = ("silences", "recoveries")
ROWS = [
    Row("no fault", "tracks", fault_injection.nothing, 0.1),
    Row("kill -9 of the controller, then restart", FALLS, fault_injection.controller_killed, 2.5, mode=DIRECT),
    Row(
        "kill -9 of the plant, then restart",
        "restarts in its initial state; a transition leads to the reference",
        fault_injection.plant_killed,
        2.5,
        counted=LATER,
        mode=DIRECT,
    ),
    Row("no states for 200 ms", FALLS, tampered(0.2, fault_injection.dropped), 1.0, counted=LATER),
    Row("no states for 2 s", FALLS, tampered(2.0, fault_injection.dropped), 2.0, counted=LATER, another=True),
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
        tampered(0.2, fault_injection.not_a_number),
        1.0,
        counted=("state refused: not finite", *LATER),
    ),
    Row(
        "joint names of another arm, 200 ms",
        FALLS,
        tampered(0.2, fault_injection.renamed),
        1.0,
        counted=("state refused: missing joints", *LATER),
    ),
    Row(
        "every state sent twice, 1 s", "tracks", tampered(1.0, fault_injection.twice), 0.1, counted=("states repeated",)
    ),
    Row(
        "one state repeated, 200 ms",
        "holds the effort of that state; a transition leads back to the reference",
        tampered(0.2, fault_injection.frozen),
        1.0,
        counted=("states repeated", "forward jumps", "recoveries"),
    ),
    Row(
        "each state preceded by one 50 ms older, 1 s",
        "tracks",
        tampered(1.0, lambda: fault_injection.aged(50)),
        0.1,
        counted=("states older than the last",),
    ),
    Row(
        "stamps jump 10 s forward, then back after 0.5 s",
        "recovers to the reference at the new time; after the jump back the reference restarts",
        fault_injection.clock_jumped(0.5, 10),
        2.5,
        counted=("forward jumps", "recoveries", "reference restarts"),
    ),
    Row(
        "a second controller is started",
        "tracks; the second controller refuses to start and exits",
        fault_injection.second_controller,
        0.1,
        mode=DIRECT,
    ),
    Row(
        "another node sends zero efforts, 1 s",
        "tracks less accurately; the controller reports the other node",
        fault_injection.intruder(1.0),
        1.0,
        counted=("other controllers",),
        mode=DIRECT,
    ),
    Row(
        "parameters set to invalid values",
        "tracks; each value is refused, the old one stays",
        fault_injection.nonsense,
        0.1,
        mode=DIRECT,
    ),
    Row(
        "arm7: no states for 200 ms",
        "holds its weight; a 1 s transition leads back to the reference",
        tampered(0.2, fault_injection.dropped),
        1.0,
        counted=LATER,
        setting=ARM,
        another=True,
    ),
    Row(
        "arm7: no states for 2 s",
        "falls (it has no brakes); outside its range the controller stops and holds the weight",
        fault_injection.plant_set(2.0, state_loss=1.0),
        10.0,
        None,
        counted=("silences", "stops"),
        mode=STEPPED,
        setting=ARM,
    ),
    Row(
        "arm7: kill -9 of the plant, then restart",
        "a transition leads to the reference",
        fault_injection.plant_killed,
        1.5,
        counted=("silences",),
        mode=DIRECT,
        setting=ARM,
        another=True,
    ),
    tracking("arm7: 10 % of states and of commands lost, 2 s", lossy(0.1), 2e-3, setting=ARM, another=True),
    tracking("arm7: states 1 ms late, 2 s", late(0.001), 2e-3, setting=ARM, another=True),
]
