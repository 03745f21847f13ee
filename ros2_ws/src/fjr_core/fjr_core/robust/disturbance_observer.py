# SPDX-License-Identifier: Apache-2.0
"""Estimate disturbance torques from the momentum residual.

A. De Luca, R. Mattone, "Sensorless robot collision detection and hybrid force/motion control", ICRA 2005;
A. De Luca, A. Albu-Schaeffer, S. Haddadin, G. Hirzinger, IROS 2006. With f the momentum rates of the model and d
the disturbance, dp = f + d, the residual r obeys dr = L (d - r) exactly for every motion:

    r = L (p - p(0) - integral of (f + r) dt)

In discrete time with sample period dt, d = (p - p_before) / dt - (f + f_before) / 2 is the mean disturbance to order
dt^2, and r is updated with d held (next_residual). The feedforward to the links needs two derivatives, which r does not
provide without a measurement of d. w filters r by w'' = L^2 (r - w) - 2 L w', so that w, dw and d2w are known exactly:
w = (L / (s + L))^3 d.
"""

from __future__ import annotations

import casadi as ca

from ..model.port_hamiltonian import derivative_expression
from ..model.robot import Robot
from ..numerics.symbolic import dense_function, symbols

Terms = dict[str, ca.MX]


class DisturbanceObserver:
    """Momentum-based disturbance observer: estimates torques (n,) [N m] from measured motion and the applied effort."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        n = robot.n
        self.sizes = {"p": 2 * n, "f": 2 * n, "r": 2 * n, "w": n, "dw": n}

    def step(self, kept: Terms, position: ca.MX, velocity: ca.MX, acted: ca.MX, gains: ca.MX, dt: ca.MX) -> Terms:
        """Return the updated state.

        acted (n,) [N m]: mean effort since the last sample. gains (2n,) [1/s]: links, then motors. dt [s]: time since
        the last sample, 0 for the first sample or a repeated one.
        """
        n = self.robot.n
        p, f = momenta(self.robot)(position, velocity)
        applied = ca.vertcat(ca.MX.zeros(n), ca.mtimes(ca.DM(self.robot.B_m), acted))
        r = next_residual(kept, p, f, applied, gains, dt)
        w, dw = _filtered(kept["w"], kept["dw"], (kept["r"][:n] + r[:n]) / 2, gains[:n], dt)
        return {"p": p, "f": f, "r": r, "w": w, "dw": dw}

    def fed_forward(self, parts: Terms, gains: ca.MX) -> ca.MX:
        """Return the estimated link torque and its first two derivatives (n, 3)."""
        n = self.robot.n
        L, w, dw = gains[:n], parts["w"], parts["dw"]
        return ca.horzcat(w, dw, L**2 * (parts["r"][:n] - w) - 2 * L * dw)


def momenta(robot: Robot) -> ca.Function:
    """Return the function (position, velocity) -> momenta (2n,) and their rates (2n,) by eq. (36) with u = 0."""
    n = robot.n
    s = symbols(position=2 * n, velocity=2 * n)
    x = robot.to_state(*s.values())
    p, f = x[2 * n :], derivative_expression(robot, x, ca.SX.zeros(n))[2 * n :]
    return dense_function("momenta", s, {"p": p, "f": f}, cse=True)


def next_residual(kept: Terms, p: ca.MX, f: ca.MX, applied: ca.MX | float, L: ca.MX, dt: ca.MX) -> ca.MX:
    """Return r (m,) [N m] at the momenta p with rates f, from p, f and r of the last sample.

    applied (m,) [N m]: mean torque that f lacks. L [1/s]: bandwidth. dt [s]: since the last sample; with 0 r stays.
    """
    d = (p - kept["p"]) / ca.if_else(dt > 0, dt, 1) - (f + kept["f"]) / 2 - applied
    return kept["r"] + (1 - ca.exp(-L * dt)) * (d - kept["r"])


def _filtered(w: ca.MX, dw: ca.MX, r: ca.MX, L: ca.MX, dt: ca.MX) -> tuple[ca.MX, ca.MX]:
    """Return the exact solution w, dw after dt of w'' = L^2 (r - w) - 2 L w' with r constant."""
    e, c, decay = w - r, dw + L * (w - r), ca.exp(-L * dt)
    return r + (e + c * dt) * decay, (dw - L * c * dt) * decay
