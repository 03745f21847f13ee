# SPDX-License-Identifier: Apache-2.0
"""Combine a law with robust action: estimate disturbances, predict the state, integrate, compute the effort."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from ...errors import GainsError
from ...model.robot import Robot
from ...numerics.casadi_function import dense_function
from ...numerics.checks import Array
from ...numerics.one_line import one_line
from ...numerics.packed_vector import PackedVector
from ..sampled_law import AsSampledLaw, SampledLaw, step_symbols
from ..static_law import StaticLaw
from ..vdpbc.law import TrackingLaw
from .disturbance_observer import DisturbanceObserver
from .integral_action import IntegralAction, gain_values
from .loaded_law import loaded_expression
from .options import Robust
from .smith_predictor import EffortBuffer, Predictor

Terms = dict[str, ca.MX]


def sampled_law(law: StaticLaw, robust: Robust | None = None) -> SampledLaw:
    """Return the sampled law with the robust action requested, if any. Raises GainsError."""
    robust = (robust or Robust()).checked(law.robot.n)
    return AsSampledLaw(law) if robust.off else RobustLaw(law, robust)


@dataclass(frozen=True, eq=False)
class RobustLaw:
    """A law with robust action, as a SampledLaw (docs/robust.md).

    Each sample estimates the disturbance torques, predicts the state at the time the effort acts, and evaluates there
    the law that compensates the estimates and the integral. V is the storage at this state plus the energy of the
    integral. Estimates and integral action require a TrackingLaw.
    Raises GainsError for inconsistent options.
    """

    law: StaticLaw
    robust: Robust

    __repr__ = one_line

    def __post_init__(self) -> None:
        object.__setattr__(self, "robust", self.robust.checked(self.robot.n))
        if (self.robust.estimates or self.robust.integrates) and not isinstance(self.law, TrackingLaw):
            raise GainsError(
                f"robust action by estimates or an integral is enabled for a {type(self.law).__name__}; "
                "expected it for the law v_dpbc only"
            )

    @property
    def robot(self) -> Robot:
        """The robot model of the law."""
        return self.law.robot

    @property
    def lead(self) -> float:
        """Time [s] from the sample to the evaluation of the reference: the prediction horizon."""
        return self.robust.lead

    @property
    def gain_values(self) -> Array:
        """Gains of the law, then residual gains (2n,) and integral gains (integral_action.gain_values) if enabled."""
        r, values = self.robust, [self.law.gain_values]
        if r.estimates:
            values += [np.asarray(r.residual_gain), np.asarray(r.motor_residual_gain)]
        if r.integrates and isinstance(self.law, TrackingLaw):
            rates = np.asarray(r.integral_gain), np.asarray(r.motor_integral_gain)
            values.append(gain_values(self.robot, self.law.gains, rates))
        return np.concatenate(values)

    @property
    def memory(self) -> Array:
        """Initial controller state: zeros."""
        return np.zeros(self._memory.size)

    @cached_property
    def step_function(self) -> ca.Function:
        """SampledLaw.step_function."""
        s = step_symbols(self)
        u, V, parts = self._sample(s, self._gains.unpack(s["gains"]), self._memory.unpack(s["memory"]))
        return dense_function("robust_law", s, {"u": u, "V": V, "next": self._memory.pack(parts)})

    @cached_property
    def ready_step(self) -> ca.Function:
        """step_function, compiled if the law is compiled."""
        law, r = self.law, self.robust
        if not isinstance(law, TrackingLaw):
            return law.ready(self.step_function)
        which = f"{r.estimates:d}{r.integrates:d}_{r.delay!r}_{r.hold!r}".replace(".", "p").replace("-", "m")
        return law.derived(f"robust_law_{which}", lambda: self.step_function)

    def with_law(self, law: StaticLaw) -> RobustLaw:
        """Return this robust law for a law made by `self.law.with_gains`; nothing is built again."""
        other = RobustLaw(law, self.robust)
        other.__dict__.update(step_function=self.step_function, ready_step=self.ready_step)
        return other

    def _sample(self, s: Terms, gains: Terms, kept: Terms) -> tuple[ca.MX, ca.MX, Terms]:
        """Return u, V and the parts of the new controller state."""
        parts = self._buffer.step(kept, s["sent"], s["dt"]) if self._buffers else {}
        known, disturbance = self._estimated(s, gains, kept, parts)
        integral = ca.MX.zeros(2 * self.robot.n)
        if self.robust.integrates:
            integral = self._integral.step(kept, s["sent"], s["dt"])
        position, velocity = self._predicted(s, disturbance if self.robust.estimates else integral, parts)
        if not (self.robust.estimates or self.robust.integrates):
            return *self.law.measured_expression(position, velocity, s["jets"], gains["law"]), parts
        return self._commanded((position, velocity, s["jets"]), gains, known, disturbance, integral, parts)

    def _estimated(self, s: Terms, gains: Terms, kept: Terms, parts: Terms) -> tuple[ca.MX, ca.MX]:
        """Return the feedforward link torque with two derivatives (n, 3) and the estimates (2n,); update `parts`."""
        n = self.robot.n
        if not self.robust.estimates:
            return ca.MX.zeros(n, 3), ca.MX.zeros(2 * n)
        acted, L = self._buffer.mean(parts, s["dt"]), gains["residual"]
        parts |= self._observer.step(kept, s["position"], s["velocity"], acted, L, s["dt"])
        return self._observer.fed_forward(parts, L), parts["r"]

    def _predicted(self, s: Terms, disturbance: ca.MX, parts: Terms) -> tuple[ca.MX, ca.MX]:
        """Return position and velocity (2n,) at the time the effort acts, under disturbance torques (2n,)."""
        r, position, velocity = self.robust, s["position"], s["velocity"]
        if not r.predicts:
            return position, velocity
        acting = self._buffer.acting(parts, 0.0, r.delay)
        newest = ca.vertsplit(parts["efforts"], self.robot.n)[0]
        predictor = Predictor(self.robot, r.hold, r.delay)
        return predictor.predict(position, velocity, disturbance, [*acting, (newest, r.hold / 2)])

    def _commanded(
        self,
        at: tuple[ca.MX, ca.MX, ca.MX],
        gains: Terms,
        known: ca.MX,
        disturbance: ca.MX,
        integral: ca.MX,
        parts: Terms,
    ) -> tuple[ca.MX, ca.MX, Terms]:
        """Return u, V and the new controller state of the law that compensates these torques."""
        n, integrates = self.robot.n, self.robust.integrates
        loaded = loaded_expression(self.law, integrates)  # type: ignore[arg-type]
        arguments = (*at, gains["law"], known, disturbance[n:] + integral[n:])
        if not integrates:
            u, V, *_ = loaded(*arguments)
            return u, V, parts
        u, V, _, port_m, port_l = loaded(*arguments, integral[:n], self._integral.matrix(gains, "K_l"))
        parts |= self._integral.parts(integral, (port_l, port_m), gains, u)
        return u, V + self._integral.energy(integral, gains), parts

    @property
    def _buffers(self) -> bool:
        return self.robust.estimates or self.robust.predicts

    @cached_property
    def _gains(self) -> PackedVector:
        n, r = self.robot.n, self.robust
        residual = {"residual": 2 * n} if r.estimates else {}
        integral = self._integral.gain_sizes if r.integrates else {}
        return PackedVector({"law": len(self.law.gain_values), **residual, **integral})

    @cached_property
    def _memory(self) -> PackedVector:
        r = self.robust
        sizes = self._buffer.sizes if self._buffers else {}
        sizes = sizes | (self._observer.sizes if r.estimates else {})
        return PackedVector(sizes | (self._integral.sizes if r.integrates else {}))

    @cached_property
    def _buffer(self) -> EffortBuffer:
        return EffortBuffer(self.robot.n, self.robust.delay, self.robust.hold)

    @cached_property
    def _observer(self) -> DisturbanceObserver:
        return DisturbanceObserver(self.robot)

    @cached_property
    def _integral(self) -> IntegralAction:
        return IntegralAction(self.robot, self.robust.hold)
