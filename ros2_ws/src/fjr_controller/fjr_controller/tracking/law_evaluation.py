# SPDX-License-Identifier: Apache-2.0
"""Evaluate the control law u(x, x, t) at the measured state, with its controller state if it has one."""

from __future__ import annotations

import numpy as np

from fjr_core import GainsError
from fjr_core.control.robust import Robust, RobustLaw, sampled_law
from fjr_core.control.sampled_law import BoundStep
from fjr_core.control.static_law import BoundCommand, StaticLaw
from fjr_core.numerics.checks import Array
from fjr_core.trajectories.reference import JETS

from .law_state import LawState
from .measured_state import MeasuredState
from .stamp_order import Order


class LawEvaluation:
    """A static law, or with robust action a law with a controller state (docs/robust.md), bound to the measured state.

    lead [ns]: prediction horizon of the law; the reference is evaluated this long after the sample.
    Raises GainsError for a law whose effort is not finite.
    """

    def __init__(self, law: StaticLaw, robust: Robust | None, state: MeasuredState) -> None:
        self._state, self._jets = state, np.zeros((JETS, law.robot.n))
        self._sampled = sampled_law(law, robust)
        self._bound: BoundCommand | BoundStep
        self._law_state: LawState | None = None
        self.lead = round(self._sampled.lead * 1e9)
        self.use(law)

    def use(self, law: StaticLaw) -> None:
        """Replace the law by one with other gains; its controller state is kept.

        Raise GainsError if its effort is not finite at the measured state, or with every position and velocity at 1;
        then nothing is replaced.
        """
        arrays = self._state.position, self._state.velocity, self._jets
        if not isinstance(self._sampled, RobustLaw):
            bound = law.bound(*arrays)
            self._check_finite(bound, "'gains.*'")
            self.law, self._bound = law, bound
            return
        sampled = self._sampled.with_law(law)
        step = sampled.bound(*arrays)
        self._check_finite(step, "'gains.*' and 'robust.*'")
        self._law_state = LawState(step) if self._law_state is None else self._law_state.moved_to(step)
        self.law, self._sampled, self._bound = law, sampled, step

    def evaluate(self, jets: Array, order: Order, dt: int, sent: Array) -> tuple[Array, float]:
        """Return u (n,) [N m], nan if the next controller state is not finite, and V [J] for reference jets (5, n).

        dt [ns]: time since the last accepted sample. sent (n,) [N m]: last effort that was sent.
        """
        np.copyto(self._jets, jets)
        if self._law_state is None:
            self._bound.evaluate()
            return self._bound.u.copy(), self._bound.V.item()
        self._law_state.prepare(order, dt, sent)
        self._bound.evaluate()
        u = self._bound.u.copy() if self._law_state.finite else np.full(len(sent), np.nan)
        return u, self._bound.V.item()

    def accept(self) -> None:
        """Keep the controller state of the last evaluation: the sample counts."""
        if self._law_state is not None:
            self._law_state.accept()

    def reset(self) -> None:
        """Reset the controller state: the law does not act, or its effort is not sent."""
        if self._law_state is not None:
            self._law_state.reset()

    def _check_finite(self, bound: BoundCommand | BoundStep, parameters: str) -> None:
        """Raise GainsError if the effort is not finite at 1 or at the measured state (0 if that is not finite)."""
        values = self._state.values
        measured, finite = values.copy(), True
        for point in (np.ones_like(values), measured if self._state.finite else 0.0):
            values[...] = point
            bound.evaluate()
            finite = finite and bool(bound.u.dot(bound.u) < np.inf)
        values[...] = measured
        if not finite:
            raise GainsError(f"parameters {parameters} give an effort that is not finite; expected smaller gains")
