# SPDX-License-Identifier: Apache-2.0
"""Arrays whose layout says what each number is."""

from __future__ import annotations

from std_msgs.msg import Float64MultiArray


def labelled(message: Float64MultiArray) -> dict[str, float]:
    """Numbers by label: one dimension for each, or one for all with commas between its labels; empty without labels."""
    labels = [dimension.label for dimension in message.layout.dim]
    if len(labels) == 1:
        labels = labels[0].split(",")
    if len(labels) != len(message.data) or not all(labels):
        return {}
    return {label.strip(): float(value) for label, value in zip(labels, message.data, strict=True)}
