# SPDX-License-Identifier: Apache-2.0
"""Records of the native command loop (struct fjr_record) as samples, commands and states of Python."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fjr_core.runtime.control_step import NEVER
from fjr_msgs_py.messages.joint_states import JointSample

from ..tracking.events import STATES, State
from ..tracking.tracker import Command


def changes(states: NDArray[Any], before: State) -> list[State]:
    """Return the states (k,) that differ from their predecessor, the first one from `before`."""
    last = np.append(STATES.index(before), states[:-1])
    return [STATES[state] for state in states[states != last].tolist()]


def sample_of(record: Any) -> JointSample:
    """Return the sample of a record."""
    n = len(record["sample"]["link"])
    return JointSample(int(record["sample"]["stamp"]), record["sample"]["link"], record["command"]["position"][n:])


def command_of(record: Any) -> Command:
    """Return the command of a record."""
    found = record["command"]
    u, jets, start = found["u"], found["jets"].reshape(-1, len(found["u"])), int(found["bound_start"])
    return Command(
        u,
        jets,
        float(found["V"]),
        found["velocity"],
        STATES[found["state"]],
        bool(found["restarted"]),
        found["position"],
        None if start == NEVER else start,
    )
