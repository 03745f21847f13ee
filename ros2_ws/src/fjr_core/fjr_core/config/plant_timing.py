# SPDX-License-Identifier: Apache-2.0
"""Parameters of the simulated robot's waiting times and of ~/advance."""

from __future__ import annotations

from .parameter import Parameter


def plant_timing_parameters() -> list[Parameter]:
    """Return the parameters of the plant's lock-step, of its silence after a restart and of ~/advance."""
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
            "restart_silence",
            1.0,
            "Silence after a reset or a pause, longer than the controller's state_timeout; not in lock-step",
            "s",
            minimum=0.0,
            maximum=1e3,
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
