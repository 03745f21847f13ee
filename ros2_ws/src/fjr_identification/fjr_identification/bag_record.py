# SPDX-License-Identifier: Apache-2.0
"""Read a record of motion from a bag in blocks of messages: memory grows with the numbers that are used only."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from fjr_core.errors import RecordError
from fjr_core.numerics.checks import Array
from fjr_monitor.recording.bag import FLOATS, Bag, read_bag
from fjr_monitor.recording.files import BagError, Times
from fjr_monitor.recording.signals import ANSWERS, EFFORTS, STATES, first_of_each_stamp, match_stamps
from fjr_msgs_py import names

from .estimation.motion_record import LARGEST, MotionRecord, TimeWindow, record_of_samples
from .record_map import BY_COMMANDS, BY_STATES, BagMap

BLOCK = 4096  # states that are read together
Rows = tuple[Times, Times, Array]
"""Stamps and send times (k,) [ns] of k messages, and their numbers (k, width): positions, then efforts."""


def record_of_bag(
    path: Path, mapping: BagMap, joints: tuple[str, ...], window: TimeWindow
) -> tuple[MotionRecord, tuple[str, ...]]:
    """Return the record of a bag from the first commanded state on, within the window, and notes on it.

    Effort: the command that answers each state by its stamp, else the last one sent before the next state, else the
    torque of the motors in the states. Raises BagError, RecordError.
    """
    bag = read_bag(path, mapping.namespace)
    commands = None if mapping.effort == BY_STATES else next(filter(bag.holds, (ANSWERS, EFFORTS)), None)
    if mapping.effort == BY_COMMANDS and commands is None:
        bag.held(ANSWERS)
    columns = {STATES: names.state_names(joints)} | ({commands: joints} if commands else {})
    read = _read(bag, columns, window)
    n, (stamps, sent, rows) = len(joints), read[STATES]
    if not len(stamps):
        raise RecordError(f"{path} holds no state; expected a record of motion")
    q_l, q_m, tau, u = (rows[:, i * n : (i + 1) * n] for i in range(4))
    notes: tuple[str, ...] = ()
    if commands is None:
        notes = (f"no commands: the effort of {names.motor_name(joints[0])} and so on in the states is the torque",)
    else:
        topic = bag.held(commands)
        u, notes = _answers(stamps, sent, read[commands], topic.name, topic.type_name == FLOATS)
    unknown = np.full_like(q_l, np.nan)
    q_m, tau = (unknown, tau) if mapping.by_torque else (q_m / mapping.gear_ratio, unknown)
    driven = np.flatnonzero(np.isfinite(u).all(axis=1))
    if not len(driven):
        raise RecordError(f"{path} holds no effort of all joints; expected commands, or efforts in the states")
    begin, end = int(driven[0]), int(driven[-1]) + 1
    kept = begin + np.flatnonzero(np.append(True, np.diff(stamps[begin:end]) != 0))  # a waiting plant repeats its state
    u = u[kept]
    answered = np.isfinite(u).all(axis=1)
    u = u[np.maximum.accumulate(np.where(answered, np.arange(len(u)), 0))]  # the last command holds
    t = (stamps[kept] - stamps[kept[0]]) * 1e-9
    table = window.of(t, np.column_stack([t, q_l[kept], q_m[kept], u, tau[kept]]))
    if not len(table):
        raise RecordError(f"{path} holds no samples{window.text}; expected a record of motion")
    q_l, q_m, u, tau = (table[:, 1 + i * n : 1 + (i + 1) * n] for i in range(4))
    _check_finite(path, {"positions of the links": q_l, "positions of the motors": q_m, "joint torques": tau}, joints)
    return record_of_samples(path.name, joints, table[:, 0], q_l, q_m, u, tau, notes)


def _read(bag: Bag, columns: Mapping[str, Sequence[str]], window: TimeWindow) -> dict[str, Rows]:
    """Return the messages of topics, with the joints of each, until the window ends; raise BagError, RecordError."""
    blocks: dict[str, list[Rows]] = {name: [] for name in columns}
    first, count = -1, 0
    for batch in bag.batches(columns, STATES, BLOCK):
        for name, joints in columns.items():
            table = bag.table(batch[name], joints)
            if len(table.stamp) < len(batch[name].messages):
                raise BagError(f"{batch[name].name} holds messages of another length; expected {len(joints)} efforts")
            blocks[name].append((table.stamp, table.publish_time, np.hstack([table.position, table.effort])))
        stamps, _, rows = blocks[STATES][-1]
        count += rows.size
        if count > LARGEST:
            raise RecordError(f"{STATES} holds more than {LARGEST:,} numbers; expected fewer: choose a --duration")
        first = int(stamps[0]) if first < 0 and len(stamps) else first
        if len(stamps) and (stamps[-1] - first) * 1e-9 > window.start + window.duration + 1.0:  # 1 s for late commands
            break
    return {name: tuple(map(np.concatenate, zip(*of, strict=True))) for name, of in blocks.items()}  # type: ignore[misc]


def _answers(stamps: Times, sent: Times, commands: Rows, topic: str, unstamped: bool) -> tuple[Array, tuple[str, ...]]:
    """Return the command (k, n) of each state, NaN without one, and a note if some are missing."""
    times, published, rows = commands
    efforts = rows[:, rows.shape[1] // 2 :]
    if not len(times):
        raise RecordError(f"{topic} holds no command; expected one for each state")
    if unstamped:
        last = np.searchsorted(published, np.append(sent[1:], np.iinfo(np.int64).max)) - 1
        u = np.where(last[:, None] >= 0, efforts[np.maximum(last, 0)], np.nan)
        return u, (f"a command of {topic} is taken to answer the last state sent before it",)
    first = first_of_each_stamp(times)
    place, answered = match_stamps(stamps, times[first])
    u = np.where(answered[:, None], efforts[first][place], np.nan)
    ends = np.flatnonzero(answered)
    missing = int((~answered[ends[0] : ends[-1]]).sum()) if len(ends) else 0
    return u, (f"{missing} states have no command: the one before is taken to hold",) if missing else ()


def _check_finite(path: Path, signals: dict[str, Array], joints: Sequence[str]) -> None:
    """Raise RecordError for a signal that is there at some samples only."""
    for what, values in signals.items():
        known = np.isfinite(values)
        for j in np.flatnonzero(known.any(axis=0) & ~known.all(axis=0)):
            row = int(np.argmin(known[:, j]))
            raise RecordError(f"{path}: {what} of {joints[j]} are missing or not finite at sample {row}; expected all")
    if not np.isfinite(values := np.hstack(list(signals.values())[:2])).any():
        raise RecordError(f"{path}: no position of {', '.join(joints)} in its {values.shape[0]} states; expected some")
