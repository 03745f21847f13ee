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

from .measured_state import MeasuredState
from .stamp_order import Order


class LawState:
    """Advance the controller state where a sample follows one for which the law acted; reset it everywhere else.

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
        """An effort was sent: the law's, if it was evaluated."""
        self._continues = self._evaluated

    def reset(self) -> None:
        """Start from the initial state at the next sample."""
        self._evaluated = self._continues = False


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

        Raise GainsError if its effort is not finite at the measured state, or with every position and velocity at 1
        (not for a law in Python); then nothing is replaced. Raise UserCodeError if a law in Python fails there.
        """
        arrays = self._state.position, self._state.velocity, self._jets
        if not isinstance(self._sampled, RobustLaw):
            bound = law.bound(*arrays)
            self._check_finite(law, bound, "'law.options.*'" if law.in_python else "'gains.*'")
            self.law, self._bound = law, bound
            return
        sampled = self._sampled.with_law(law)
        step = sampled.bound(*arrays)
        self._check_finite(law, step, "'gains.*' and 'robust.*'")
        self._law_state = LawState(step) if self._law_state is None else self._law_state.moved_to(step)
        self.law, self._sampled, self._bound = law, sampled, step

    def evaluate(self, jets: Array, order: Order, dt: int, sent: Array) -> tuple[Array, float]:
        """Return u (n,) [N m], nan if the next controller state is not finite, and V [J] for reference jets (5, n).

        dt [ns]: time since the last accepted sample. sent (n,) [N m]: last effort that was sent. Raise UserCodeError
        if a law in Python fails.
        """
        found = self._evaluate(jets, order, dt, sent)
        self.law.raise_failure()
        return found

    def _evaluate(self, jets: Array, order: Order, dt: int, sent: Array) -> tuple[Array, float]:
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

    def _check_finite(self, law: StaticLaw, bound: BoundCommand | BoundStep, parameters: str) -> None:
        """Raise GainsError if the effort is not finite at 1 or at the measured state (0 if that is not finite)."""
        values = self._state.values
        measured, finite = values.copy(), True
        here = measured if self._state.finite else 0.0
        for point in (here,) if law.in_python else (np.ones_like(values), here):  # its domain may be smaller
            values[...] = point
            bound.evaluate()
            finite = finite and bool(bound.u.dot(bound.u) < np.inf)
        values[...] = measured
        law.raise_failure()
        if not finite:
            raise GainsError(f"parameters {parameters} give an effort that is not finite; expected smaller gains")
