# SPDX-License-Identifier: Apache-2.0
"""The controller state of a law with robust action, from sample to sample."""

from __future__ import annotations

import numpy as np

from fjr_core.control.sampled_law import BoundStep
from fjr_core.numerics.checks import Array

from .stamp_order import Order


class LawState:
    """Advance the controller state if the law acted at the previous sample; reset it otherwise.

    A repeated sample is evaluated again with the same state. The state after a sample counts only after `accept`.
    """

    def __init__(self, step: BoundStep) -> None:
        self._step, self._evaluated, self._continues = step, False, False

    def moved_to(self, step: BoundStep) -> LawState:
        """Return this controller state for another step with a state of the same layout (other gains)."""
        np.copyto(step.memory, self._step.memory)
        np.copyto(step.next, self._step.next)
        np.copyto(step.sent, self._step.sent)
        np.copyto(step.dt, self._step.dt)
        moved = LawState(step)
        moved._evaluated, moved._continues = self._evaluated, self._continues
        return moved

    def prepare(self, order: Order, dt: int, sent: Array) -> None:
        """Set the inputs of the step for a sample dt [ns] after the last one; sent (n,) [N m]: last effort sent."""
        step, self._evaluated = self._step, True
        if order is Order.REPEATED and self._continues:
            return
        if order is Order.NEXT and self._continues:
            step.keep()
            step.dt[0] = dt * 1e-9
        else:
            step.forget()
        np.copyto(step.sent, sent)

    @property
    def finite(self) -> bool:
        """Return True if the state after the sample is finite."""
        return bool(self._step.next.dot(self._step.next) < np.inf)

    def accept(self) -> None:
        """Record that the effort was sent; it is the law's if the law was evaluated."""
        self._continues = self._evaluated

    def reset(self) -> None:
        """Start from the initial state at the next sample."""
        self._evaluated = self._continues = False
