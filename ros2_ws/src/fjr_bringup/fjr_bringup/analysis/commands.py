# SPDX-License-Identifier: Apache-2.0
"""Match the commands of a bag to the states they respond to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fjr_bringup.analysis.states import States, first_of_each_stamp
from fjr_bringup.recording.reader import Array, Bag, Times
from fjr_msgs_py import names

ANSWERS, EFFORTS = f"/{names.JOINT_COMMANDS}", f"/{names.EFFORT_COMMANDS}"
AFTERWARDS = 10**9  # ns; the last commands may arrive after the last state


@dataclass(frozen=True)
class Commands:
    """Command of each of k states: u (k, n) [N m], send time (k,) [ns]; NaN and -1 without a command."""

    u: Array
    sent: Times
    notes: tuple[str, ...] = ()


def recorded_commands(bag: Bag, states: States, joints: tuple[str, ...]) -> Commands:
    """Return the commands, matched by stamp where they carry one, otherwise by send time."""
    if bag.holds(ANSWERS):
        return _by_stamp(bag, states, joints)
    if bag.holds(EFFORTS):
        return _by_time(bag, states, len(joints))
    note = f"neither {ANSWERS} nor {EFFORTS} was recorded: no effort of the controller, no latency"
    return _none(states, len(joints), note)


def match_stamps(stamps: Times, others: Times) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Find each stamp in the sorted `others`: return row indices, and a mask of the stamps that were found."""
    place = np.minimum(np.searchsorted(others, stamps), len(others) - 1)
    return place, others[place] == stamps


def _by_stamp(bag: Bag, states: States, joints: tuple[str, ...]) -> Commands:
    table, time = bag.joints(ANSWERS, joints), states.publish_time
    window = np.flatnonzero((table.publish_time >= time[0]) & (table.publish_time <= time[-1] + AFTERWARDS))
    rows = window[first_of_each_stamp(table.stamp[window])]
    if not len(rows):
        return _none(states, len(joints), f"no state is answered on {ANSWERS}: no effort of the controller, no latency")
    place, found = match_stamps(states.stamp, table.stamp[rows])
    sent = np.where(found, table.publish_time[rows][place], -1)
    return Commands(np.where(found[:, None], table.effort[rows][place], np.nan), sent)


def _by_time(bag: Bag, states: States, n: int) -> Commands:
    """Match each state to the first command sent after it and before the next state."""
    topic = bag.topic(EFFORTS)
    valid = [(time, m.data) for time, m in zip(topic.publish_time, topic.decoded, strict=True) if len(m.data) == n]
    if not valid:
        return _none(states, n, f"{EFFORTS} holds no command of {n} joints: no effort of the controller, no latency")
    time, effort = np.array([sent for sent, _ in valid], dtype=np.int64), np.array([data for _, data in valid])
    place = np.searchsorted(time, states.publish_time)
    inside = np.minimum(place, len(time) - 1)
    found = (place < len(time)) & (time[inside] < np.append(states.publish_time[1:], np.iinfo(np.int64).max))
    note = f"{ANSWERS} was not recorded: a command of {EFFORTS} is taken to answer the last state sent before it"
    return Commands(np.where(found[:, None], effort[inside], np.nan), np.where(found, time[inside], -1), (note,))


def _none(states: States, n: int, note: str) -> Commands:
    k = len(states.stamp)
    return Commands(np.full((k, n), np.nan), np.full(k, -1, dtype=np.int64), (note,))
