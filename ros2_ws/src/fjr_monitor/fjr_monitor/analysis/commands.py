# SPDX-License-Identifier: Apache-2.0
"""Match the commands of a bag to the states they respond to."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fjr_monitor.analysis.states import States, first_of_each_stamp
from fjr_monitor.recording.reader import Array, JointTable, Times
from fjr_msgs_py import names

ANSWERS, EFFORTS = f"/{names.JOINT_COMMANDS}", f"/{names.EFFORT_COMMANDS}"
AFTERWARDS = 10**9  # ns; the last commands may arrive after the last state


def commands_of(states: States, table: JointTable | None, stamped: bool) -> tuple[Array, Times]:
    """Return the command of each of k states: u (k, n) [N m], send time (k,) [ns]; NaN and -1 without a command.

    Commands are matched by stamp where they carry one; else each state has the first one sent after it and before the
    next state.
    """
    time, n = states.publish_time, states.position.shape[1] // 2
    if table is not None and stamped and len(time):
        table = table.rows((table.publish_time >= time[0]) & (table.publish_time <= time[-1] + AFTERWARDS))
        table = table.rows(first_of_each_stamp(table.stamp))
    if table is None or not len(table.stamp) or not len(time):
        return np.full((len(time), n), np.nan), np.full(len(time), -1, dtype=np.int64)
    if stamped:
        place, found = match_stamps(states.stamp, table.stamp)
    else:
        place = np.searchsorted(table.publish_time, time)
        found, place = place < len(table.stamp), np.minimum(place, len(table.stamp) - 1)
        found &= table.publish_time[place] < np.append(time[1:], np.iinfo(np.int64).max)
    return np.where(found[:, None], table.effort[place], np.nan), np.where(found, table.publish_time[place], -1)


def match_stamps(stamps: Times, others: Times) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Find each stamp in the sorted `others`: return row indices, and a mask of the stamps that were found."""
    place = np.minimum(np.searchsorted(others, stamps), len(others) - 1)
    return place, others[place] == stamps
