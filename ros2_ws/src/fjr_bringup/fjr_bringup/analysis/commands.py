# SPDX-License-Identifier: Apache-2.0
"""The commands of a bag, each beside the state it answers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fjr_bringup.analysis.states import States, first_of_each_stamp
from fjr_bringup.recording.reader import Array, Bag, Times
from fjr_msgs_py import names

ANSWERS, EFFORTS = f"/{names.JOINT_COMMANDS}", f"/{names.EFFORT_COMMANDS}"
AFTERWARDS = 10**9  # ns; the last answers may come after the last state


@dataclass(frozen=True)
class Commands:
    """What answered each of k states: u (k, n) [N m], when it was sent (k,) [ns]; NaN and -1 where nothing did."""

    u: Array
    sent: Times
    notes: tuple[str, ...] = ()


def recorded_commands(bag: Bag, states: States, joints: tuple[str, ...]) -> Commands:
    """By the stamp they carry, else by the time they were sent, else none."""
    if bag.holds(ANSWERS):
        return _by_stamp(bag, states, joints)
    if bag.holds(EFFORTS):
        return _by_time(bag, states, len(joints))
    note = f"neither {ANSWERS} nor {EFFORTS} was recorded: no effort of the controller, no latency"
    return _none(states, len(joints), note)


def answers(stamps: Times, others: Times) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Row in the ordered `others` that has each stamp, and whether there is one."""
    place = np.minimum(np.searchsorted(others, stamps), len(others) - 1)
    return place, others[place] == stamps


def _by_stamp(bag: Bag, states: States, joints: tuple[str, ...]) -> Commands:
    table, time = bag.joints(ANSWERS, joints), states.publish_time
    meanwhile = np.flatnonzero((table.publish_time >= time[0]) & (table.publish_time <= time[-1] + AFTERWARDS))
    rows = meanwhile[first_of_each_stamp(table.stamp[meanwhile])]
    if not len(rows):
        return _none(states, len(joints), f"no state is answered on {ANSWERS}: no effort of the controller, no latency")
    place, found = answers(states.stamp, table.stamp[rows])
    sent = np.where(found, table.publish_time[rows][place], -1)
    return Commands(np.where(found[:, None], table.effort[rows][place], np.nan), sent)


def _by_time(bag: Bag, states: States, n: int) -> Commands:
    """Each state is answered by the first command sent after it and before the next state."""
    topic = bag.topic(EFFORTS)
    fits = [(time, m.data) for time, m in zip(topic.publish_time, topic.decoded, strict=True) if len(m.data) == n]
    if not fits:
        return _none(states, n, f"{EFFORTS} holds no command of {n} joints: no effort of the controller, no latency")
    time, effort = np.array([moment for moment, _ in fits], dtype=np.int64), np.array([data for _, data in fits])
    place = np.searchsorted(time, states.publish_time)
    inside = np.minimum(place, len(time) - 1)
    found = (place < len(time)) & (time[inside] < np.append(states.publish_time[1:], np.iinfo(np.int64).max))
    note = f"{ANSWERS} was not recorded: a command of {EFFORTS} is taken to answer the last state sent before it"
    return Commands(np.where(found[:, None], effort[inside], np.nan), np.where(found, time[inside], -1), (note,))


def _none(states: States, n: int, note: str) -> Commands:
    k = len(states.stamp)
    return Commands(np.full((k, n), np.nan), np.full(k, -1, dtype=np.int64), (note,))
