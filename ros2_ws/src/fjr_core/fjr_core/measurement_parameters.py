# SPDX-License-Identifier: Apache-2.0
"""What the joints' states really hold, in words."""

from __future__ import annotations

from .parameters import Parameter


def measurement_parameters(n: int) -> list[Parameter]:
    """The parameters for n joints."""
    return []
