# SPDX-License-Identifier: Apache-2.0
"""A record of one elastic joint under gravity, integrated by SciPy from equations written out here."""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.integrate import solve_ivp

import fjr_core as fjr
from fjr_core.model.robot import Robot
from fjr_identification.estimation.motion_record import MotionRecord

J, B, K, D_L, D_M, WEIGHT = 0.5, 0.2, 400.0, 0.3, 0.5, 6.0  # kg m^2, kg m^2, N m/rad, N m s/rad, N m s/rad, N m
COULOMB = 0.4  # N m, of link and motor
DT, K_SAMPLES = 2e-3, 3000
NOISE = 2e-6  # rad
FREQUENCIES, AMPLITUDES = (0.6, 1.7, 4.1), (0.5, 0.15, 0.03)  # Hz, rad


def robot() -> Robot:
    return fjr.single_link(
        stiffness=K, link_inertia=J, motor_inertia=B, link_damping=D_L, motor_damping=D_M, gravity_torque=WEIGHT
    )


def reference(t: float) -> tuple[float, float]:
    w = 2 * np.pi * np.array(FREQUENCIES)
    return float(AMPLITUDES @ np.sin(w * t)), float((AMPLITUDES * w) @ np.cos(w * t))


def effort(t: float, x: np.ndarray) -> float:
    """Return the effort of a motor controller that follows the reference."""
    q_d, dq_d = reference(t)
    return 300.0 * (q_d - x[1]) + 20.0 * (dq_d - x[3]) + WEIGHT * np.sin(q_d)


def derivative(_t: float, x: np.ndarray, u: float) -> list[float]:
    q_l, q_m, v_l, v_m = x
    tau = K * (q_m - q_l)
    friction_l, friction_m = COULOMB * np.tanh(v_l / 0.01), COULOMB * np.tanh(v_m / 0.01)
    ddq_l = (tau - WEIGHT * np.sin(q_l) - D_L * v_l - friction_l) / J
    return [v_l, v_m, ddq_l, (u - tau - D_M * v_m - friction_m) / B]


@cache
def record() -> MotionRecord:
    """Return K_SAMPLES samples with the effort held, with noise on both encoders."""
    x, rows, efforts = np.zeros(4), [], []
    for k in range(K_SAMPLES):
        u = effort(k * DT, x)
        rows.append(x)
        efforts.append(u)
        x = solve_ivp(derivative, (0.0, DT), x, "RK45", args=(u,), rtol=1e-6, atol=1e-9).y[:, -1]
    states = np.array(rows) + NOISE * np.random.default_rng(3).standard_normal((K_SAMPLES, 4))
    unknown = np.full((K_SAMPLES, 1), np.nan)
    return MotionRecord(
        "joint.csv", ("joint1",), DT, np.array(efforts)[:, None], states[:, :1], states[:, 1:2], unknown
    )
