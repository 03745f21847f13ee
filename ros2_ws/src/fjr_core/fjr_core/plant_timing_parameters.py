# SPDX-License-Identifier: Apache-2.0
"""How long the simulated robot waits and how far it is advanced, in words."""

from __future__ import annotations

from .parameters import Parameter


def plant_timing_parameters() -> list[Parameter]:
    """The parameters of the plant's lock-step and of ~/advance."""
    return [
        Parameter(
            "lockstep_timeout",
            10.0,
            "Lock-step: end when a state is not answered for longer, from the first answer on; 0: wait for ever",
            "s",
            minimum=0.0,
            maximum=1e6,
        ),
        Parameter(
            "advance_samples",
            1,
            "Samples by which ~/advance moves a paused robot",
            minimum=1,
            maximum=1_000_000,
            dynamic=True,
        ),
    ]
