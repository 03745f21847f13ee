# SPDX-License-Identifier: Apache-2.0
"""Select the effort of a sample (law, stop policy or last effort) and pass it through transfer and limits."""

from __future__ import annotations

import math

from fjr_core.control.robust import Robust
from fjr_core.control.safety_settings import Settings
from fjr_core.control.static_law import StaticLaw
from fjr_core.errors import UserCodeError
from fjr_core.numerics.checks import Array

from .effort_limits import EffortLimits
from .events import Journal
from .law_evaluation import LawEvaluation
from .measured_state import MeasuredState
from .stamp_order import Order
from .stop_policy import StopPolicy
from .supervisor import Supervisor


class EffortOutput:
    """Law, stop policy and effort limits, in the state that the supervisor determines.

    Raises GainsError if the law's effort is not finite.
    """

    def __init__(
        self, law: StaticLaw, robust: Robust | None, settings: Settings, state: MeasuredState, journal: Journal
    ) -> None:
        self._settings, self._state = settings, state
        self.law, self.policy = LawEvaluation(law, robust, state), StopPolicy(law, settings)
        self.limits = EffortLimits(settings, journal)

    def apply(self, settings: Settings) -> None:
        """Replace the settings of stop policy and limits."""
        self._settings = settings
        self.limits.apply(settings)
        self.policy.apply(self.law.law, settings)

    def use(self, law: StaticLaw) -> None:
        """Replace the law (other gains). Raise GainsError if its effort is not finite; then the law remains."""
        self.law.use(law)
        self.policy.apply(law, self._settings)

    def select(self, supervisor: Supervisor, jets: Array, order: Order, stamp: int, dt: int) -> tuple[Array, float]:
        """Return the effort (n,) [N m] before transfer and limits, with V [J]: nan unless it is the law's.

        jets (5, n): reference at the stamp [ns], dt [ns] after the last accepted sample. While stopped it is the stop
        policy's effort; while velocities settle it is the last effort, or at a start the stop policy's. Stop if a law
        in Python fails.
        """
        state = self._state
        if not (supervisor.reason or supervisor.settling):
            lead = self.law.lead
            ahead = supervisor.reference.jets(stamp + lead) if lead else jets
            try:
                return self.law.evaluate(ahead, order, dt, self.limits.left)
            except UserCodeError as error:
                supervisor.refuse_law(str(error))
        self.law.reset()
        if supervisor.reason:
            return self.policy.moving(state.q_l, state.dq_m), math.nan
        return self.policy.at(state.q_l) if supervisor.starting else self.limits.sent.copy(), math.nan

    def send(self, supervisor: Supervisor, selected: Array, V: float, stamp: int) -> Array:
        """Return the effort (n,) [N m] that is sent; the bound on V continues only if it is the law's own."""
        limits = self.limits
        u = limits.send(supervisor.transfer.apply(selected, limits.sent, self.policy.standing, stamp), stamp)
        if u is selected and math.isfinite(V):
            supervisor.bound_start = stamp if supervisor.bound_start is None else supervisor.bound_start
        else:
            supervisor.bound_start = None
        return u

    def send_without_sample(self, supervisor: Supervisor) -> Array:
        """Return the stop policy's effort (n,) [N m] within the effort limits; the rate limits do not apply."""
        u = self.limits.saturate(self.policy.standing())
        self.limits.replace(u)
        self.law.reset()
        supervisor.bound_start = None
        return u
