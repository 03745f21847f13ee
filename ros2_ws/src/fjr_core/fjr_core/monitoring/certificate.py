# SPDX-License-Identifier: Apache-2.0
"""The certificate of the running loop: the law's storage and the robot's energy, with their exact rates.

    dV/dt = -dissipation + s_m' B_m (u - u_law(x))      whatever effort u acts, as long as the robot is the model
    dH/dt = dq_m' B_m u - dq_l' D_l dq_l - dq_m' D_m dq_m

The first is (50) with omega = B_m (u - u_law) in (42): a held, late, cut or lost effort is another input of the
virtual system. Both hold along the plant (36) only, so what they leave over is the model's error.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ..control.vdpbc.law import TrackingLaw
from ..errors import StateError
from ..numerics import checks
from ..numerics.casadi_function import NumericFunction, dense_function
from ..numerics.checks import Array
from ..trajectories.reference import JETS

OUTPUTS = ("V", "H", "dissipation", "dissipated", "u_law", "drive", "slope")


@dataclass(frozen=True)
class CertificateSample:
    """The certificate at one instant.

    V [J]: the law's storage, (43). dV [W]: its rate under the effort given. H [J]: the robot's energy, (36).
    supplied, dissipated [W]: dH/dt = supplied - dissipated. u_law (n,) [N m]: the law's effort here.
    slope (4n,): dV/d(position, velocity) [N m, N m s], the reference held.
    """

    V: float
    dV: float
    H: float
    supplied: float
    dissipated: float
    u_law: Array
    slope: Array


@dataclass(frozen=True)
class CertificateSeries:
    """The same at k instants: V, dV, H, supplied, dissipated (k,), u_law (k, n), slope (k, 4n)."""

    V: Array
    dV: Array
    H: Array
    supplied: Array
    dissipated: Array
    u_law: Array
    slope: Array


class Balance:
    """Certificates of a law; pure functions of what is measured, bound once, machine code where the law is."""

    def __init__(self, law: TrackingLaw) -> None:
        self.law = law

    def with_law(self, law: TrackingLaw) -> Balance:
        """The same of a law made by `self.law.with_gains`: nothing is built again."""
        other = Balance(law)
        other.function = self.function
        return other

    def at(
        self, position: ArrayLike, velocity: ArrayLike, jets: ArrayLike, u: ArrayLike | None = None
    ) -> CertificateSample:
        """The certificate at positions (2n,) [rad] and velocities (2n,) [rad/s] of links, then motors.

        jets (5, n): the reference's. u (n,) [N m]: the effort that acts; None: the law's own, with which
        dV = -dissipation. Raises StateError for shapes that do not fit.
        """
        n = self.law.robot.n
        u = np.full(n, np.nan) if u is None else checks.vector("u", u, n, StateError)
        found = (value[None] for value in self._at(position, velocity, jets, self.law.gain_values))
        values = dict(zip(OUTPUTS, found, strict=True))
        series = self._series(np.asarray(velocity, dtype=float)[None], u[None], values)
        return CertificateSample(*(getattr(series, f.name)[0] for f in fields(CertificateSample)))

    def along(
        self, position: ArrayLike, velocity: ArrayLike, jets: ArrayLike, u: ArrayLike | None = None
    ) -> CertificateSeries:
        """The same at k instants: position, velocity (k, 2n), jets (k, 5, n), u (k, n), nan: the law's own."""
        position, velocity, jets = (np.asarray(value, dtype=float) for value in (position, velocity, jets))
        n, k = self.law.robot.n, len(position)
        u = np.full((k, n), np.nan) if u is None else np.asarray(u, dtype=float)
        for name, value, shape in (
            ("position", position, (k, 2 * n)),
            ("velocity", velocity, (k, 2 * n)),
            ("jets", jets, (k, JETS, n)),
            ("u", u, (k, n)),
        ):
            if value.shape != shape:
                raise StateError(f"{name} has shape {value.shape}; expected {shape}")
        if not k:
            nothing = np.zeros(0)
            return CertificateSeries(*(nothing,) * 5, u_law=np.zeros((0, n)), slope=np.zeros((0, 4 * n)))
        columns = jets.transpose(2, 0, 1).reshape(n, k * JETS)
        found = self.function(position.T, velocity.T, columns, self.law.gain_values)
        rows = (result.full().T for result in found)
        return self._series(velocity, u, dict(zip(OUTPUTS, rows, strict=True)))

    def _series(self, velocity: Array, u: Array, values: dict[str, Array]) -> CertificateSeries:
        """The series of OUTPUTS by name, one row an instant, under efforts u (k, n)."""
        robot, u_law = self.law.robot, values["u_law"]
        u = np.where(np.isnan(u), u_law, u)
        return CertificateSeries(
            V=values["V"][:, 0],
            dV=(values["drive"] * (u - u_law)).sum(axis=1) - values["dissipation"][:, 0],
            H=values["H"][:, 0],
            supplied=(velocity[:, robot.n :] * (u @ robot.B_m.T)).sum(axis=1),
            dissipated=values["dissipated"][:, 0],
            u_law=u_law,
            slope=values["slope"],
        )

    @cached_property
    def function(self) -> ca.Function:
        """The CasADi function (position, velocity, jets (n, 5), gains) -> OUTPUTS.

        dissipation [W]: -dV/dt under the law's effort. drive (n,) = B_m' s_m [rad/s]: dV/dt by another one's excess.
        """
        return self.law.derived("certificate", self._derived)

    def _derived(self) -> ca.Function:
        robot = self.law.robot
        inputs, e = self.law.measured_expressions()
        position, velocity = inputs["position"], inputs["velocity"]
        dq_l, dq_m = ca.vertsplit(velocity, robot.n)
        values = {
            "V": e["V"],
            "H": self._energy(position, velocity),
            "dissipation": e["dissipation"],
            "dissipated": ca.dot(dq_l, robot.D_l @ dq_l) + ca.dot(dq_m, robot.D_m @ dq_m),
            "u_law": e["u"],
            "drive": robot.B_m.T @ e["s_m"],
            "slope": ca.gradient(e["V"], ca.vertcat(position, velocity)),
        }
        return dense_function("certificate", inputs, {name: values[name] for name in OUTPUTS}, cse=True)

    def _energy(self, position: ca.SX, velocity: ca.SX) -> ca.SX:
        """H of eq. (36) from velocities."""
        robot = self.law.robot
        (q_l, q_m), (dq_l, dq_m) = ca.vertsplit(position, robot.n), ca.vertsplit(velocity, robot.n)
        kinetic = (ca.dot(dq_l, robot.links.M_l(q_l) @ dq_l) + ca.dot(dq_m, robot.M_m @ dq_m)) / 2
        return kinetic + robot.links.P_l(q_l) + ca.dot(q_m - q_l, robot.K @ (q_m - q_l)) / 2

    @cached_property
    def _at(self) -> NumericFunction:
        n = self.law.robot.n
        return NumericFunction(self.function, ((2 * n,), (2 * n,), (JETS, n), self.law.gain_values.shape))
