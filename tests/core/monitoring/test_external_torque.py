# SPDX-License-Identifier: Apache-2.0
"""The momentum observer gives the torque on the links through a low-pass; the oracle is its closed form."""

from __future__ import annotations

import numpy as np
import pytest

from core.oracles.cases import ARMS, HARD, TORSION, Arm, Array
from core.oracles.chains import arm7
from fjr_core.monitoring.external_torque import ExternalTorqueObserver
from fjr_core.runtime.velocity_observer import LONGEST_GAP

L = 40.0  # 1/s
EVERY = (ARMS[0], ARMS[-1], HARD[1], TORSION[1], arm7())


def pushed(t: Array, n: int) -> tuple[Array, Array]:
    """Return torques (k, n) that begin smoothly, and the same through the low-pass from rest, in closed form."""
    a, w, t = np.linspace(1.0, -0.5, n), np.linspace(4.0, 9.0, n), t[:, None]
    late = (L**2 * (np.cos(w * t) - np.exp(-L * t)) + L * w * np.sin(w * t)) / (L**2 + w**2)
    return a * (1 - np.cos(w * t)), a * (1 - np.exp(-L * t) - late)


def motion(arm: Arm, t: Array, tau: Array) -> tuple[Array, Array]:
    """Return positions and velocities (k, 2n): links on sines, motors where the springs carry the link equation."""
    rng, n = np.random.default_rng(3), arm.n
    size, w, phase = 0.4, rng.uniform(2.0, 5.0, n), rng.uniform(0, 2 * np.pi, n)
    angle = w * t[:, None] + phase
    q, dq, ddq = size * np.sin(angle), size * w * np.cos(angle), -size * w**2 * np.sin(angle)
    q_m = []
    for k in range(len(t)):
        M, C, weight = arm.links.M(q[k]), arm.links.C(q[k], dq[k]), arm.links.grad_P(q[k])
        q_m.append(q[k] + arm.robot.deflection(M @ ddq[k] + C @ dq[k] + arm.D_l @ dq[k] + weight - tau[k]))
    return np.hstack([q, q_m]), np.hstack([dq, rng.normal(size=dq.shape)])  # velocities of motors do not matter


def error(arm: Arm, dt: float) -> float:
    """Return the largest error [N m] of the estimate over 0.4 s."""
    t = np.arange(round(0.4 / dt)) * dt
    tau, wanted = pushed(t, arm.n)
    found = ExternalTorqueObserver(arm.robot, L).along(t, *motion(arm, t, tau))
    return float(np.abs(found[:, -arm.n :] - wanted).max())


@pytest.mark.parametrize("arm", EVERY, ids=lambda arm: arm.name)
def test_estimate_is_the_torque_through_the_low_pass_to_second_order(arm: Arm) -> None:
    fine, coarse = (error(arm, dt) for dt in (1e-3, 2e-3))
    assert fine < 2e-3 * max(1.0, np.abs(arm.robot.grad_P_l(np.full(arm.n, 0.4))).max())
    assert np.log2(coarse / fine) == pytest.approx(2.0, abs=0.1)


def test_restarts_and_continues() -> None:
    """A missed sample continues, a repeated one changes nothing; a gap, a jump back or a bad value restarts."""
    arm = ARMS[2]
    t = np.arange(60) * 2e-3
    tau, _ = pushed(t, 2)
    position, velocity = motion(arm, t, tau)
    observer = ExternalTorqueObserver(arm.robot, L)
    whole = observer.along(t, position, velocity)
    first = observer.along(t[:30], position[:30], velocity[:30])
    assert np.array_equal(
        np.concatenate([first, observer.along(t[30:] - t[29], position[30:], velocity[30:], first[-1])]), whole
    )
    kept = np.delete(np.arange(60), 40)
    missed = observer.along(t[kept], position[kept], velocity[kept])
    assert np.abs(missed[-1] - whole[-1])[-2:].max() < 1e-3
    again = np.insert(np.arange(60), 40, 39)
    assert np.array_equal(observer.along(t[again], position[again], velocity[again])[-1], whole[-1])
    for jump in (1.01 * LONGEST_GAP, -0.01):
        late = np.where(t < t[30], t, t + jump)
        found = observer.along(late, position, velocity)
        assert not found[30, -2:].any()
        assert found[31, -2:].any()
    broken = velocity.copy()
    broken[30:32, 0] = np.nan
    found = observer.along(t, position, broken)[:, -2:]
    assert np.isnan(found[30:32]).all()
    assert not found[32].any()
    assert np.isfinite(found[32:]).all()
