# SPDX-License-Identifier: Apache-2.0
"""Evaluate the certificate of the closed loop: the storage V of the law and the energy H, with their exact rates.

    dV/dt = -dissipation + s_m' B_m (u - u_law(x))      for any applied effort u
    dH/dt = dq_m' B_m u - dq_l' D_l dq_l - dq_m' D_m dq_m

The first is the rate of (43) with omega = B_m (u - u_law) in (42): a held, delayed, saturated or lost effort is an
external input of the virtual system. Both hold along trajectories of the plant (36), so their residual measures the
model error. So does that of `Prediction`, which predicts the next measurement by the model under the held effort.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ..errors import StateError
from ..law.vdpbc import TrackingLaw
from ..model import springs
from ..model.port_hamiltonian import Plant
from ..motions.reference import JETS
from ..numerics.checks import Array, instance
from ..numerics.integrators import rk4_expression
from ..numerics.one_line import one_line
from ..numerics.symbolic import dense_function, evaluate_rows, symbols

OUTPUTS = ("V", "H", "dissipation", "dissipated", "u_law", "drive", "slope")


@dataclass(frozen=True)
class CertificateSeries:
    """Certificate at k instants.

    V (k,) [J]: storage of the law, (43). dV (k,) [W]: its rate under the applied effort. H (k,) [J]: energy of the
    robot, (35). supplied, dissipated (k,) [W]: dH/dt = supplied - dissipated. u_law (k, n) [N m]: effort of the law.
    slope (k, 4n): dV/d(position, velocity) [N m, N m s] at a constant reference. drive (k, n) [rad/s]: B_m' s_m.
    dissipation (k,) [W]: -dV/dt under the effort of the law.
    """

    V: Array
    dV: Array
    H: Array
    supplied: Array
    dissipated: Array
    u_law: Array
    slope: Array
    drive: Array
    dissipation: Array

    __repr__ = one_line

    def held_rate(self, u: Array) -> Array:
        """Return the mean dV/dt (k - 1,) [W] of each step under the effort u (k, n) [N m] held from its start.

        Trapezoidal rule. u is the series' own; NaN: the effort of the law.
        """
        if len(u) < 2:
            return np.zeros(0)
        held = np.where(np.isnan(u[:-1]), self.u_law[1:], u[:-1])
        end = _rate(self.drive[1:], held - self.u_law[1:], self.dissipation[1:])
        return np.asarray((self.dV[:-1] + end) / 2)


class Certificate:
    """Certificate of a law as a function of measured positions and velocities.

    The functions are built once per law; they are machine code where the law is compiled.
    """

    def __repr__(self) -> str:
        return f"Certificate({self.law!r})"

    def __init__(self, law: TrackingLaw) -> None:
        instance("law", law, TrackingLaw, StateError, "v-dPBC, a fjr.TrackingLaw")
        self.law = law

    def along(
        self, position: ArrayLike, velocity: ArrayLike, jets: ArrayLike, u: ArrayLike | None = None
    ) -> CertificateSeries:
        """Return the certificate at k instants.

        position, velocity (k, 2n); jets (k, 5, n); u (k, n) [N m], NaN: the effort of the law. Raises StateError.
        """
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
        found = evaluate_rows(self.function, position, velocity, jets, np.tile(self.law.gain_values, (k, 1)))
        V, H, dissipation, dissipated, u_law, drive, slope = found
        u = np.where(np.isnan(u), u_law, u)
        return CertificateSeries(
            V=V[:, 0],
            dV=_rate(drive, u - u_law, dissipation[:, 0]),
            H=H[:, 0],
            supplied=(velocity[:, n:] * (u @ self.law.robot.B_m.T)).sum(axis=1),
            dissipated=dissipated[:, 0],
            u_law=u_law,
            slope=slope,
            drive=drive,
            dissipation=dissipation[:, 0],
        )

    @cached_property
    def function(self) -> ca.Function:
        """Return the CasADi function (position, velocity, jets (n, 5), gains) -> OUTPUTS; see CertificateSeries."""
        return self.law.derived("certificate", self._derived)

    def _derived(self) -> ca.Function:
        robot = self.law.robot
        inputs, e = self.law.measured_expressions(slope=True)
        (q_l, q_m), (dq_l, dq_m) = (ca.vertsplit(inputs[name], robot.n) for name in ("position", "velocity"))
        kinetic = (ca.dot(dq_l, robot.links.M_l(q_l) @ dq_l) + ca.dot(dq_m, robot.M_m @ dq_m)) / 2
        values = {
            "V": e["V"],
            "H": kinetic + robot.links.P_l(q_l) + springs.energy(robot, q_m - q_l),  # (35) in velocities
            "dissipation": e["dissipation"],
            "dissipated": ca.dot(dq_l, robot.D_l @ dq_l) + ca.dot(dq_m, robot.D_m @ dq_m),
            "u_law": e["u"],
            "drive": robot.B_m.T @ e["s_m"],
            "slope": e["slope"],
        }
        return dense_function("certificate", inputs, {name: values[name] for name in OUTPUTS}, cse=True)


def _rate(drive: Array, excess: Array, dissipation: Array) -> Array:
    """Return dV/dt (k,) [W] under efforts that exceed those of the law by `excess` (k, n) [N m]."""
    return np.asarray((drive * excess).sum(axis=1) - dissipation)


STEPS = 4  # integrator steps per call
LONGEST = 1e-3  # s, longest horizon of a call; longer intervals take several calls


class Prediction:
    """One-step-ahead prediction by the model of the law; machine code if the law is compiled."""

    def __init__(self, law: TrackingLaw) -> None:
        self._law = law

    def along(self, position: Array, velocity: Array, u: Array, dt: Array) -> tuple[Array, Array]:
        """Return positions and velocities (k, 2n) after dt (k,) [s] under held efforts u (k, n) [N m].

        position, velocity (k, 2n) [rad, rad/s]: at the start.
        """
        position, velocity = position.copy(), velocity.copy()
        calls = np.maximum(1, np.ceil(dt / LONGEST - 1e-6)).astype(int)
        for count in np.unique(calls):  # a gap does not make every interval take as long
            rows = np.flatnonzero(calls == count)
            held = u[rows], dt[rows] / count
            for _ in range(count):
                position[rows], velocity[rows] = evaluate_rows(self.function, position[rows], velocity[rows], *held)
        return position, velocity

    @cached_property
    def function(self) -> ca.Function:
        """Return the CasADi function (position, velocity, u, dt) -> next position, next velocity."""
        return self._law.derived("prediction", self._derived)

    def _derived(self) -> ca.Function:
        robot = self._law.robot
        n = robot.n
        s, dynamics = symbols(ca.MX, position=2 * n, velocity=2 * n, u=n, dt=1), Plant(robot).dynamics
        position, velocity, u, dt = s.values()
        x = robot.to_state(position, velocity)
        for _ in range(STEPS):
            x = rk4_expression(dynamics, x, (u, u, u), dt / STEPS)
        outputs = {"next_position": x[: 2 * n], "next_velocity": robot.to_velocity(x)}
        return dense_function("prediction", s, outputs)
