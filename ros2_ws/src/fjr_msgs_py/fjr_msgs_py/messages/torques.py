# SPDX-License-Identifier: Apache-2.0
"""Torques from outside on some of a robot's links, from messages."""

from __future__ import annotations

import numpy as np
from sensor_msgs.msg import JointState

from .joint_states import Array, MessageError


class TorqueReader:
    """Reads JointStates whose efforts are torques on the links of any subset of the joints."""

    def __init__(self, joints: tuple[str, ...]) -> None:
        self._row = {name: row for row, name in enumerate(joints)}

    def read(self, message: JointState) -> Array:
        """Torques (n,) [N m], zero for a joint that is not named; raises MessageError."""
        names = message.name
        unknown = [name for name in names if name not in self._row]
        if unknown:
            raise MessageError("unknown joints", f"names are {names}; expected some of {list(self._row)}")
        if len(set(names)) < len(names):
            raise MessageError("duplicate joints", f"names are {names}; expected each joint only once")
        effort = np.array(message.effort, dtype=float)
        if len(effort) != len(names):
            raise MessageError(
                "wrong lengths", f"effort has {len(effort)} entries; expected {len(names)}, one per name"
            )
        if not np.isfinite(effort).all():
            raise MessageError("not finite", f"effort holds {effort.tolist()}; expected finite numbers")
        torque = np.zeros(len(self._row))
        torque[[self._row[name] for name in names]] = effort
        return torque
