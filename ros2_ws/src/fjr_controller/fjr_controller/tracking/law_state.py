# SPDX-License-Identifier: Apache-2.0
"""When the memory of a law with robust action goes on from sample to sample, and when it begins anew."""

from __future__ import annotations

import numpy as np

from fjr_core.control.sampled_law import BoundStep
from fjr_core.numerics.checks import Array

from .stamp_order import Order


class Recollection:
    """The memory goes on where a sample follows one that the law answered; it begins anew everywhere else.

    A repeated sample is asked about once more as it was. What the last sample left counts only after `accept`.
    """

    def __init__(self, step: BoundStep) -> None:
        self._step, self._asked, self._goes_on = step, False, False

    def taken_over(self, step: BoundStep) -> Recollection:
        """The same memory for another step whose memory has the same layout (other gains)."""
        np.copyto(step.memory, self._step.memory)
        np.copyto(step.next, self._step.next)
        np.copyto(step.sent, self._step.sent)
        np.copyto(step.dt, self._step.dt)
        other = Recollection(step)
        other._asked, other._goes_on = self._asked, self._goes_on
        return other

    def place(self, order: Order, dt: int, sent: Array) -> None:
        """The law is asked about a sample, dt [ns] after the last one; sent (n,): the last effort that left."""
        step, self._asked = self._step, True
        if order is Order.REPEATED and self._goes_on:
            return
        if order is Order.NEXT and self._goes_on:
            step.keep()
            step.dt[0] = dt * 1e-9
        else:
            step.forget()
        np.copyto(step.sent, sent)

    @property
    def finite(self) -> bool:
        """Whether what would be remembered is."""
        return bool(self._step.next.dot(self._step.next) < np.inf)

    def accept(self) -> None:
        """An answer left: the law's, if it was asked."""
        self._goes_on = self._asked

    def forget(self) -> None:
        """The law does not answer, or its answer does not leave: the next sample is the first."""
        self._asked = self._goes_on = False
