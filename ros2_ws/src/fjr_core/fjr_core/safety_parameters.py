# SPDX-License-Identifier: Apache-2.0
"""Limits, stop policy, start and recovery of the controller in words."""

from __future__ import annotations

from .parameters import Parameter


def safety_parameters(n: int) -> list[Parameter]:
    """The parameters for n joints."""
    return []
