# SPDX-License-Identifier: Apache-2.0
"""The messages of the command loop as templates in memory of C."""

from __future__ import annotations

from typing import Any

from fjr_msgs_py.messages.cdr.layout import float_array, joint_state
from fjr_msgs_py.native.entities import NativeMessage
from fjr_msgs_py.native.program import Program


class CommandMessages:
    """Both commands, reference and tracking error; pointers: fields of struct fjr_controller_loop by name."""

    def __init__(self, program: Program, joints: tuple[str, ...]) -> None:
        n = len(joints)
        efforts, moving = (0, 0, n), (n, n, 0)
        self._messages = {
            "effort": NativeMessage(program, float_array(",".join(joints), n), (n,)),
            "command": NativeMessage(program, joint_state(joints, efforts), efforts),
            "reference": NativeMessage(program, joint_state(joints, moving), moving),
            "error": NativeMessage(program, joint_state(joints, moving), moving),
        }

    @property
    def pointers(self) -> dict[str, Any]:
        """Return the pointers to struct fjr_message by name."""
        return {name: message.pointer for name, message in self._messages.items()}
