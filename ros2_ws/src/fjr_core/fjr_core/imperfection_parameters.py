# SPDX-License-Identifier: Apache-2.0
"""How the simulated robot departs from its model, in words."""

from __future__ import annotations

from .parameters import Parameter


def imperfection_parameters(n: int) -> list[Parameter]:
    """The parameters for n joints."""
    return []
