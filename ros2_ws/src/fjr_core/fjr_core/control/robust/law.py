# SPDX-License-Identifier: Apache-2.0
"""A law with robust action, sample by sample: estimate the torques beside the model, predict, integrate, command."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from ...errors import GainsError
from ...numerics.casadi_function import dense_function
from ...numerics.checks import Array
from ...robot.robot import Robot
from ...trajectories.reference import JETS
from ..sampled_law import ARGUMENTS, BoundStep, MeasuredLaw, SampledLaw, Static, bound_step
from ..static_law import StaticLaw
from ..vdpbc.law import TrackingLaw
from .disturbance_observer import MomentumResidual
from .integral_action import Integral, gain_values
from .loaded_law import loaded_expression
from .options import Robust
from .packed_state import Parts
from .smith_predictor import Model, Waiting

Terms = dict[str, ca.MX]


def sampled_law(law: MeasuredLaw, robust: Robust | None = None) -> SampledLaw:
    """The law as it is run: with robust action, Static where there is none. Raises GainsError."""
    robust = (robust or Robust()).checked(law.robot.n)
    return Static(law) if robust.off else RobustLaw(law, robust)


@dataclass(frozen=True, eq=False)
class RobustLaw:
    """A law with robust action, as a SampledLaw.

    The torques that act beside the model are estimated at the sample; with them the state is predicted to when the
    effort acts; there the law, which counts on the estimates and the integral, is evaluated. V is its storage there,
    with the energy of the integral: docs/robust.md. Estimates and integral: for a TrackingLaw only.
    Raises GainsError for options that do not fit.
    """

    law: MeasuredLaw
    robust: Robust

    def __post_init__(self) -> None:
        object.__setattr__(self, "robust", self.robust.checked(self.robot.n))
        if (self.robust.estimates or self.robust.integrates) and not isinstance(self.law, TrackingLaw):
            raise GainsError(
                f"robust action by estimates or an integral is for the law v_dpbc; expected none of it for a "
                f"{type(self.law).__name__}"
            )

    @property
    def robot(self) -> Robot:
        """The robot that the law believes in."""
        return self.law.robot

    @property
    def lead(self) -> float:
        """How long after the sample the reference is taken [s]: where the state is predicted to."""
        return self.robust.lead

    @property
    def gain_values(self) -> Array:
        """The law's gains, then residual gains (2n,) and the integral's (gain_values), where they are used."""
        r, values = self.robust, [self.law.gain_values]
        if r.estimates:
            values += [np.asarray(r.residual_gain), np.asarray(r.motor_residual_gain)]
        if r.integrates and isinstance(self.law, TrackingLaw):
            rates = np.asarray(r.integral_gain), np.asarray(r.motor_integral_gain)
            values.append(gain_values(self.robot, self.law.gains, rates))
        return np.concatenate(values)

    @property
    def memory(self) -> Array:
        """Zeros: nothing was seen."""
        return np.zeros(self._memory.size)

    @cached_property
    def step_function(self) -> ca.Function:
        """SampledLaw.step_function."""
        n, g = self.robot.n, len(self.gain_values)
        sizes = {"position": 2 * n, "velocity": 2 * n, "gains": g, "memory": self._memory.size, "sent": n, "dt": 1}
        s = {name: ca.MX.sym(name, rows) for name, rows in sizes.items()} | {"jets": ca.MX.sym("jets", n, JETS)}
        u, V, parts = self._sample(s, self._gains.split(s["gains"]), self._memory.split(s["memory"]))
        inputs = {name: s[name] for name in ARGUMENTS}
        return dense_function("robust_law", inputs, {"u": u, "V": V, "next": self._memory.join(parts)})

    @cached_property
    def ready_step(self) -> ca.Function:
        """step_function as machine code where the law is."""
        law, r = self.law, self.robust
        if not isinstance(law, TrackingLaw):
            return law.ready(self.step_function) if isinstance(law, StaticLaw) else self.step_function
        which = f"{r.estimates:d}{r.integrates:d}_{r.delay!r}_{r.hold!r}".replace(".", "p").replace("-", "m")
        return law.derived(f"robust_law_{which}", lambda: self.step_function)

    def with_law(self, law: MeasuredLaw) -> RobustLaw:
        """The same of a law made by `self.law.with_gains`: nothing is built again."""
        other = RobustLaw(law, self.robust)
        other.__dict__.update(step_function=self.step_function, ready_step=self.ready_step)
        return other

    def bound(self, position: Array, velocity: Array, jets: Array) -> BoundStep:
        """A sample from these contiguous arrays (2n,), (2n,), (5, n), which each evaluation reads."""
        return bound_step(self, position, velocity, jets, self.ready_step)

    def _sample(self, s: Terms, gains: Terms, kept: Terms) -> tuple[ca.MX, ca.MX, Terms]:
        """u, V and the memory anew."""
        parts = self._waiting.step(kept, s["sent"], s["dt"]) if self._waits else {}
        known, beside = self._estimated(s, gains, kept, parts)
        integral = ca.MX.zeros(2 * self.robot.n)
        if self.robust.integrates:
            integral = self._integral.step(kept, s["sent"], s["dt"])
        position, velocity = self._predicted(s, beside if self.robust.estimates else integral, parts)
        if not (self.robust.estimates or self.robust.integrates):
            return *self.law.measured_expression(position, velocity, s["jets"], gains["law"]), parts
        return self._commanded((position, velocity, s["jets"]), gains, known, beside, integral, parts)

    def _estimated(self, s: Terms, gains: Terms, kept: Terms, parts: Terms) -> tuple[ca.MX, ca.MX]:
        """Torque fed forward to the links with two rates (n, 3), and the estimates (2n,); fills `parts`."""
        n = self.robot.n
        if not self.robust.estimates:
            return ca.MX.zeros(n, 3), ca.MX.zeros(2 * n)
        acted, L = self._waiting.mean(parts, s["dt"]), gains["residual"]
        parts |= self._residual.step(kept, s["position"], s["velocity"], acted, L, s["dt"])
        return self._residual.fed_forward(parts, L), parts["r"]

    def _predicted(self, s: Terms, beside: ca.MX, parts: Terms) -> tuple[ca.MX, ca.MX]:
        """Position and velocity (2n,) when the effort acts, under torques beside the model (2n,)."""
        r, position, velocity = self.robust, s["position"], s["velocity"]
        if not r.predicts:
            return position, velocity
        acting = self._waiting.acting(parts, 0.0, r.delay)
        newest = ca.vertsplit(parts["efforts"], self.robot.n)[0]
        return self._model.after(position, velocity, beside, [*acting, (newest, r.hold / 2)])

    def _commanded(
        self, at: tuple[ca.MX, ca.MX, ca.MX], gains: Terms, known: ca.MX, beside: ca.MX, integral: ca.MX, parts: Terms
    ) -> tuple[ca.MX, ca.MX, Terms]:
        """u, V and the memory of the law that counts on these torques."""
        n = self.robot.n
        arguments = (*at, gains["law"], known, beside[n:] + integral[n:])
        if not self.robust.integrates:
            u, V, *_ = self._loaded(*arguments)
            return u, V, parts
        u, V, _, port_m, port_l = self._loaded(*arguments, integral[:n], self._integral.matrix(gains, "K_l"))
        parts |= self._integral.parts(integral, (port_l, port_m), gains, u)
        return u, V + self._integral.energy(integral, gains), parts

    @property
    def _waits(self) -> bool:
        return self.robust.estimates or self.robust.predicts

    @cached_property
    def _gains(self) -> Parts:
        n, r = self.robot.n, self.robust
        residual = {"residual": 2 * n} if r.estimates else {}
        integral = self._integral.gain_sizes if r.integrates else {}
        return Parts({"law": len(self.law.gain_values), **residual, **integral})

    @cached_property
    def _memory(self) -> Parts:
        r = self.robust
        sizes = self._waiting.sizes if self._waits else {}
        sizes = sizes | (self._residual.sizes if r.estimates else {})
        return Parts(sizes | (self._integral.sizes if r.integrates else {}))

    @cached_property
    def _waiting(self) -> Waiting:
        return Waiting(self.robot.n, self.robust.delay, self.robust.hold)

    @cached_property
    def _residual(self) -> MomentumResidual:
        return MomentumResidual(self.robot)

    @cached_property
    def _integral(self) -> Integral:
        return Integral(self.robot, self.robust.hold)

    @cached_property
    def _model(self) -> Model:
        return Model(self.robot, self.robust.hold, self.robust.delay)

    @cached_property
    def _loaded(self) -> ca.Function:
        return loaded_expression(self.law, self.robust.integrates)  # type: ignore[arg-type]
