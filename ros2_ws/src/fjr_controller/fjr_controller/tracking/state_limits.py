# SPDX-License-Identifier: Apache-2.0
"""Limits of the measured state: positions, velocities, deflection and tracking error, compared in one operation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fjr_core.control.safety_settings import Settings
from fjr_core.numerics.checks import Array

from .measured_state import MeasuredState

_KINDS = (  # quantity, its symbol, its field of Units
    ("link position", "q_l", "position"),
    ("motor position", "q_m", "position"),
    ("link velocity", "dq_l", "velocity"),
    ("motor velocity", "dq_m", "velocity"),
    ("deflection", "q_m - q_l", "position"),
    ("tracking error", "q_l - q_ld", "position"),
)


@dataclass(frozen=True)
class Violation:
    """A violated limit: its kind ("link position" .. "tracking error"), the joint, the value and the limit."""

    kind: str
    joint: str
    value: float
    limit: float
    sentence: str


class StateLimits:
    """Lower and upper limits (6n,) of MeasuredState.limited; a value equal to its limit is within."""

    def __init__(self, settings: Settings, state: MeasuredState) -> None:
        self._state, size = state, len(state.limited)
        self._below, self._above = np.zeros(size, dtype=bool), np.zeros(size, dtype=bool)
        self.apply(settings)

    def apply(self, settings: Settings) -> None:
        """Replace the limits."""
        sizes = [settings.link_velocity, settings.motor_velocity, settings.deflection, settings.tracking_error]
        self._upper = np.concatenate([settings.link_position_upper, settings.motor_position_upper, *sizes])
        lower = [settings.link_position_lower, settings.motor_position_lower]
        self._lower = np.concatenate([*lower, *(-np.asarray(size) for size in sizes)])
        self._joints, self._units = settings.joints, settings.units
        self._limited = bool(np.isfinite([self._lower, self._upper]).any())

    def violation(self, q_ld: Array | None, velocities: bool = True) -> Violation | None:
        """Return the first violated limit, or None.

        q_ld (n,) [rad]: desired link positions; None skips the limit of the tracking error.
        velocities: False skips the limits of the velocities.
        """
        if not self._limited:
            return None
        state = self._state
        np.subtract(state.q_m, state.q_l, out=state.deflection)
        np.subtract(state.q_l, state.q_l if q_ld is None else q_ld, out=state.tracking_error)
        np.less(state.limited, self._lower, out=self._below)
        np.greater(state.limited, self._upper, out=self._above)
        np.logical_or(self._below, self._above, out=self._above)
        if not velocities:
            self._above[2 * len(self._joints) : 4 * len(self._joints)] = False
        return self._first() if np.count_nonzero(self._above) else None

    def _first(self) -> Violation:
        i = int(np.argmax(self._above))
        (kind, symbol, quantity), j = _KINDS[i // len(self._joints)], i % len(self._joints)
        joint, value, unit = self._joints[j], float(self._state.limited[i]), getattr(self._units[j], quantity)
        limit = float(self._lower[i] if self._below[i] else self._upper[i])
        side = "at least" if self._below[i] else "at most"
        sentence = f"{kind} of {joint}: {symbol} = {value:.6g} {unit}; expected {side} {limit:.6g} {unit}"
        return Violation(kind, joint, value, limit, sentence)
