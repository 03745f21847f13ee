# SPDX-License-Identifier: Apache-2.0
"""Torques that act beside the model, from the residual of the momenta.

A. De Luca, R. Mattone, "Sensorless robot collision detection and hybrid force/motion control", ICRA 2005;
A. De Luca, A. Albu-Schaeffer, S. Haddadin, G. Hirzinger, IROS 2006. With f the rates of the momenta that the model
knows, dp = f + d, the residual obeys dr = L (d - r) exactly, whatever the robot does:

    r = L (p - p(0) - integral of (f + r) dt)

Here over a sample period dt: d = (p - p_before) / dt - (f + f_before) / 2 is the mean of the torque (to dt^2), and
r moves to it as for a constant one. What is fed forward to the links needs two rates, which r does not have without
a measurement of d: w follows r by w'' = L^2 (r - w) - 2 L w', so that w, dw and d2w are known exactly, and
w = (L / (s + L))^3 d altogether.
"""

from __future__ import annotations

from functools import cached_property

import casadi as ca

from ...numerics.casadi_function import dense_function
from ...robot.coordinates import Coordinates
from ...robot.port_hamiltonian import derivative_expression
from ...robot.robot import Robot

Terms = dict[str, ca.MX]


class MomentumResidual:
    """The estimates' part of a sample: from measured motion and the effort that acted to torques (n,) [N m]."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        n = robot.n
        self.sizes = {"p": 2 * n, "f": 2 * n, "r": 2 * n, "w": n, "dw": n}

    def step(self, kept: Terms, position: ca.MX, velocity: ca.MX, acted: ca.MX, gains: ca.MX, dt: ca.MX) -> Terms:
        """The parts anew. acted (n,): mean effort since the last sample; gains (2n,) [1/s]: of links, then motors.

        dt 0: a first sample, or one again.
        """
        n = self.robot.n
        p, f = self.momenta(position, velocity)
        worked = ca.vertcat(ca.MX.zeros(n), ca.mtimes(ca.DM(self.robot.B_m), acted))
        d = (p - kept["p"]) / ca.if_else(dt > 0, dt, 1) - (f + kept["f"]) / 2 - worked
        r = kept["r"] + (1 - ca.exp(-gains * dt)) * (d - kept["r"])
        w, dw = _followed(kept["w"], kept["dw"], (kept["r"][:n] + r[:n]) / 2, gains[:n], dt)
        return {"p": p, "f": f, "r": r, "w": w, "dw": dw}

    def fed_forward(self, parts: Terms, gains: ca.MX) -> ca.MX:
        """The torque on the links with two rates (n, 3)."""
        n = self.robot.n
        L, w, dw = gains[:n], parts["w"], parts["dw"]
        return ca.horzcat(w, dw, L**2 * (parts["r"][:n] - w) - 2 * L * dw)

    @cached_property
    def momenta(self) -> ca.Function:
        """(position, velocity) -> momenta (2n,) and their rates (2n,) by eq. (36) without an effort."""
        n = self.robot.n
        position, velocity = ca.SX.sym("position", 2 * n), ca.SX.sym("velocity", 2 * n)
        x = Coordinates(self.robot).to_momenta(position, velocity)
        p, f = x[2 * n :], derivative_expression(self.robot, x, ca.SX.zeros(n))[2 * n :]
        return dense_function("momenta", {"position": position, "velocity": velocity}, {"p": p, "f": f}, cse=True)


def _followed(w: ca.MX, dw: ca.MX, r: ca.MX, L: ca.MX, dt: ca.MX) -> tuple[ca.MX, ca.MX]:
    """w and dw after dt of w'' = L^2 (r - w) - 2 L w' with r held, exactly."""
    e, c, decay = w - r, dw + L * (w - r), ca.exp(-L * dt)
    return r + (e + c * dt) * decay, (dw - L * c * dt) * decay
