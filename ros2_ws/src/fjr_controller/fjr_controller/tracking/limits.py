# SPDX-License-Identifier: Apache-2.0
"""Limits of the state and of the effort, and the effort of a stop; everything is compared at once."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from fjr_core.control.safety_settings import GRAVITY_HOLD, Settings
from fjr_core.control.static_law import StaticLaw
from fjr_core.numerics.casadi_function import numeric
from fjr_core.numerics.checks import Array

_KINDS = (  # what, its symbol, its field of Units
    ("link position", "q_l", "position"),
    ("motor position", "q_m", "position"),
    ("link velocity", "dq_l", "velocity"),
    ("motor velocity", "dq_m", "velocity"),
    ("deflection", "q_m - q_l", "position"),
    ("tracking error", "q_l - q_ld", "position"),
)


@dataclass(frozen=True)
class Violation:
    """A limit of the state that is broken: which (one of "link position" .. "tracking error"), where, by what."""

    kind: str
    joint: str
    value: float
    limit: float
    sentence: str


class StateLimits:
    """The measured state of n joints with its limits, kept in one row of six blocks of n.

    position (2n,) = (q_l, q_m) and velocity (2n,) = (dq_l, dq_m) are views of that row.
    """

    def __init__(self, settings: Settings) -> None:
        n = settings.n
        self._row = np.zeros(6 * n)
        self.state, self.position, self.velocity = self._row[: 4 * n], self._row[: 2 * n], self._row[2 * n : 4 * n]
        self.q_l, self.q_m, self.dq_l, self.dq_m, self._zeta, self._error = self._row.reshape(6, n)
        self._below, self._above = np.zeros(6 * n, dtype=bool), np.zeros(6 * n, dtype=bool)
        self.limit(settings)

    def limit(self, settings: Settings) -> None:
        """Other limits."""
        sizes = [settings.link_velocity, settings.motor_velocity, settings.deflection, settings.tracking_error]
        self._upper = np.concatenate([settings.link_position_upper, settings.motor_position_upper, *sizes])
        lower = [settings.link_position_lower, settings.motor_position_lower]
        self._lower = np.concatenate([*lower, *(-np.asarray(size) for size in sizes)])
        self._joints, self._units = settings.joints, settings.units
        self._on = bool(np.isfinite([self._lower, self._upper]).any())

    def violation(self, q_ld: Array | None, velocities: bool = True) -> Violation | None:
        """The first limit that the state breaks, with the reference q_ld (n,); a value at its limit is within.

        None: that of the tracking error is not looked at. velocities: whether those of the velocities are.
        """
        if not self._on:
            return None
        np.subtract(self.q_m, self.q_l, out=self._zeta)
        np.subtract(self.q_l, self.q_l if q_ld is None else q_ld, out=self._error)
        np.less(self._row, self._lower, out=self._below)
        np.greater(self._row, self._upper, out=self._above)
        np.logical_or(self._below, self._above, out=self._above)
        if not velocities:
            self._above[2 * len(self._joints) : 4 * len(self._joints)] = False
        return self._worst() if np.count_nonzero(self._above) else None

    def _worst(self) -> Violation:
        i = int(np.argmax(self._above))
        (kind, symbol, what), j = _KINDS[i // len(self._joints)], i % len(self._joints)
        joint, value, unit = self._joints[j], float(self._row[i]), getattr(self._units[j], what)
        limit = float(self._lower[i] if self._below[i] else self._upper[i])
        side = "at least" if self._below[i] else "at most"
        sentence = f"{kind} of {joint}: {symbol} = {value:.6g} {unit}; expected {side} {limit:.6g} {unit}"
        return Violation(kind, joint, value, limit, sentence)


class EffortLimits:
    """Cuts efforts to their limits and their change to its rate, and counts for how long.

    left (n,) [N m] is the last effort that left, zero before the first; sent (n,) is it within the limits of now,
    from which the rate counts. Of it: clipped and slowed, whether the limits or the rate changed it, saturated (n,),
    which joints. seconds (n,), seconds_any: time spent so [s].
    """

    def __init__(self, settings: Settings) -> None:
        n = settings.n
        self.sent, self.left = np.zeros(n), np.zeros(n)
        self.saturated = np.zeros(n, dtype=bool)
        self.seconds, self.seconds_any = np.zeros(n), 0.0
        self.clipped = self.slowed = False
        self._stamp: int | None = None
        self._pair = np.zeros((2, n))  # |u| and |u - sent|
        self._most = np.zeros((2, n))  # of these
        self._above, self._dt = np.zeros((2, n), dtype=bool), 0.0
        self.limit(settings)

    def limit(self, settings: Settings) -> None:
        """Other limits; the last effort sent counts as within them, though what left stays what it was."""
        self._limit, rate = np.asarray(settings.effort), np.asarray(settings.effort_rate)
        limited = np.isfinite(rate)
        self._limited, self._rated = bool(np.isfinite(self._limit).any()), bool(limited.any())
        self._rate, self._free = np.where(limited, rate, 0.0), np.where(limited, 0.0, np.inf)
        self._most[:] = self._limit, self._steps(self._dt)
        self._longest = round(settings.state_timeout * 1e9)
        self.clipped = self.clipped and self._limited
        self.slowed = self.slowed and self._rated
        self.sent[...] = self.cut(self.sent)

    def cut(self, u: Array) -> Array:
        """The effort u (n,) within the effort limits."""
        return np.clip(u, -self._limit, self._limit) if self._limited else u

    def send(self, u: Array, stamp: int) -> Array:
        """What leaves for the finite effort u (n,) in answer to `stamp` [ns]: u itself where nothing limits it."""
        dt = 0.0 if self._stamp is None else min(max(stamp - self._stamp, 0), self._longest) * 1e-9
        if self.clipped:
            self.seconds += dt * self.saturated
            self.seconds_any += dt
        if (self._limited or self._rated) and self._exceeds(u, dt):
            u = self._slow(self._within(u))
        self._stamp = stamp
        self._took(u)
        return u

    def _exceeds(self, u: Array, dt: float) -> bool:
        """Whether u is above a limit or too far from the last one, over dt [s]."""
        if dt != self._dt:
            self._dt, self._most[1] = dt, self._steps(dt)
        pair = self._pair
        np.copyto(pair[0], u)
        np.subtract(u, self.sent, out=pair[1])
        np.abs(pair, out=pair)
        np.greater(pair, self._most, out=self._above)
        if np.count_nonzero(self._above):
            return True
        self.clipped = self.slowed = False
        return False

    def _steps(self, dt: float) -> Array:
        """How far each effort may be from the last one after dt [s]."""
        return self._rate * dt + self._free

    def _within(self, u: Array) -> Array:
        np.copyto(self.saturated, self._above[0])
        self.clipped = bool(self.saturated.any())
        return self.cut(u) if self.clipped else u

    def _slow(self, u: Array) -> Array:
        step = self._most[1]
        self.slowed = bool((np.abs(u - self.sent) > step).any())
        return np.clip(u, self.sent - step, self.sent + step) if self.slowed else u

    def replace(self, u: Array) -> None:
        """An effort that left without an answer (a silence, the end)."""
        self._took(u)
        self.clipped = self.slowed = False

    def _took(self, u: Array) -> None:
        np.copyto(self.sent, u)
        np.copyto(self.left, u)


class StopPolicy:
    """Efforts of a stop: none, or the weight of the links, B_m^-1 (grad P_l(q_l) - K_md dq_m) while states come.

    released: no effort at all, whatever was set: signs or joints are wrong, and the weight would push or drive the arm.
    """

    def __init__(self, law: StaticLaw, settings: Settings) -> None:
        q_l = ca.SX.sym("q_l", law.robot.n)
        self._grad_P_l = numeric("grad_P_l", {"q_l": q_l}, {"grad_P_l": law.robot.links.grad_P_l(q_l)})
        self._q_l = np.zeros(law.robot.n)
        self._known = self.released = False
        self.limit(law, settings)

    def limit(self, law: StaticLaw, settings: Settings) -> None:
        """Other gains or settings."""
        self._holds = settings.on_stop == GRAVITY_HOLD
        self._B_inv, self._K_md = np.linalg.inv(law.robot.B_m), law.hold_damping

    def remember(self, q_l: Array) -> None:
        """The links were here in a good sample."""
        np.copyto(self._q_l, q_l)
        self._known = True

    def moving(self, q_l: Array, dq_m: Array) -> Array:
        """The effort (n,) for a sample, finite; the motors' motion is damped by K_md."""
        if self.released or not self._holds:
            return np.zeros(len(q_l))
        u = self._B_inv @ (self._grad_P_l(q_l)[0] - self._K_md @ dq_m)
        return u if u.dot(u) < np.inf else self.standing()

    def standing(self) -> Array:
        """The effort (n,) without a sample, finite: the weight where the links were last; zero before that."""
        return self.at(self._q_l) if self._known else np.zeros(len(self._q_l))

    def at(self, q_l: Array) -> Array:
        """The effort (n,) for links at rest at q_l (n,) [rad]."""
        holds = self._holds and not self.released
        return self._B_inv @ self._grad_P_l(q_l)[0] if holds else np.zeros(len(q_l))
